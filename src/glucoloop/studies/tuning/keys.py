"""Configuration of a search of a grid: a run, the ranges of the tuned parameters, and the seeds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

from glucoloop.config.checked import checked
from glucoloop.config.key import declared, own_keys
from glucoloop.config.run import Run, read_run
from glucoloop.control import MPCTuning
from glucoloop.control.catalogue import USUAL_CONTROLLER, controller_entry
from glucoloop.refusal import Refusal
from glucoloop.studies.tuning.options import GridKeys, RangeKeys
from glucoloop.tuning.designers import kind_of_tuning, usual_filters
from glucoloop.tuning.grid import parse_integers, parse_numbers, tuning_grid

_USUAL_SEEDS: Final = 5


@dataclass(frozen=True)
class GridSearch:
    """A search that is complete and checked."""

    run: Run
    """Run with the situation, and the controller with the parameters that are not tuned."""
    ranges: Mapping[str, str]
    """Range of each tuned parameter, as written."""
    grid: Sequence[MPCTuning]
    seeds: int
    top: int
    """Number of tunings in the table."""
    given_of_search: Mapping[str, Any] = field(default_factory=dict, compare=False)
    """Flat keys of the search itself that were given."""

    @property
    def given(self) -> dict[str, Any] | None:
        """Flat keys from which it was read, if it was."""
        return None if self.run.given is None else {**self.run.given, **self.given_of_search}

    def keys(self) -> dict[str, Any]:
        """The flat keys from which the same search is read."""
        return {**self.run.keys(), **self.ranges, "seeds": self.seeds, "top": self.top}


def read_grid_search(keys: Mapping[str, object], names: Mapping[str, str] | None = None) -> GridSearch:
    """Read the configuration of a search from flat keys.

    Parameters
    ----------
    keys : mapping
        Keys of a run, of which the tuned parameters are ranges, like ``"1:4"`` or ``"0,1,3"``.
    names : mapping, optional
        Name under which the user gave each key, for messages.

    Raises
    ------
    ValueError
        For a key that is unknown, wrong or at odds with another, or a controller that cannot be tuned.
    """
    called = {key: (names or {}).get(key, key) for key in (*declared(RangeKeys), *declared(GridKeys))}
    controller = str(keys.get("controller", USUAL_CONTROLLER))
    kind_of_tuning(controller)
    given = {key: _text(value, called[key]) for key, value in own_keys(keys, RangeKeys).items()}
    for key in given:
        controller_entry(controller).setting(key)
    own = checked(GridKeys, own_keys(keys, GridKeys), names)
    run = read_run({key: value for key, value in keys.items() if key not in called}, names)
    noisy = run.situation.noisy
    if own.seeds not in (None, 1) and not run.situation.drawn:
        raise Refusal(
            f"{called['seeds']} is {own.seeds}, but without noise, another sensor or a fault all are alike; "
            "leave it out"
        )
    ranges = {**_usual_ranges(run), **given}
    return GridSearch(
        run=run,
        ranges=ranges,
        grid=_grid(run, ranges, called),
        seeds=own.seeds or (_USUAL_SEEDS if noisy else 1),
        top=own.top,
        given_of_search={key: value for key, value in keys.items() if key in called},
    )


def _text(value: object, name: str) -> str:
    """A range as text; a file may hold a number or a list of numbers."""
    if isinstance(value, list) and value:
        return ",".join(_text(item, name) for item in value)
    if isinstance(value, str | int | float) and not isinstance(value, bool):
        return str(value)
    raise Refusal(f"{name} is {value!r}; write it like 1:4 or 0,1,3")


def _usual_ranges(run: Run) -> dict[str, str]:
    weights = {key: f"{run.case.tuning[key]:g}" for key in ("output_weight", "move_weight")}
    filters = usual_filters(run.case.controller, run.case.tuning)
    horizons = {"move_horizon": RangeKeys.move_horizon, "prediction_horizon": RangeKeys.prediction_horizon}
    return {**horizons, **weights, **({} if filters is None else {"reference_filter": filters})}


def _grid(run: Run, ranges: Mapping[str, str], called: Mapping[str, str]) -> list[MPCTuning]:
    whole = {key: parse_integers(ranges[key], called[key]) for key in ("move_horizon", "prediction_horizon")}
    numbers = {key: parse_numbers(ranges[key], called[key]) for key in ranges if key not in whole}
    return tuning_grid(
        whole["move_horizon"],
        whole["prediction_horizon"],
        output_weights=numbers["output_weight"],
        move_weights=numbers["move_weight"],
        reference_filters=numbers.get("reference_filter"),
        reference_start=int(run.case.tuning.get("reference_start", 1)),
    )
