"""Metrics of the readings whatever their order: sufficiency, mean and variation, times in ranges, risk, quality.

Each reading counts for the time that it stands for, see `Readings.weight_min`; where all stand for the same, alike.

References
----------
T. Battelino et al., "Clinical targets for continuous glucose monitoring data interpretation: recommendations from the
international consensus on time in range", Diabetes Care 42(8), 1593-1603, 2019: ranges, 14 days, 70 % of the readings.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from glucoloop.metrics.formulas import glycemia_risk_index, gmi_pct, symmetric_glucose
from glucoloop.metrics.readings.series import Floats, Readings
from glucoloop.units import MIN_PER_DAY

_MG_DL_PER_MMOL_L_OF_GRADE = 18.0
_MIN_OF_A_DAY = 3
"""Minimum number of readings of a day that counts for the ADRR, after Kovatchev et al. (2006)."""

Numbers = Mapping[str, float]


def sufficiency(readings: Readings) -> Numbers:
    """Days from the first reading to the last, both included, number of readings, and the share of time they stand for.

    Where all readings stand for the same time it is their share of those expected: one at each interval, the median
    time between readings, from the first to the last. Else it is the time that they stand for, of that from the first
    to the last, in which each gap counts in whole steps.
    """
    span = readings.t_min[-1] - readings.t_min[0] + readings.interval_min
    count = readings.t_min.size
    weights = readings.weight_min
    if weights is None:
        active = 100.0 * count / readings.expected
    else:
        steps = np.maximum(1.0, np.rint(np.diff(readings.t_min) / weights[:-1]))
        active = 100.0 * float(weights.sum()) / float((steps * weights[:-1]).sum() + weights[-1])
    return {"days": span / MIN_PER_DAY, "readings": float(count), "active_pct": min(100.0, active)}


def mean_and_variation(readings: Readings) -> Numbers:
    """Mean, standard deviation with ``n - 1`` as its denominator, coefficient of variation, and GMI."""
    glucose = readings.glucose_mg_dl
    mean = readings.mean(glucose)
    if readings.weight_min is None:
        deviation = float(glucose.std(ddof=1))
    else:
        deviation = math.sqrt(readings.mean((glucose - mean) ** 2) * glucose.size / (glucose.size - 1))
    return {
        "mean_mg_dl": mean,
        "sd_mg_dl": deviation,
        "cv_pct": 100.0 * deviation / mean,
        "gmi_pct": gmi_pct(mean),
    }


def times_in_ranges(readings: Readings) -> Numbers:
    """Percentages of time in ranges; 70, 180, 140, 63 and 250 mg/dl belong to the range they end or begin."""
    glucose = readings.glucose_mg_dl

    def share(inside: npt.NDArray[np.bool_]) -> float:
        if readings.weight_min is not None:
            return 100.0 * readings.mean(inside)
        return 100.0 * float(np.count_nonzero(inside)) / glucose.size

    below_54, below_70 = share(glucose < 54.0), share(glucose < 70.0)
    above_180, above_250 = share(glucose > 180.0), share(glucose > 250.0)
    return {
        "time_above_250_pct": above_250,
        "time_180_250_pct": share((glucose > 180.0) & (glucose <= 250.0)),
        "time_above_180_pct": above_180,
        "time_70_180_pct": share((glucose >= 70.0) & (glucose <= 180.0)),
        "time_below_70_pct": below_70,
        "time_54_70_pct": share((glucose >= 54.0) & (glucose < 70.0)),
        "time_below_54_pct": below_54,
        "time_70_140_pct": share((glucose >= 70.0) & (glucose <= 140.0)),
        "time_above_140_pct": share(glucose > 140.0),
        "time_63_140_pct": share((glucose >= 63.0) & (glucose <= 140.0)),
        "time_below_63_pct": share(glucose < 63.0),
        "time_54_63_pct": share((glucose >= 54.0) & (glucose < 63.0)),
    }


def glycemia_risk(readings: Readings) -> Numbers:
    """Glycemia risk index with its components ``VLow + 0.8 Low`` and ``VHigh + 0.5 High``; zones A to E are 20 wide.

    References
    ----------
    D. C. Klonoff et al., J. Diabetes Sci. Technol. 17(5), 1226-1242, 2023.
    """
    times = times_in_ranges(readings)
    risk = glycemia_risk_index(
        np,
        times["time_below_54_pct"],
        times["time_below_70_pct"],
        times["time_above_250_pct"],
        times["time_above_180_pct"],
    )
    return {
        "gri": float(risk),
        "gri_hypo_pct": times["time_below_54_pct"] + 0.8 * times["time_54_70_pct"],
        "gri_hyper_pct": times["time_above_250_pct"] + 0.5 * times["time_180_250_pct"],
    }


def gri_zone(gri: float) -> str:
    """Zone of the glycemia risk index: A from 0 to 20, B to 40, C to 60, D to 80, E beyond."""
    return "ABCDE"[int(np.searchsorted([20.0, 40.0, 60.0, 80.0], gri, side="left"))]


def risk_indices(readings: Readings) -> Numbers:
    """Low and high blood glucose index, their sum, and the average daily risk range.

    ::

        LBGI = mean(10 min(f, 0)^2),    HBGI = mean(10 max(f, 0)^2),    BGRI = LBGI + HBGI
        ADRR = mean over days(max of the day(10 min(f, 0)^2) + max of the day(10 max(f, 0)^2))

    with f of `formulas.symmetric_glucose`. A day with fewer than three readings does not count for the ADRR.

    References
    ----------
    B. P. Kovatchev, E. Otto, D. Cox, L. Gonder-Frederick, W. Clarke, "Evaluation of a new measure of blood glucose
    variability in diabetes", Diabetes Care 29(11), 2433-2438, 2006.
    """
    f = symmetric_glucose(np, readings.glucose_mg_dl)
    low, high = 10.0 * np.minimum(f, 0.0) ** 2, 10.0 * np.maximum(f, 0.0) ** 2
    begins = np.flatnonzero(np.diff(readings.day, prepend=readings.day[0] - 1))
    enough = np.diff(begins, append=f.size) >= _MIN_OF_A_DAY
    ranges = (np.maximum.reduceat(low, begins) + np.maximum.reduceat(high, begins))[enough]
    return {
        "lbgi": readings.mean(low),
        "hbgi": readings.mean(high),
        "bgri": readings.mean(low) + readings.mean(high),
        "adrr": float(ranges.mean()) if ranges.size else np.nan,
    }


def _grade_of(glucose_mg_dl: Floats) -> Floats:
    """GRADE of each glucose: ``min(50, 425 (log10(log10(G)) + 0.16)^2)`` with G in mmol/l; 50 up to 1 mmol/l."""
    inner = np.log10(np.maximum(glucose_mg_dl / _MG_DL_PER_MMOL_L_OF_GRADE, 1.0 + 1e-9))
    return np.asarray(np.minimum(50.0, 425.0 * (np.log10(inner) + 0.16) ** 2))


def quality(readings: Readings) -> Numbers:
    """GRADE with its shares below 70, up to and above 140 mg/dl; the J-index; and the M-value with 90 mg/dl.

    ::

        J = 0.001 (mean + SD)^2,    M = mean |10 log10(glucose / 90)|^3

    References
    ----------
    N. R. Hill et al., "A method for assessing quality of control from glucose profiles", Diabetic Medicine 24(7),
    753-758, 2007.
    J. M. Wojcicki, "J-index: a new proposition of the assessment of current glucose control in diabetic patients",
    Horm. Metab. Res. 27(1), 41-42, 1995.
    J. Schlichtkrull, O. Munck, M. Jersild, "The M-value, an index of blood-sugar control in diabetics", Acta Med.
    Scand. 177(1), 95-102, 1965: without the correction for the range of a few readings.
    """
    glucose = readings.glucose_mg_dl
    grade = _grade_of(glucose)
    weighted = grade if readings.weight_min is None else grade * readings.weight_min
    total = max(float(weighted.sum()), np.finfo(float).tiny)
    low, high = glucose < 70.0, glucose > 140.0
    variation = mean_and_variation(readings)
    return {
        "grade": readings.mean(grade),
        "grade_hypo_pct": 100.0 * float(weighted[low].sum()) / total,
        "grade_eu_pct": 100.0 * float(weighted[~low & ~high].sum()) / total,
        "grade_hyper_pct": 100.0 * float(weighted[high].sum()) / total,
        "j_index": 0.001 * (variation["mean_mg_dl"] + variation["sd_mg_dl"]) ** 2,
        "m_value": readings.mean(np.abs(10.0 * np.log10(glucose / 90.0)) ** 3),
    }
