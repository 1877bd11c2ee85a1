"""Grids of tunings: every possible combination of horizons, weights and reference filters."""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Callable, Sequence
from decimal import Decimal
from typing import Final, TypeVar

from glucoloop.control.tuning import MPCTuning, StateTuning
from glucoloop.refusal import Refusal

_MAX_VALUES: Final = 1000
"""Largest number of values of one range."""
_MAX_TUNINGS: Final = 100_000
"""Largest number of tunings of a grid, with those that are left out."""

_NUMBER: Final = re.compile(r"[+-]?(\d{1,9}(\.\d{0,9})?|\.\d{1,9})(e[+-]?\d{1,2})?", re.ASCII | re.IGNORECASE)

Number = TypeVar("Number", int, float)


def parse_integers(text: str, name: str = "the range") -> tuple[int, ...]:
    """Whole numbers from a text: ``1:4`` with both ends, ``2:16:2`` in steps, ``2|5|8``, or ``1:3|8``."""
    return _parse(text, name, int, "1:4, 2:16:2 or 2|5|8")


def parse_numbers(text: str, name: str = "the range") -> tuple[float, ...]:
    """Numbers from a text: ``.3:.8:.05``, with both ends where the steps meet them, or ``0|1|3``."""
    return _parse(text, name, float, ".3:.8:.05 or 0|1|3")


def _parse(text: str, name: str, kind: Callable[[Decimal], Number], like: str) -> tuple[Number, ...]:
    values: list[Decimal] = []
    for part in text.split("|"):
        bounds = [piece.strip() for piece in part.split(":")]
        if len(bounds) > 3 or not all(_NUMBER.fullmatch(piece) for piece in bounds):
            raise Refusal(f"{name} is {text!r}; write it like {like}")
        if kind is float and len(bounds) == 2:
            raise Refusal(f"{name} has {part.strip()!r} without a step; write it like {like}")
        # decimals, so that .3:.8:.05 ends at .8 and holds the very .55 that a person would write
        numbers = [Decimal(piece) for piece in bounds]
        if kind is int and any(number != number.to_integral_value() for number in numbers):
            raise Refusal(f"{name} has {part.strip()!r}; give whole numbers, like {like}")
        values += _steps(numbers, name, part.strip())
        if len(values) > _MAX_VALUES:
            raise Refusal(f"{name} has more than {_MAX_VALUES} values; give fewer, or wider steps")
    return tuple(kind(value) for value in dict.fromkeys(values))


def _steps(numbers: list[Decimal], name: str, part: str) -> list[Decimal]:
    if len(numbers) == 1:
        return numbers
    first, last, step = (*numbers, Decimal(1))[:3]
    if step <= 0:
        raise Refusal(f"{name} has steps of {step} in {part!r}; give a step above 0")
    if last < first:
        raise Refusal(f"{name} runs from {first} down to {last}; write the lower end first")
    count = int((last - first) / step) + 1
    if count > _MAX_VALUES:
        raise Refusal(f"{name} has more than {_MAX_VALUES} values; give fewer, or wider steps")
    return [first + number * step for number in range(count)]


def tuning_grid(
    move_horizons: Sequence[int],
    prediction_horizons: Sequence[int],
    *,
    output_weights: Sequence[float] = (1.0,),
    move_weights: Sequence[float] = (0.0,),
    reference_filters: Sequence[float] | None = None,
    reference_start: int = 1,
) -> list[MPCTuning]:
    """All combinations, without those whose prediction horizon is shorter than the move horizon.

    They are `StateTuning` where reference filters are given. Tunings whose weights have the same ratio are the same
    controller.

    Examples
    --------
    >>> [(tuning.move_horizon, tuning.prediction_horizon) for tuning in tuning_grid([1, 2], [1, 2])]
    [(1, 1), (1, 2), (2, 2)]
    """
    ranges = {
        "move horizons": move_horizons,
        "prediction horizons": prediction_horizons,
        "output weights": output_weights,
        "move weights": move_weights,
        **({} if reference_filters is None else {"reference filters": reference_filters}),
    }
    for name, values in ranges.items():
        if not len(values):
            raise Refusal(f"the grid has no {name}; give at least one")
    size = math.prod(map(len, ranges.values()))
    if size > _MAX_TUNINGS:
        raise Refusal(f"a grid of {size} tunings is too large; give at most {_MAX_TUNINGS}, or wider steps")
    shared = list(itertools.product(move_horizons, prediction_horizons, output_weights, move_weights))
    possible = [values for values in shared if values[1] >= values[0]]
    if not possible:
        raise Refusal(
            f"no prediction horizon of the grid is as long as a move horizon: {max(prediction_horizons)} is the "
            f"longest, {min(move_horizons)} moves are the fewest; look farther ahead or plan fewer moves"
        )
    if reference_filters is None:
        return [MPCTuning(*values) for values in possible]
    return [
        StateTuning(*values, reference_filter=filter_, reference_start=reference_start)
        for values, filter_ in itertools.product(possible, reference_filters)
    ]
