"""Bins in which a trial counts glucose and insulin over time.

Counts of any number of people take the same room, add exactly, and give quantiles to the width of a bin.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

Edges = npt.NDArray[np.float64]

HIGHEST_GLUCOSE_MG_DL: Final = 600
GLUCOSE_BIN_MG_DL: Final = 1.0
INSULIN_BIN_MU_MIN: Final = 0.25


def glucose_edges() -> Edges:
    """Edges of the bins of glucose, mg/dl; values beyond them are counted in the outermost bins."""
    return GLUCOSE_BIN_MG_DL * np.arange(HIGHEST_GLUCOSE_MG_DL / GLUCOSE_BIN_MG_DL + 1, dtype=np.float64)


def insulin_edges(max_insulin_mU_min: float) -> Edges:
    """Edges of the bins of insulin, mU/min, up to the pump's limit or a little beyond."""
    bins = int(np.ceil(max_insulin_mU_min / INSULIN_BIN_MU_MIN)) + 1
    return INSULIN_BIN_MU_MIN * np.arange(bins + 1, dtype=np.float64)


def count(values: npt.NDArray[np.floating], edges: Edges) -> npt.NDArray[np.int64]:
    """Number of people in each bin, row by row.

    Parameters
    ----------
    values : (rows, people) array
        Finite values.
    edges : (bins + 1,) array
        Edges, evenly spaced from 0.

    Returns
    -------
    (rows, bins) array
        A value on an edge counts in the bin above it.
    """
    rows, bins = values.shape[0], edges.size - 1
    place = values * values.dtype.type(1.0 / edges[1])
    # limited before it is made whole: what is far beyond the last bin does not fit an integer
    np.clip(place, 0, bins - 1, out=place)
    number = place.astype(np.intp)
    number += (bins * np.arange(rows))[:, None]
    return np.bincount(number.ravel(), minlength=rows * bins).reshape(rows, bins)
