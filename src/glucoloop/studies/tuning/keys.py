"""Configuration of a search of a grid: a run, the ranges of the tuned parameters, and the seeds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from glucoloop.config.run import Run, read_run
from glucoloop.control import MPCTuning
from glucoloop.registry.controllers import TUNABLE, controller_entry
from glucoloop.tuning.grid import parse_integers, parse_numbers, tuning_grid
from glucoloop.tuning.paper import REFERENCE_FILTERS

HORIZONS: Final = {"move_horizon": "1:4", "prediction_horizon": "1:14"}
"""Ranges of the horizons that are tried if none is given."""
WEIGHTS: Final = ("output_weight", "move_weight")
TUNED: Final = (*HORIZONS, "reference_filter", *WEIGHTS)
"""Parameters for which a search takes a range."""
MOST_SEEDS: Final = 1000
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

    def keys(self) -> dict[str, Any]:
        """The flat keys from which the same search is read."""
        return {**self.run.keys(), **self.ranges, "seeds": self.seeds, "top": self.top}


def read_grid_search(keys: Mapping[str, object], names: Mapping[str, str] | None = None) -> GridSearch:
    """Read the configuration of a search from flat keys.

    Parameters
    ----------
    keys : mapping
        Those of a run, of which the tuned parameters are ranges, like ``"1:4"`` or ``"0,1,3"``.
    names : mapping, optional
        Name under which the user gave each key, for messages.

    Raises
    ------
    ValueError
        For a key that is unknown, wrong or at odds with another, or a controller that cannot be tuned.
    """
    called, plain = {key: (names or {}).get(key, key) for key in (*TUNED, "seeds", "top")}, dict(keys)
    controller = str(plain.get("controller", "mpc"))
    entry = controller_entry(controller)
    if not entry.tunable:
        raise ValueError(f"the controller {controller!r} cannot be tuned; the known ones are: {', '.join(TUNABLE)}")
    given = {key: _text(plain.pop(key), called[key]) for key in TUNED if key in plain}
    for key in given:
        entry.setting(key)
    top = _whole(plain.pop("top", 10), called["top"], 100_000)
    seeds = plain.pop("seeds", None)
    run = read_run(plain, names)
    noisy = run.situation.noisy
    if seeds is not None and not noisy and seeds != 1:
        raise ValueError(f"{called['seeds']} is {seeds}, but without noise all are alike; leave it out")
    ranges = {**_usual_ranges(run), **given}
    return GridSearch(
        run=run,
        ranges=ranges,
        grid=_grid(run, ranges, called),
        seeds=(_USUAL_SEEDS if noisy else 1) if seeds is None else _whole(seeds, called["seeds"], MOST_SEEDS),
        top=top,
    )


def _text(value: object, name: str) -> str:
    """A range as text; a file may hold a number or a list of numbers."""
    if isinstance(value, list) and value:
        return ",".join(_text(item, name) for item in value)
    if isinstance(value, str | int | float) and not isinstance(value, bool):
        return str(value)
    raise ValueError(f"{name} is {value!r}; write it like 1:4 or 0,1,3")


def _whole(value: object, name: str, most: int) -> int:
    if not isinstance(value, int) or isinstance(value, bool) or not 1 <= value <= most:
        raise ValueError(f"{name} is {value!r}; give a whole number from 1 to {most}")
    return value


def _usual_ranges(run: Run) -> dict[str, str]:
    weights = {key: f"{run.case.tuning[key]:g}" for key in WEIGHTS}
    filters = REFERENCE_FILTERS.get(run.case.controller)
    return {**HORIZONS, **weights, **({} if filters is None else {"reference_filter": filters})}


def _grid(run: Run, ranges: Mapping[str, str], called: Mapping[str, str]) -> list[MPCTuning]:
    whole = {key: parse_integers(ranges[key], called[key]) for key in HORIZONS}
    numbers = {key: parse_numbers(ranges[key], called[key]) for key in ranges if key not in HORIZONS}
    return tuning_grid(
        whole["move_horizon"],
        whole["prediction_horizon"],
        output_weights=numbers["output_weight"],
        move_weights=numbers["move_weight"],
        reference_filters=numbers.get("reference_filter"),
        reference_start=int(run.case.tuning.get("reference_start", 1)),
    )
