"""Runs written down by hand, without a patient."""

import numpy as np
import pytest

from glucoloop.control import Status
from glucoloop.metrics import summarise
from glucoloop.metrics.metric import default_results
from glucoloop.pumps import PARKER_1999_LIMITS
from made_trace import trace_of


@pytest.fixture(scope="session")
def make_trace():
    """A run of 5-min samples whose glucose on the grid of one minute is given; people trail."""
    return trace_of


def _runs(outside, turns):
    """Number of stretches of at least so many points outside, parted by as many inside, of one person."""
    events, going, row = 0, False, 0
    for out in outside:
        row = row + 1 if out != going else 0
        if row == turns:
            events, going, row = events + (not going), not going, 0
    return events


def _longest(there):
    """Largest number of neighbours that are true."""
    return max(map(len, "".join("x" if one else " " for one in there).split()), default=0)


def _by_arrays(trace, limits=PARKER_1999_LIMITS, lowest=60.0):
    """Metrics of a trace from the whole arrays at once, in NumPy and after the definitions in the literature."""
    fine, at_samples = np.asarray(trace.fine_glucose_mg_dl), np.asarray(trace.glucose_mg_dl)
    t, setpoint = np.asarray(trace.fine_t_min), np.asarray(trace.setpoint_mg_dl)
    insulin, status = np.asarray(trace.insulin_mU_min), np.asarray(trace.status)
    finite, delivered = np.isfinite(fine).all(axis=0), np.isfinite(insulin).all(axis=0)
    g = np.where(finite, fine, np.nan)
    least, greatest = g.min(axis=0), g.max(axis=0)

    def of(values):
        return np.where(finite, values, np.nan)

    def pct(where):
        return of(100.0 * where.mean(axis=0))

    eats = np.flatnonzero(np.asarray(trace.carbs_g) > 0.0)
    meal = np.asarray(trace.t_min)[eats[0]] if eats.size else 0.0

    def settling(band):
        outside = np.abs(g - setpoint) > band / 100.0 * setpoint
        after = t[len(t) - 1 - outside[::-1].argmax(axis=0)] + t[1]
        return of(np.where(outside.any(axis=0), np.maximum(after - meal, 0.0), 0.0)), ~outside[-1] & finite

    f = 1.509 * (np.log(np.clip(np.where(finite, fine, 100.0), 20.0, 600.0)) ** 1.084 - 5.381)
    very_low, very_high, low, high = pct(g < 54.0), pct(g > 250.0), pct(g < 70.0), pct(g > 180.0)
    given = np.where(delivered, insulin, np.nan)
    changes = np.abs(np.diff(given, axis=0, prepend=np.broadcast_to(trace.basal_insulin_mU_min, given[:1].shape)))
    rate = delivered & (changes <= limits.max_change_mU_min + 1e-9).all(axis=0)
    magnitude = delivered & ((given >= limits.min_mU_min - 1e-9) & (given <= limits.max_mU_min + 1e-9)).all(axis=0)
    above = finite & (g >= lowest).all(axis=0)
    bolus = 0.0 if trace.bolus_mU is None else np.asarray(trace.bolus_mU).sum(axis=0)
    in_a_row = max(1, round(15.0 / (t[-1] / len(insulin))))

    def events(bound):
        return of(np.apply_along_axis(_runs, 0, at_samples < bound, in_a_row))

    def samples_with(*statuses):
        return np.isin(status, statuses).sum(axis=0)

    step = t[-1] / len(insulin)
    off = insulin + (0.0 if trace.bolus_mU is None else np.asarray(trace.bolus_mU)) <= 0.0
    (within_2, settled_2), (within_5, settled_5) = settling(2.0), settling(5.0)
    missing = ~(np.asarray(trace.reading_valid) & np.isfinite(trace.reading_mg_dl))
    found = {
        "undershoot_mg_dl": setpoint - least,
        "minimum_mg_dl": least,
        "minimum_t_min": of(t[np.where(finite, fine, 0.0).argmin(axis=0)]),
        "overshoot_mg_dl": greatest - setpoint,
        "peak_mg_dl": greatest,
        "peak_t_min": of(t[np.where(finite, fine, 0.0).argmax(axis=0)]),
        "settling_2pct_min": within_2,
        "settled_2pct": settled_2,
        "settling_5pct_min": within_5,
        "settled_5pct": settled_5,
        "sse": np.where(np.isfinite(at_samples).all(axis=0), ((at_samples - setpoint) ** 2).sum(axis=0), np.nan),
        "time_below_54_pct": very_low,
        "time_below_60_pct": pct(g < 60.0),
        "time_below_70_pct": low,
        "time_below_validity_pct": pct(g < np.asarray(trace.lowest_valid_mg_dl)),
        "time_70_180_pct": pct((g >= 70.0) & (g <= 180.0)),
        "time_above_180_pct": high,
        "time_above_250_pct": very_high,
        "gri": np.minimum(3.0 * very_low + 2.4 * (low - very_low) + 1.6 * very_high + 0.8 * (high - very_high), 100.0),
        "low_events": events(70.0),
        "very_low_events": events(54.0),
        "mean_mg_dl": g.mean(axis=0),
        "cv_pct": 100.0 * g.std(axis=0, ddof=1) / g.mean(axis=0),
        "gmi_pct": 3.31 + 0.02392 * g.mean(axis=0),
        "lbgi": of((10.0 * np.minimum(f, 0.0) ** 2).mean(axis=0)),
        "hbgi": of((10.0 * np.maximum(f, 0.0) ** 2).mean(axis=0)),
        "insulin_total_mU": given.sum(axis=0) * (t[-1] / len(insulin)) + bolus,
        "insulin_off_min": np.where(delivered, off.sum(axis=0) * step, np.nan),
        "longest_insulin_off_min": np.where(delivered, np.apply_along_axis(_longest, 0, off) * step, np.nan),
        "insulin_total_variation_mU_min": changes.sum(axis=0),
        "largest_change_mU_min": changes.max(axis=0),
        "rate_satisfied": rate,
        "magnitude_satisfied": magnitude,
        "glucose_satisfied": above,
        "constraints_satisfied": rate & magnitude & above,
        "samples_saturated": samples_with(Status.SATURATED),
        "samples_missing": missing.sum(axis=0),
        "samples_not_converged": samples_with(Status.NOT_CONVERGED),
        "samples_non_finite": samples_with(Status.NON_FINITE, Status.RESTARTED, Status.NO_FINITE_DOSE),
        "samples_rejected": samples_with(Status.READING_REJECTED),
        "samples_fallback": samples_with(Status.FALLBACK_BASAL, Status.FALLBACK_REDUCED),
        "samples_suspended": samples_with(Status.SUSPENDED),
        "samples_dose_limited": samples_with(Status.DOSE_LIMITED),
    }
    return {result.name: found.pop(result.name) for result in default_results() if result.name in found} | found


@pytest.fixture(scope="session")
def by_arrays():
    """Function that computes the metrics of a trace by another way."""
    return _by_arrays


@pytest.fixture(scope="session")
def measured():
    """Metrics of a course of glucose with one point of the grid in each sample; people trail."""

    def of_course(glucose, insulin=None, *, limits=PARKER_1999_LIMITS, lowest=60.0, inside=1, **fields):
        trace = trace_of(glucose, insulin, inside=inside, **{"meal_sample": None, **fields})
        return summarise(trace, limits, lowest_glucose_mg_dl=lowest)

    return of_course
