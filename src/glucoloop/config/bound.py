"""A bound that is asked for: the situation, and what is to be known of its meals, and when."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Final, Literal

from pydantic import Field

from glucoloop.config.meal_text import meal_text
from glucoloop.config.run import SurroundingKeys, ask_about_surroundings, checked, of_patient
from glucoloop.config.run import whole_samples as whole_dead_time
from glucoloop.plausible import DURATION
from glucoloop.registry.settings import known_names

_MOST_KNOWN: Final = 20


class BoundConfig(SurroundingKeys):
    """Surroundings as of a run, without a controller, and what is known in them."""

    duration_min: Annotated[float, Field(gt=0.0, le=7200.0), DURATION] = 600.0
    objective: Literal["deviation", "undershoot", "peak", "sse"] = "deviation"
    undershoot_weight: Annotated[float, Field(gt=0.0, le=1e6)] = 1.0
    """Of squares below the setpoint, for ``sse``."""
    known_after_min: Annotated[tuple[float, ...], Field(max_length=_MOST_KNOWN)] = (0.0, 10.0)
    """From the start of a meal until it is known, dead time not counted; negative: in advance."""
    in_advance: bool = False
    """Whether there is a plan for somebody who knows all meals from the start, too."""

    @property
    def hedged(self) -> bool:
        """Whether it is worked out what noise lets one know: of one meal at rest, for the largest deviation."""
        elsewhere = self.setpoint_mg_dl is not None or self.initial_glucose_mg_dl is not None
        return self.noise_variance > 0.0 and len(self.meals) == 1 and not elsewhere and self.objective == "deviation"


def read_bound(keys: Mapping[str, object], names: Mapping[str, str] | None = None) -> BoundConfig:
    """Bound from flat keys.

    Parameters
    ----------
    keys : mapping
    names : mapping, optional
        What a key is called where it was given; for messages.

    Raises
    ------
    ValueError
        For an unknown key, a value of the wrong type or out of bounds, or nothing asked for.
    """
    known = list(BoundConfig.model_fields)
    for key in keys:
        if key not in known:
            raise ValueError(f"unknown key {key!r}; {known_names(key, known)}")
    asked = checked(BoundConfig, of_patient(keys), names)
    if not asked.allow_unusual:
        ask_about_surroundings(asked, asked.eaten(), names)
    asked = asked.model_copy(update={"meals": tuple(meal_text(meal) for meal in asked.eaten())})
    whole_dead_time(asked.dead_time_min, asked.sample_time_min)
    if not asked.known_after_min and not asked.in_advance and not asked.hedged:
        raise ValueError("nothing is asked for; give --known-after or --in-advance, or one meal and --noise")
    return asked


def bound_keys(asked: BoundConfig) -> dict[str, Any]:
    """The flat keys from which the same bound is read."""
    return asked.model_dump(mode="json")
