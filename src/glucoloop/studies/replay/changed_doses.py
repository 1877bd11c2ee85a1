"""Doses of a record under a change of the therapy, as the person's bolus calculator would have given them.

Basal insulin is scaled or set in its hours. A bolus of the user belongs to the carbohydrate that was entered within
30 min of it; where the calculator would have computed another dose, the recorded one is changed by the difference::

    carbs / CR,    (G - target) / CF

so that what the person added or left out stays. No bolus falls below 0, carbohydrate without a bolus gets none, and
boluses of automation and later corrections stay as they were recorded.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from glucoloop.forecasts.grid import SAMPLE_MIN, GriddedRecord
from glucoloop.situations.therapy_text import BolusShift, CarbCount, Change
from glucoloop.text import how_many
from glucoloop.therapy import TARGET, TherapyChange
from glucoloop.units import MIN_PER_DAY, MU_PER_U

Values = npt.NDArray[np.float64]

_NEAR: Final = 6
"""Samples, 30 min, within which carbohydrate and a bolus belong together."""
_FRESH: Final = 3
"""Samples, 15 min, for which a reading is used."""


@dataclass(frozen=True)
class CalculatorNumbers:
    """Numbers of a bolus calculator."""

    carb_ratio_g_U: float
    correction_mg_dl_U: float
    target_mg_dl: float


class _ChangedDoses(NamedTuple):
    """Record with other doses, and what was changed in it."""

    record: GriddedRecord
    note: str
    """Sentence on the doses that were changed."""


@dataclass(frozen=True)
class _Bolus:
    """A bolus of the user: samples in a row that have one."""

    begin: int
    end: int
    carbs_g: float
    reading_mg_dl: float
    """Last reading at its beginning; NaN where there is none."""

    @property
    def time_of_day_min(self) -> float:
        """Time of day at which it begins."""
        return SAMPLE_MIN * self.begin % MIN_PER_DAY


def changed_doses(record: GriddedRecord, change: Change, numbers: CalculatorNumbers) -> _ChangedDoses:
    """Doses of a record under a change, by a calculator with the given numbers."""
    if isinstance(change, TherapyChange) and change.field == "basal_mU_min":
        inside = np.array([change.holds(SAMPLE_MIN * sample) for sample in record.clock.tolist()])
        value_U = None if change.value is None else change.value * SAMPLE_MIN / MU_PER_U
        basal = np.where(inside, record.basal_U * change.factor if value_U is None else value_U, record.basal_U)
        automation = ", with that of automation" if record.automated else ""
        return _ChangedDoses(
            dataclasses.replace(record, basal_U=basal),
            f"basal insulin is {basal.sum() / record.days:.1f} U a day instead of "
            f"{record.basal_U.sum() / record.days:.1f} U{automation}.",
        )
    boluses = list(_boluses(record))
    if isinstance(change, BolusShift):
        return _moved(record, boluses, change)
    result, changed = record.user_bolus_U.copy(), 0
    for bolus in boluses:
        more_U, samples = _difference_U(bolus, change, numbers), slice(bolus.begin, bolus.end)
        dose_U = float(result[samples].sum())
        result[samples] *= max(dose_U + more_U, 0.0) / dose_U
        changed += more_U != 0.0
    return _ChangedDoses(dataclasses.replace(record, user_bolus_U=result), _note(record, boluses, changed, result))


def _boluses(record: GriddedRecord) -> Iterator[_Bolus]:
    """Boluses of the user in their order, each with the carbohydrate that is nearest to it."""
    given = np.concatenate([[0], (record.user_bolus_U > 0.0).astype(int), [0]])
    begins, ends = np.flatnonzero(np.diff(given) == 1), np.flatnonzero(np.diff(given) == -1)
    carbs = np.zeros(begins.size)
    for at in np.flatnonzero(record.carbs_g).tolist():
        away = np.maximum(np.maximum(begins - at, at - (ends - 1)), 0)
        if away.size and away.min() <= _NEAR:
            carbs[away.argmin()] += record.carbs_g[at]
    for begin, end, carbs_g in zip(begins.tolist(), ends.tolist(), carbs.tolist(), strict=True):
        recent = record.reading_mg_dl[max(begin - _FRESH, 0) : begin + 1]
        there = recent[np.isfinite(recent)]
        yield _Bolus(begin, end, carbs_g, float(there[-1]) if there.size else np.nan)


def _difference_U(bolus: _Bolus, change: TherapyChange | CarbCount, numbers: CalculatorNumbers) -> float:
    """Insulin by which a calculator would have changed a bolus."""
    if isinstance(change, CarbCount):
        return (change.percent / 100.0 - 1.0) * bolus.carbs_g / numbers.carb_ratio_g_U
    if not change.holds(bolus.time_of_day_min):
        return 0.0
    own: float = getattr(numbers, change.field)
    new = own * change.factor if change.value is None else change.value
    if change.field == "carb_ratio_g_U":
        return bolus.carbs_g * (1.0 / new - 1.0 / own)
    if not np.isfinite(bolus.reading_mg_dl):
        return 0.0
    if change.field == TARGET:
        return (own - new) / numbers.correction_mg_dl_U
    return (bolus.reading_mg_dl - numbers.target_mg_dl) * (1.0 / new - 1.0 / own)


def _moved(record: GriddedRecord, boluses: list[_Bolus], change: BolusShift) -> _ChangedDoses:
    """Boluses with carbohydrate at another time, but within the record."""
    result, moved = record.user_bolus_U.copy(), 0
    samples = round(change.earlier_min / SAMPLE_MIN)
    with_carbs = [bolus for bolus in boluses if bolus.carbs_g]
    for bolus in with_carbs:
        result[bolus.begin : bolus.end] = 0.0
    for bolus in with_carbs:
        places = np.clip(np.arange(bolus.begin, bolus.end) - samples, 0, result.size - 1)
        np.add.at(result, places, record.user_bolus_U[bolus.begin : bolus.end])
        moved += 1
    return _ChangedDoses(
        dataclasses.replace(record, user_bolus_U=result),
        f"{how_many(moved, 'bolus', 'boluses')} with carbohydrate moved.",
    )


def _note(record: GriddedRecord, boluses: list[_Bolus], changed: int, result_U: Values) -> str:
    before_U, after_U = (float(of.sum()) / record.days for of in (record.user_bolus_U, result_U))
    number = how_many(len(boluses), "bolus", "boluses")
    return f"{changed} of {number} of the user changed, {after_U:.1f} U a day instead of {before_U:.1f} U."
