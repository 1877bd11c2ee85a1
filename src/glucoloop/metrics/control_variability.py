"""Control-variability grid: each person at the minimum and the maximum glucose, and the zone of that point.

Magni, Raimondo, Dalla Man, Breton, Patek, De Nicolao, Cobelli & Kovatchev, "Evaluating the efficacy of closed-loop
glucose regulation via control-variability grid analysis", J. Diabetes Sci. Technol. 2(4):630-635, 2008.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from glucoloop.refusal import Refusal

Floats = npt.NDArray[np.float64]

ZONES: Final = ("A", "B", "C", "D", "E")
MINIMUM_LIMITS_MG_DL: Final = (50.0, 70.0, 90.0, 110.0)
"""Limits between columns of the grid, which are drawn from right to left."""
MAXIMUM_LIMITS_MG_DL: Final = (110.0, 180.0, 300.0, 400.0)
"""Limits between rows of the grid, which are drawn upwards."""
CELLS: Final = 20
"""Number of cells of a column and of a row."""

# By column from the lowest minimum on, and by row from the lowest maximum on.
_ZONES: Final = np.array([["C", "D", "E"], ["B", "B", "D"], ["A", "B", "C"]])
_REGIONS: Final = np.array([["lower C", "lower D", "E"], ["lower B", "B", "upper D"], ["A", "upper B", "upper C"]])


def _edges(limits: tuple[float, ...]) -> Floats:
    parts = [np.linspace(low, high, CELLS, endpoint=False) for low, high in pairwise(limits)]
    return np.append(np.concatenate(parts), limits[-1])


MINIMUM_EDGES_MG_DL: Final = _edges(MINIMUM_LIMITS_MG_DL)
"""(61,) edges of the cells, 1 mg/dl apart."""
MAXIMUM_EDGES_MG_DL: Final = _edges(MAXIMUM_LIMITS_MG_DL)
"""(61,) edges of the cells, 3.5, 6 and 5 mg/dl apart, so that rows are drawn equally high."""


def grid_counts(minimum_mg_dl: npt.ArrayLike, maximum_mg_dl: npt.ArrayLike) -> npt.NDArray[np.int64]:
    """People in each cell of the grid ``(60, 60)``, by minimum and by maximum, both rising.

    Counts of parts of a population add up. Glucose beyond the grid is counted in the cells of its border. A cell
    includes its lower edges. People for whom either number is not finite are not counted.
    """
    minimum, maximum = np.asarray(minimum_mg_dl, float), np.asarray(maximum_mg_dl, float)
    if minimum.shape != maximum.shape:
        raise Refusal(
            f"there are minima of shape {minimum.shape} and maxima of shape {maximum.shape}; give one of each per "
            "person"
        )
    counted = np.isfinite(minimum) & np.isfinite(maximum)
    column = _cell(MINIMUM_EDGES_MG_DL, minimum[counted])
    row = _cell(MAXIMUM_EDGES_MG_DL, maximum[counted])
    rows = MAXIMUM_EDGES_MG_DL.size - 1
    columns = MINIMUM_EDGES_MG_DL.size - 1
    return np.bincount(column * rows + row, minlength=columns * rows).reshape(columns, rows).astype(np.int64)


def _cell(edges: Floats, values: Floats) -> npt.NDArray[np.intp]:
    return np.clip(np.searchsorted(edges, values, side="right") - 1, 0, edges.size - 2)


def zones(minimum_mg_dl: npt.ArrayLike, maximum_mg_dl: npt.ArrayLike) -> npt.NDArray[np.str_]:
    """The zone of each person: A accurate, B benign deviations, C overcorrection, D failure to correct, E erroneous.

    A limit between two zones belongs to the side of higher glucose, as a cell of `grid_counts` does. A person for whom
    either number is not finite has the zone "".
    """
    minimum, maximum = np.broadcast_arrays(np.asarray(minimum_mg_dl, float), np.asarray(maximum_mg_dl, float))
    column = np.searchsorted(MINIMUM_LIMITS_MG_DL[1:-1], minimum, side="right")
    row = np.searchsorted(MAXIMUM_LIMITS_MG_DL[1:-1], maximum, side="right")
    return np.where(np.isfinite(minimum) & np.isfinite(maximum), _ZONES[column, row], "")


def zone_pct(counts: npt.NDArray[Any]) -> dict[str, float]:
    """Percentage of people in each zone, "A" to "E", from the counts of `grid_counts`; NaN if nobody is counted."""
    shares = _shares(counts)
    return {zone: float(shares[_ZONES == zone].sum()) for zone in ZONES}


def region_pct(counts: npt.NDArray[Any]) -> dict[str, float]:
    """Percentage of people in each of nine regions, by column from the lowest minimum on; NaN if nobody is counted."""
    return dict(zip(_REGIONS.ravel().tolist(), _shares(counts).ravel().tolist(), strict=True))


def _shares(counts: npt.NDArray[Any]) -> Floats:
    """(3, 3) percentages by column and row."""
    values = np.asarray(counts, float)
    shape = (MINIMUM_EDGES_MG_DL.size - 1, MAXIMUM_EDGES_MG_DL.size - 1)
    if values.shape != shape:
        raise Refusal(f"the counts have shape {values.shape}, a control-variability grid has {shape}; use grid_counts")
    total = values.sum()
    people = values.reshape(3, CELLS, 3, CELLS).sum(axis=(1, 3))
    return 100.0 * people / total if total else np.full((3, 3), np.nan)
