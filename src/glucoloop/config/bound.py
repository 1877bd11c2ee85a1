"""Configuration of a bound: the situation, and the times at which its meals become known."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Final, Literal

from pydantic import Field

from glucoloop.config.meal_text import meal_text
from glucoloop.config.run import SurroundingKeys, ask_about_surroundings, checked, of_patient
from glucoloop.config.run import whole_samples as whole_dead_time
from glucoloop.plausible import DURATION
from glucoloop.registry.settings import refuse_unknown_keys

_MOST_KNOWN: Final = 20


class BoundConfig(SurroundingKeys):
    """Surroundings as in a run, without a controller, and the knowledge of the meals."""

    duration_min: Annotated[float, Field(gt=0.0, le=7200.0), DURATION] = 600.0
    objective: Literal["deviation", "undershoot", "peak", "sse"] = "deviation"
    undershoot_weight: Annotated[float, Field(gt=0.0, le=1e6)] = 1.0
    """Weight of squares below the setpoint, for ``sse``."""
    known_after_min: Annotated[tuple[float, ...], Field(max_length=_MOST_KNOWN)] = (0.0, 10.0)
    """Times from the start of a meal until it is known, without the dead time; negative if it is known in advance."""
    in_advance: bool = False
    """Whether a plan is also made with all meals known from the start."""

    @property
    def hedged(self) -> bool:
        """Whether the bound under sensor noise is computed: for one meal at rest, and the largest deviation."""
        elsewhere = self.setpoint_mg_dl is not None or self.initial_glucose_mg_dl is not None
        return self.noise_variance > 0.0 and len(self.meals) == 1 and not elsewhere and self.objective == "deviation"


def read_bound(keys: Mapping[str, object], names: Mapping[str, str] | None = None) -> BoundConfig:
    """Read the configuration of a bound from flat keys.

    Parameters
    ----------
    keys : mapping
    names : mapping, optional
        Name under which the user gave each key, for messages.

    Raises
    ------
    ValueError
        For an unknown key, a value of the wrong type or out of bounds, or nothing asked for.
    """
    known = list(BoundConfig.model_fields)
    refuse_unknown_keys(keys, known)
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
