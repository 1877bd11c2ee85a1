"""Bins in which a trial counts glucose and insulin over time, and quantiles from the counts.

Counts of any number of people take the same room, add exactly, and give quantiles to the width of a bin. Edges are
evenly spaced from 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

Edges = npt.NDArray[np.float64]

HIGHEST_GLUCOSE_MG_DL: Final = 600
GLUCOSE_BIN_MG_DL: Final = 1.0
INSULIN_BIN_MU_MIN: Final = 0.25
BAND_QUANTILES: Final = (0.01, 0.05, 0.10, 0.25, 0.50, 0.75, 0.90, 0.95, 0.99)
"""Quantiles of glucose and insulin over time."""
_TIMES_MG_DL: Final = {
    "time_below_54_pct": (0, 54),
    "time_below_70_pct": (0, 70),
    "time_70_180_pct": (70, 180),
    "time_above_180_pct": (180, HIGHEST_GLUCOSE_MG_DL),
    "time_above_250_pct": (250, HIGHEST_GLUCOSE_MG_DL),
}
"""Glucose from and to which the samples of a time in a range are counted."""


def glucose_edges() -> Edges:
    """Edges of the bins of glucose, mg/dl; values beyond them are counted in the outermost bins."""
    return GLUCOSE_BIN_MG_DL * np.arange(HIGHEST_GLUCOSE_MG_DL / GLUCOSE_BIN_MG_DL + 1, dtype=np.float64)


def insulin_edges(max_insulin_mU_min: float) -> Edges:
    """Edges of the bins of insulin, mU/min, up to the pump's limit or a little beyond."""
    bins = int(np.ceil(max_insulin_mU_min / INSULIN_BIN_MU_MIN)) + 1
    return INSULIN_BIN_MU_MIN * np.arange(bins + 1, dtype=np.float64)


def bin_numbers(values: npt.NDArray[np.floating], edges: Edges) -> npt.NDArray[np.intp]:
    """Number of the bin of each value, all of them finite; a value on an edge counts above it."""
    place = values * values.dtype.type(1.0 / edges[1])
    # limited before it is made whole: what is far beyond the last bin does not fit an integer
    np.clip(place, 0, edges.size - 2, out=place)
    return place.astype(np.intp)


def quantiles_of_counts(
    edges: Edges, counts: npt.NDArray[np.int64], probabilities: Sequence[float] = BAND_QUANTILES
) -> npt.NDArray[np.float64]:
    """Quantiles ``(probabilities, rows)`` from counts ``(rows, bins)``, linear within a bin; NaN for a row without any.

    They are in the bin of the true ones, so that the error is less than the width of the bin.
    """
    ends = np.cumsum(counts, axis=1, dtype=np.float64)
    total = ends[:, -1]
    rows = np.arange(counts.shape[0])
    result = np.full((len(probabilities), counts.shape[0]), np.nan)
    for row, probability in enumerate(probabilities):
        place = probability * total
        # The first bin whose end reaches the place, and which holds somebody.
        number = np.argmax((ends >= place[:, None]) & (counts > 0), axis=1)
        inside = counts[rows, number]
        share = (place - (ends[rows, number] - inside)) / np.maximum(inside, 1)
        result[row] = edges[number] + (edges[number + 1] - edges[number]) * share
    result[:, total == 0] = np.nan
    return result


def times_pct(counts: npt.NDArray[np.int64]) -> dict[str, npt.NDArray[np.float64]]:
    """Shares of counts of glucose ``(rows, bins)`` in each range, by the name of the metric; NaN for a row without any.

    They are of samples, while a metric looks at glucose between the samples too.
    """
    with np.errstate(invalid="ignore"):
        share = 100.0 * counts / counts.sum(axis=1, keepdims=True)
    per_mg_dl = round(1.0 / GLUCOSE_BIN_MG_DL)
    return {
        name: share[:, low * per_mg_dl : high * per_mg_dl].sum(axis=1) for name, (low, high) in _TIMES_MG_DL.items()
    }
