"""Record for identification: insulin infused and glucose read."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any, Final

import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
from jax import Array
from numpy.typing import ArrayLike

from glucoloop._pytree import pytree, static
from glucoloop._representation import represented
from glucoloop.arguments import checked
from glucoloop.identification import _check
from glucoloop.refusal import Refusal
from glucoloop.unit_guess import CONFIRM_ARGUMENT, GLUCOSE, INSULIN_RATE, OtherUnit, Quantity, others_of
from glucoloop.units import MIN_PER_DAY, MU_PER_U, number_of

HIGHEST_GLUCOSE_MG_DL = 2000.0
HIGHEST_INSULIN_MU_MIN = 10_000.0
LARGEST_MEAL_G = 1000.0
# Two thousand years; beyond it a float no longer tells the parts of a minute apart.
LATEST_MIN = 1e9
# Times within this part of a sample are the same time.
ON_GRID = 1e-6
_NUMBER_OF: Final = {
    "time": "give the minutes from any moment on, or leave the row out",
    "insulin": "give the rate in mU/min, or leave the row out to hold the one before",
    "glucose": "give the reading in mg/dl, or mark it as missing, with NaN or an empty cell",
    "carbohydrate": "give the grams alone, or leave the cell empty",
}
"""Remedy for a value of each column that is no number."""
FROM_ZERO = " (counted from 0)"
"""Words about a row, as arrays have it."""

Floats = npt.NDArray[np.float64]


@represented
@pytree
class Record:
    """N samples of insulin, and the N + 1 glucose readings at their ends.

    ``insulin_mU_min[k]`` is held from t_k to t_(k+1) and ``glucose_mg_dl[k]`` is the reading at t_k, t_k = k times the
    sample time. So reading k depends on the insulin of samples k-1, k-2, ..., and the last reading closes the last
    sample: there is one reading more than there are samples.
    """

    insulin_mU_min: Array
    """``(N,)``, absolute infusion."""
    glucose_mg_dl: Array
    """``(N + 1,)``, absolute readings."""
    sample_time_min: float = static()
    carbs_g: Array | None = None
    """``(N,)``, carbohydrate eaten in each sample; None where nothing is known of meals."""


@checked
def record_from_samples(
    t_min: ArrayLike | Sequence[object],
    insulin_mU_min: ArrayLike | Sequence[object],
    glucose_mg_dl: ArrayLike | Sequence[object],
    carbs_g: ArrayLike | Sequence[object] | None = None,
    *,
    sample_time_min: float = 5.0,
    max_gap_min: float = 15.0,
    allow_unusual: bool = False,
) -> tuple[Record, tuple[str, ...]]:
    """Bring a table of times, insulin rates and readings to a record at a constant sample time.

    Insulin is a held input: each row's rate lasts until the next row, and the record carries its exact time average
    over each sample. Glucose is interpolated linearly between readings. A reading that is NaN or None is missing.
    Rows before the first reading and after the last, and what is left over after the last whole sample, are left out;
    so is the rate of the last row, which no reading follows. Carbohydrate is added up over each sample.

    Parameters
    ----------
    t_min : array_like, shape (n,)
        Times, increasing, from -1e9 to 1e9 [min].
    insulin_mU_min : array_like, shape (n,)
        Rate from this row to the next, from 0 to 10 000 [mU/min].
    glucose_mg_dl : array_like, shape (n,)
        Reading at this row, above 0 and at most 2000, or NaN where it is missing [mg/dl].
    carbs_g : array_like, shape (n,), optional
        Carbohydrate eaten at this row, from 0 to 1000, or NaN for nothing [g].
    sample_time_min : float
        Sample time of the record [min].
    max_gap_min : float
        Longest time between two readings that is bridged by interpolation [min].
    allow_unusual : bool
        Whether columns are taken as they are that look like another unit: hours or seconds, U/h or boluses in U,
        mmol/l.

    Returns
    -------
    record : Record
        The record, its first reading at the first row that has one.
    notes : tuple of str
        Changes of the data, one sentence each; empty if they were used as they are.

    Raises
    ------
    ValueError
        If a column isn't numeric or the columns differ in length, times don't increase, a rate or a reading is out
        of bounds, a column looks like another unit, a gap is too long, or less than one sample remains.
    """
    sample_time = _check.positive("The sample time", sample_time_min, "min")
    if not np.isfinite(max_gap_min) or max_gap_min < sample_time:
        raise Refusal(
            f"The longest gap is {max_gap_min} min: it must be at least the sample time, {sample_time:g} min."
        )
    times, insulin, glucose = _columns(t_min, insulin_mU_min, glucose_mg_dl)
    carbs = None if carbs_g is None else _carbs(carbs_g, times.size)
    if not allow_unusual:
        _refuse_unusual_times(times)
        _refuse_unusual_glucose(glucose)
    read = np.flatnonzero(~np.isnan(glucose))
    _refuse_gaps(times[read], max_gap_min)
    span = times[read[-1]] - times[read[0]] if read.size else 0.0
    samples = int(span / sample_time + ON_GRID)
    if samples < 1:
        raise Refusal(
            f"Rows of the record with a glucose reading: {read.size} of {times.size}, which span {span:g} min. "
            f"At least 2 readings are needed that are one sample of {sample_time:g} min apart."
        )

    grid = np.minimum(times[read[0]] + sample_time * np.arange(samples + 1), times[read[-1]])
    notes = _notes(times, read, grid, sample_time)
    record = Record(
        insulin_mU_min=jnp.asarray(_zero_order_average(times, insulin, grid, sample_time)),
        glucose_mg_dl=jnp.asarray(np.interp(grid, times[read], glucose[read])),
        sample_time_min=sample_time,
        carbs_g=None if carbs is None else jnp.asarray(_eaten(times, carbs, grid, sample_time)),
    )
    if not allow_unusual:
        _refuse_unusual_insulin(insulin, float(record.insulin_mU_min.mean()), float(np.median(np.diff(times))))
    return record, notes


def _columns(*columns: ArrayLike | Sequence[object]) -> list[Floats]:
    """Times, insulin and glucose as numbers, each value within its bounds."""
    times, insulin, glucose = (_numbers(n, c) for n, c in zip(("time", "insulin", "glucose"), columns, strict=True))
    if not times.size == insulin.size == glucose.size:
        raise Refusal(
            f"{times.size} times, {insulin.size} insulin rates and {glucose.size} readings do not pair up: "
            "give one of each per row."
        )
    _refuse_rows(~np.isfinite(times), "time", times, "a finite number of minutes", "leave the row out")
    _refuse_rows(
        np.abs(times) > LATEST_MIN,
        "time",
        times,
        f"from {-LATEST_MIN:g} to {LATEST_MIN:g} min",
        "count from the first row",
    )
    _refuse_rows(
        np.diff(times, prepend=-np.inf) <= 0,
        "time",
        times,
        "later than the row before",
        "sort the rows and keep one for each time",
    )
    _refuse_rows(
        ~((insulin >= 0) & (insulin <= HIGHEST_INSULIN_MU_MIN)),
        "insulin rate",
        insulin,
        f"a finite number of mU/min, at least 0 and at most {HIGHEST_INSULIN_MU_MIN:g}",
        "give the rate that was infused, or leave the row out to hold the one before",
    )
    _refuse_rows(
        ~(np.isnan(glucose) | ((glucose > 0) & (glucose <= HIGHEST_GLUCOSE_MG_DL))),
        "reading",
        glucose,
        f"above 0 and at most {HIGHEST_GLUCOSE_MG_DL:g} mg/dl",
        "mark a missing reading as NaN",
    )
    return [times, insulin, glucose]


def _carbs(column: ArrayLike | Sequence[object], rows: int) -> Floats:
    """Carbohydrate of each row, nothing where the cell is empty."""
    carbs = np.nan_to_num(_numbers("carbohydrate", column), nan=0.0, posinf=np.inf, neginf=-np.inf)
    if carbs.size != rows:
        raise Refusal(f"{carbs.size} amounts of carbohydrate and {rows} times do not pair up: give one per row.")
    _refuse_rows(
        ~((carbs >= 0) & (carbs <= LARGEST_MEAL_G)),
        "carbohydrate",
        carbs,
        f"from 0 to {LARGEST_MEAL_G:g} g",
        "give what was eaten at this row, or leave the cell empty",
    )
    return carbs


def _eaten(times: Floats, carbs: Floats, grid: Floats, sample_time: float) -> Floats:
    """Carbohydrate of each sample, its own beginning included."""
    sample = np.floor((times - grid[0]) / sample_time + ON_GRID).astype(int)
    within = (sample >= 0) & (sample < len(grid) - 1)
    eaten = np.zeros(len(grid) - 1)
    np.add.at(eaten, sample[within], carbs[within])
    return eaten


def _numbers(name: str, column: ArrayLike | Sequence[object]) -> Floats:
    if getattr(getattr(column, "dtype", None), "kind", None) in ("m", "M"):
        raise Refusal(f"The {name} column holds dates: give numbers, for times the minutes since the first row.")
    try:
        if isinstance(column, np.ma.MaskedArray):
            column = np.ma.filled(column.astype(float), np.nan)
        values = np.asarray(column, dtype=object)
        numbers = np.asarray([_number(value) for value in values] if values.ndim == 1 else column, dtype=float)
    except (TypeError, ValueError, OverflowError):
        for row, value in enumerate(np.asarray(column, dtype=object)):
            try:
                float(_number(value))
            except (TypeError, ValueError, OverflowError):
                raise Refusal(
                    f"The {name} in row {row}{FROM_ZERO} is {value!r}: it must be a number; {_NUMBER_OF[name]}."
                ) from None
        raise
    if numbers.ndim != 1:
        raise Refusal(f"The {name} column has shape {numbers.shape}: it must be one-dimensional, one value per row.")
    return numbers


def _number(value: Any) -> Any:
    """A value, a text as a number: NumPy would take one with underscores or with digits of another script."""
    return number_of(value) if isinstance(value, str) else value


def _refuse_rows(refused: npt.NDArray[np.bool_], name: str, values: Floats, bound: str, mend: str) -> None:
    if refused.any():
        row = int(np.argmax(refused))
        value = "missing" if np.isnan(values[row]) else f"{values[row]:g}"
        raise Refusal(f"The {name} in row {row}{FROM_ZERO} is {value}: it must be {bound}; {mend}.")


def _refuse_gaps(read_min: Floats, max_gap_min: float) -> None:
    gaps = np.diff(read_min)
    if gaps.size and gaps.max() > max_gap_min * (1 + ON_GRID):
        before = int(np.argmax(gaps))
        raise Refusal(
            f"No reading between {read_min[before]:g} and {read_min[before + 1]:g} min: the gap of {gaps[before]:g} "
            f"min is longer than {max_gap_min:g} min. Use the part before or after it, or raise max_gap_min."
        )


def _off_grid(times: Floats, grid: Floats, sample_time: float) -> bool:
    """Whether a row lies inside a sample, so that its insulin rate begins there."""
    inside = times[(times > grid[0]) & (times < grid[-1])]
    steps = (inside - grid[0]) / sample_time
    return bool((np.abs(steps - np.round(steps)) > ON_GRID).any())


def _zero_order_average(times: Floats, insulin: Floats, grid: Floats, sample_time: float) -> Floats:
    """Time average over each sample of rates held from row to row."""
    if not _off_grid(times, grid, sample_time):
        return insulin[np.searchsorted(times, grid[:-1] + ON_GRID * sample_time, side="right") - 1]
    delivered = np.concatenate([[0.0], np.cumsum(insulin[:-1] * np.diff(times))])
    # A difference of totals may round to just below zero where nothing was infused.
    average: Floats = np.maximum(np.diff(np.interp(grid, times, delivered)) / np.diff(grid), 0.0)
    return average


def _notes(times: Floats, read: npt.NDArray[np.intp], grid: Floats, sample_time: float) -> tuple[str, ...]:
    readings = times[read]
    after = np.clip(np.searchsorted(readings, grid), 1, len(readings) - 1)
    distance = np.minimum(np.abs(readings[after] - grid), np.abs(readings[after - 1] - grid))
    missing = distance > sample_time / 2
    shifted = (distance > ON_GRID * sample_time) & ~missing
    beyond = int(read[0] + len(times) - 1 - read[-1])
    rest = readings[-1] - grid[-1]

    notes = []
    if beyond:
        notes.append(f"{beyond} of {len(times)} rows come before the first reading or after the last: left out.")
    if missing.any():
        notes.append(f"{missing.sum()} of {len(grid)} samples were missing and were interpolated.")
    if shifted.any():
        notes.append(
            f"{shifted.sum()} of {len(grid)} samples had their reading up to {distance[shifted].max():.3g} min away "
            "and were interpolated."
        )
    if _off_grid(times, grid, sample_time):
        notes.append("Insulin changed within samples and was averaged over each.")
    if rest > ON_GRID * sample_time:
        notes.append(f"The last {rest:.3g} min do not fill a sample: left out.")
    return tuple(notes)


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


def _refuse_unusual_times(times_min: Floats) -> None:
    """Refuse times that look like hours, seconds or days."""
    if times_min.size > 1:
        step = float(np.median(np.diff(times_min)))
        _refuse_unusual(step, ROW_STEP, f"the rows of t_min are {_short(step)} min apart as a rule")


def _refuse_unusual_glucose(glucose_mg_dl: Floats) -> None:
    """Refuse readings that look like mmol/l."""
    if not np.isnan(glucose_mg_dl).all():
        median = float(np.nanmedian(glucose_mg_dl))
        _refuse_unusual(median, GLUCOSE, f"the median of glucose_mg_dl is {_short(median)} mg/dl")


def _refuse_unusual_insulin(insulin_mU_min: Floats, mean_mU_min: float, step_min: float) -> None:
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
