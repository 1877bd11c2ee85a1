"""Questions about a record whose columns are probably in other units than they should be.

A whole column is in another unit, not one row of it. So a column is judged by one number that is the same for all
people within a factor of some tens: the default step of time, the median of glucose, the mean rate of insulin.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import numpy.typing as npt

from glucoloop.refusal import Refusal
from glucoloop.unit_guess import CONFIRM_ARGUMENT, GLUCOSE, INSULIN_RATE, OtherUnit, Quantity, others_of
from glucoloop.units import MIN_PER_DAY, MU_PER_U

Floats = npt.NDArray[np.float64]

ROW_STEP = Quantity(
    "the time from row to row",
    "min",
    0.9,
    240.0,
    (*others_of("min", "h", "s"), OtherUnit("days", MIN_PER_DAY)),
)
"""Plausible time between rows: sensors give glucose every 1 to 15 minutes; by hand it is measured every few hours."""
MOSTLY = 0.5
"""Part of the rows without insulin above which the column is taken to hold boluses."""


def refuse_unusual_times(times_min: Floats) -> None:
    """Refuse times that look like hours, seconds or days."""
    if times_min.size > 1:
        step = float(np.median(np.diff(times_min)))
        _refuse_unusual(step, ROW_STEP, f"the rows of t_min are {_short(step)} min apart as a rule")


def refuse_unusual_glucose(glucose_mg_dl: Floats) -> None:
    """Refuse readings that look like mmol/l."""
    if not np.isnan(glucose_mg_dl).all():
        median = float(np.nanmedian(glucose_mg_dl))
        _refuse_unusual(median, GLUCOSE, f"the median of glucose_mg_dl is {_short(median)} mg/dl")


def refuse_unusual_insulin(insulin_mU_min: Floats, mean_mU_min: float, step_min: float) -> None:
    """Refuse rates that look like U/h or mU/h, and boluses in U."""
    given = insulin_mU_min[insulin_mU_min > 0.0]
    if not given.size:
        return
    quantity = INSULIN_RATE
    # Between boluses the rows are 0; a basal rate hardly ever is.
    if given.size < MOSTLY * insulin_mU_min.size:
        bolus = OtherUnit(f"boluses in U, each over the {_short(step_min)} min of its row", MU_PER_U / step_min)
        quantity = dataclasses.replace(quantity, others=(bolus, *quantity.others))
    result = (
        f"insulin_mU_min has values from {_short(insulin_mU_min.min())} to {_short(insulin_mU_min.max())}, on average "
        f"{_short(mean_mU_min)} mU/min, which is {_short(mean_mU_min * MIN_PER_DAY / MU_PER_U)} U a day"
    )
    _refuse_unusual(mean_mU_min, quantity, result)


def _refuse_unusual(value: float, quantity: Quantity, result: str) -> None:
    """Refuse a column of which one number shows that it is in another unit, or in no known unit."""
    if quantity.plausible(value):
        return
    confirm = f"or {CONFIRM_ARGUMENT} if {quantity.unit} are meant"
    for other, _ in quantity.meant(value):
        raise Refusal(
            f"{result}; that looks like {other.name}. Multiply the column by {other.factor:.4g} to have "
            f"{quantity.unit}, {confirm}"
        )
    raise Refusal(
        f"{result}; usual is from {quantity.least:g} to {quantity.most:g} {quantity.unit}. "
        f"Convert the column, {confirm}"
    )


def _short(value: float) -> str:
    return f"{value:.0f}" if abs(value) >= 100.0 else f"{value:.3g}"
