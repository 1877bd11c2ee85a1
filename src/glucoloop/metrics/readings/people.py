"""Metrics of many people: how each number is spread over them.

References
----------
T. Battelino et al., "Continuous glucose monitoring and metrics for clinical trials: an international consensus
statement", Lancet Diabetes Endocrinol. 11(1), 42-57, 2023: mean with standard deviation, or median with quartiles.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np


class PeopleSpread(NamedTuple):
    """One number over people; NaN where nobody has it."""

    people: int
    """Number of people who have it."""
    mean: float
    sd: float
    """Standard deviation with ``n - 1`` as its denominator; NaN for one person."""
    least: float
    p25: float
    median: float
    p75: float
    greatest: float


def spread_of(values: Sequence[float]) -> PeopleSpread:
    """Spread of a number; a person for whom it is not finite is left out.

    Examples
    --------
    >>> spread_of([1.0, 2.0, 3.0, float("nan")]).median
    2.0
    """
    given = np.asarray(values, float)
    given = given[np.isfinite(given)]
    if not given.size:
        return PeopleSpread(0, *[np.nan] * 7)
    quartiles = map(float, np.percentile(given, [0, 25, 50, 75, 100]))
    return PeopleSpread(
        given.size, float(given.mean()), float(given.std(ddof=1)) if given.size > 1 else np.nan, *quartiles
    )


def over_people(numbers: Sequence[Mapping[str, float]]) -> dict[str, PeopleSpread]:
    """Spread of each number over people; all have the same numbers."""
    return {name: spread_of([of[name] for of in numbers]) for name in numbers[0]}
