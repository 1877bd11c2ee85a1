"""Quantiles of values counted in bins: exact counts of many people, interpolated linearly within a bin."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

BAND_QUANTILES: Final = (0.01, 0.05, 0.10, 0.25, 0.50, 0.75, 0.90, 0.95, 0.99)
"""Quantiles of glucose and insulin over time."""


def quantiles_of_counts(
    edges: npt.NDArray[np.float64], counts: npt.NDArray[np.int64], probabilities: Sequence[float] = BAND_QUANTILES
) -> npt.NDArray[np.float64]:
    """Quantiles of values of which only the number in each bin is known.

    Parameters
    ----------
    edges : (bins + 1,) array
    counts : (rows, bins) array
    probabilities : sequence of float

    Returns
    -------
    (probabilities, rows) array
        Quantiles in the bin of the true one, so that the error is less than the width of the bin; NaN for a row without
        counts.
    """
    ends = np.cumsum(counts, axis=1, dtype=np.float64)
    total = ends[:, -1]
    rows = np.arange(counts.shape[0])
    found = np.full((len(probabilities), counts.shape[0]), np.nan)
    for row, probability in enumerate(probabilities):
        place = probability * total
        # The first bin whose end reaches the place, and which holds somebody.
        number = np.argmax((ends >= place[:, None]) & (counts > 0), axis=1)
        inside = counts[rows, number]
        share = (place - (ends[rows, number] - inside)) / np.maximum(inside, 1)
        found[row] = edges[number] + (edges[number + 1] - edges[number]) * share
    found[:, total == 0] = np.nan
    return found
