"""Reading of the configuration of a bound."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any, Final

from glucoloop.config.checked import checked
from glucoloop.config.key import declared, plain
from glucoloop.config.options.bound import NOT_OF_A_BOUND, BoundKeys
from glucoloop.config.options.situation import refuse_parts_of_samples, whole_samples
from glucoloop.config.run import ask_about_surroundings, completed, refuse_unknown_beside
from glucoloop.refusal import Refusal
from glucoloop.situations.meal_text import meal_text

_MOST_KNOWN: Final = 20


def read_bound(keys: Mapping[str, object], names: Mapping[str, str] | None = None) -> BoundKeys:
    """Read the configuration of a bound from flat keys.

    Parameters
    ----------
    keys, names : mapping
        As for `config.run.read_run`.

    Raises
    ------
    ValueError
        For an unknown key, a value of the wrong type or out of bounds, or nothing asked for.
    """
    refuse_unknown_beside(keys, [key for key in declared(BoundKeys) if key not in NOT_OF_A_BOUND], " of a bound")
    asked = checked(BoundKeys, completed(keys), names)
    if not asked.allow_unusual:
        ask_about_surroundings(asked, asked.meals, names)
    asked = dataclasses.replace(asked, meals=tuple(meal_text(meal) for meal in asked.eaten()))
    whole_samples(asked.dead_time_min, asked.sample_time_min)
    refuse_parts_of_samples(asked.duration_min, asked.sample_time_min, names)
    if len(asked.known_after_min) > _MOST_KNOWN:
        called = (names or {}).get("known_after_min", "known_after_min")
        raise Refusal(f"{called} has {len(asked.known_after_min)} times; give at most {_MOST_KNOWN}")
    if not asked.known_after_min and not asked.in_advance and not asked.hedged:
        raise Refusal("nothing is asked for; give --known-after or --in-advance, or one meal and --noise")
    return asked


def bound_keys(asked: BoundKeys) -> dict[str, Any]:
    """The flat keys from which the same bound is read."""
    return {key: value for key, value in plain(asked).items() if key not in NOT_OF_A_BOUND}
