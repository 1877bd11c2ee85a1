"""Errors of forecasts of people, summed up for each person, over all people, and between methods."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from glucoloop.forecasts.scores import ForecastErrors

_DRAWS: Final = 2000
"""Number of bootstrap samples; the same ones for the same number of people."""
FUTURES: Final = {True: "known", False: "unknown"}
"""Name of what a forecast knows of meals and boluses of the user to come."""


class PersonErrors(NamedTuple):
    """Forecasts of one person, by one method, with one future, at one horizon."""

    person: str
    method: str
    future: str
    horizon: str
    errors: ForecastErrors

    @property
    def rmse_mg_dl(self) -> float:
        """Root of the mean squared error."""
        return float(np.sqrt(np.mean(self.errors.error_mg_dl**2)))

    def row(self) -> dict[str, Any]:
        """Numbers of the cell by name."""
        error = self.errors.error_mg_dl
        return {
            "person": self.person,
            "method": self.method,
            "future": self.future,
            "horizon": self.horizon,
            "forecasts": error.size,
            "rmse_mg_dl": self.rmse_mg_dl,
            "mae_mg_dl": float(np.mean(np.abs(error))),
            "mean_error_mg_dl": float(np.mean(error)),
            "covered_pct": 100.0 * float(np.mean(self.errors.covered)),
        }


def pooled_rows(cells: Sequence[PersonErrors]) -> Iterator[dict[str, Any]]:
    """Numbers over all people of each method, future and horizon."""
    for (method, future, horizon), alike in _grouped(cells):
        rows = [cell.row() for cell in alike]
        rmse, mae, covered = (
            np.array([row[name] for row in rows]) for name in ("rmse_mg_dl", "mae_mg_dl", "covered_pct")
        )
        error = np.concatenate([cell.errors.error_mg_dl for cell in alike])
        yield {
            "method": method,
            "future": future,
            "horizon": horizon,
            "people": len(rows),
            "forecasts": error.size,
            "median_rmse_mg_dl": float(np.median(rmse)),
            "lowest_rmse_mg_dl": float(rmse.min()),
            "highest_rmse_mg_dl": float(rmse.max()),
            "median_mae_mg_dl": float(np.median(mae)),
            "rmse_of_all_mg_dl": float(np.sqrt(np.mean(error**2))),
            "median_covered_pct": float(np.median(covered)),
            "lowest_covered_pct": float(covered.min()),
            "highest_covered_pct": float(covered.max()),
        }


def differences(cells: Sequence[PersonErrors], first: str) -> Iterator[dict[str, Any]]:
    """Root mean squared error of each other method less that of the first one, paired by person.

    The interval of 95 % is a bootstrap over people; where there is one person, over the days held out.
    """
    of_first = {(cell.person, cell.future, cell.horizon): cell for cell in cells if cell.method == first}
    for (method, future, horizon), alike in _grouped(cells):
        pairs = [(cell, of_first[key]) for cell in alike if (key := (cell.person, future, horizon)) in of_first]
        if method == first or not pairs:
            continue
        difference = np.array([cell.rmse_mg_dl - other.rmse_mg_dl for cell, other in pairs])
        low, high = _over_people(difference) if difference.size > 1 else _over_days(*pairs[0])
        yield {
            "method": method,
            "first": first,
            "future": future,
            "horizon": horizon,
            "people": difference.size,
            "difference_mg_dl": float(difference.mean()),
            "low_mg_dl": low,
            "high_mg_dl": high,
            "first_better_people": int((difference > 0.0).sum()),
        }


def _grouped(cells: Iterable[PersonErrors]) -> list[tuple[tuple[str, str, str], list[PersonErrors]]]:
    """Cells of all people by method, future and horizon, in the order of the first of each."""
    groups: dict[tuple[str, str, str], list[PersonErrors]] = {}
    for cell in cells:
        groups.setdefault((cell.method, cell.future, cell.horizon), []).append(cell)
    return list(groups.items())


def _draws(size: int) -> npt.NDArray[np.int64]:
    """Bootstrap samples ``(draws, size)`` of the numbers from 0."""
    return np.random.default_rng(0).integers(0, size, (_DRAWS, size))


def _over_people(differences: npt.NDArray[np.float64]) -> tuple[float, float]:
    """Interval of 95 % of the mean over people."""
    return _interval(differences[_draws(differences.size)].mean(axis=1))


def _over_days(cell: PersonErrors, first: PersonErrors) -> tuple[float | None, float | None]:
    """Interval of 95 % of the difference of one person over days; none for fewer than two days with readings."""
    day = cell.errors.day
    days = np.unique(day)
    if days.size < 2:
        return None, None
    place = np.searchsorted(days, day)
    draws, count = _draws(days.size), np.bincount(place)
    rmse = [
        np.sqrt(np.bincount(place, one.errors.error_mg_dl**2)[draws].sum(axis=1) / count[draws].sum(axis=1))
        for one in (cell, first)
    ]
    return _interval(rmse[0] - rmse[1])


def _interval(values: npt.NDArray[np.float64]) -> tuple[float, float]:
    low, high = np.percentile(values, (2.5, 97.5))
    return float(low), float(high)
