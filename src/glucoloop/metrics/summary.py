"""All metrics of a run in one record."""

from __future__ import annotations

import dataclasses
import math

import jax
import jax.numpy as jnp
import numpy as np

from glucoloop._pytree import pytree
from glucoloop.arguments import checked
from glucoloop.control.protocol import Status
from glucoloop.metrics import constraints, glycemic, regulation
from glucoloop.metrics._finite import all_or_nan
from glucoloop.metrics.low_events import LASTING_MIN, LEVEL_1_MG_DL, LEVEL_2_MG_DL, low_events
from glucoloop.metrics.printing import short_table
from glucoloop.pumps.limits import PARKER_1999_LIMITS, DoseLimits
from glucoloop.simulation.closed_loop import Trace


@pytree
class Metrics:
    """Metrics of a run; every field has the shape of the people, `()` for one.

    Glucose is the patient's own, free of noise, on the trace's grid of one minute. A time in a range is the percentage
    of the points of that grid, both ends included. Insulin is what the pump delivered.
    """

    undershoot_mg_dl: jax.Array
    """Setpoint minus the least glucose."""
    minimum_mg_dl: jax.Array
    """Least glucose of the run."""
    minimum_t_min: jax.Array
    """Time from the start of the run at which the minimum is first reached."""
    overshoot_mg_dl: jax.Array
    """Greatest glucose minus the setpoint."""
    peak_mg_dl: jax.Array
    """Greatest glucose of the run."""
    peak_t_min: jax.Array
    """Time from the start of the run at which the peak is first reached."""
    settling_2pct_min: jax.Array
    """Last minute farther than 2 % of the setpoint from it, plus 1, minus the time of the first meal, or of the start
    if nothing is eaten; 0 if never so far. Where not settled, the horizon plus 1 takes the place of that minute."""
    settled_2pct: jax.Array
    """Whether glucose is within 2 % of the setpoint at the end."""
    settling_5pct_min: jax.Array
    """Settling time for a band of 5 % of the setpoint."""
    settled_5pct: jax.Array
    """Whether glucose is within 5 % of the setpoint at the end."""
    sse: jax.Array
    """Sum over the controller's samples of the squared distance from the setpoint [(mg/dl)^2]."""
    time_below_54_pct: jax.Array
    """Percentage of time with glucose below 54 mg/dl."""
    time_below_60_pct: jax.Array
    """Percentage of time with glucose below 60 mg/dl."""
    time_below_70_pct: jax.Array
    """Percentage of time with glucose below 70 mg/dl."""
    time_below_validity_pct: jax.Array
    """Percentage of time with glucose below the valid range of the patient's model; a value above 0 means severe
    hypoglycemia.
    """
    low_events: jax.Array
    """Number of times that glucose fell below 70 mg/dl for 15 min or longer, on the controller's samples."""
    very_low_events: jax.Array
    """Number of times that glucose fell below 54 mg/dl for 15 min or longer, on the controller's samples."""
    time_70_180_pct: jax.Array
    """Percentage of time from 70 to 180 mg/dl, both included; with those below 70 and above 180 it makes 100."""
    time_above_180_pct: jax.Array
    """Percentage of time with glucose above 180 mg/dl."""
    time_above_250_pct: jax.Array
    """Percentage of time with glucose above 250 mg/dl."""
    mean_mg_dl: jax.Array
    """Mean glucose over the grid."""
    cv_pct: jax.Array
    """Coefficient of variation: standard deviation (n - 1) in percent of the mean."""
    gmi_pct: jax.Array
    """Glucose management indicator."""
    lbgi: jax.Array
    """Low blood glucose index."""
    hbgi: jax.Array
    """High blood glucose index."""
    gri: jax.Array
    """Glycemia risk index."""
    insulin_total_mU: jax.Array
    """Insulin delivered over the run."""
    insulin_total_variation_mU_min: jax.Array
    """Sum of the absolute changes from sample to sample, the first from the rate at rest."""
    largest_change_mU_min: jax.Array
    """Largest of these changes."""
    rate_satisfied: jax.Array
    """Constraint (17): no change beyond the pump's limit."""
    magnitude_satisfied: jax.Array
    """Constraint (18): every rate within the pump's limits."""
    glucose_satisfied: jax.Array
    """Constraint (19): glucose never below 60 mg/dl."""
    constraints_satisfied: jax.Array
    """Whether all three constraints hold."""
    samples_saturated: jax.Array
    """Samples at which the controller wanted a dose beyond its limits."""
    samples_missing: jax.Array
    """Samples without a valid, finite reading."""
    samples_not_converged: jax.Array
    """Samples at which an optimisation did not converge."""
    samples_non_finite: jax.Array
    """Samples at which the controller computed no finite dose, or was restarted by its guard because of that."""
    samples_rejected: jax.Array
    """Samples at which the guard rejected a reading; 0, like the next three, without a guard."""
    samples_fallback: jax.Array
    """Samples at which the guard gave the basal rate, or a part of it, because readings were missing."""
    samples_suspended: jax.Array
    """Samples at which the guard suspended insulin."""
    samples_dose_limited: jax.Array
    """Samples at which the guard cut the dose to its limit per hour or of insulin on board."""

    def __str__(self) -> str:
        return short_table({field.name: getattr(self, field.name) for field in dataclasses.fields(self)})

    def as_dict(self) -> dict[str, float | int | bool | None]:
        """Plain numbers by name, ready for JSON, which knows no NaN: it becomes None.

        Raises
        ------
        ValueError
            For more than one person.
        """
        plain: dict[str, float | int | bool | None] = {}
        for field in dataclasses.fields(self):
            value = np.asarray(getattr(self, field.name))
            if value.ndim:
                raise ValueError(
                    f"these are the metrics of people of shape {value.shape}, not of one; "
                    "pick one with jax.tree.map(lambda values: values[i], metrics)"
                )
            number = value.item()
            plain[field.name] = None if isinstance(number, float) and not math.isfinite(number) else number
        return plain


def first_meal_min(trace: Trace) -> jax.Array:
    """Time of the sample in which the first meal begins [min]; 0 if nothing is eaten.

    A trace knows the sample of a meal, not the moment within it.
    """
    eats = trace.carbs_g > 0.0
    # argmax gives the first sample, which is the start of the run, if nothing is eaten
    return jnp.asarray(trace.t_min)[eats.argmax(axis=0)]


@checked
@jax.jit
def summarise(
    trace: Trace,
    limits: DoseLimits = PARKER_1999_LIMITS,
    *,
    lowest_glucose_mg_dl: jax.Array | float = constraints.LOWEST_GLUCOSE_MG_DL,
) -> Metrics:
    """Metrics of a run, of one person or of many.

    Parameters
    ----------
    trace : Trace
    limits : DoseLimits
        Bounds of the constraints (17) and (18).
    lowest_glucose_mg_dl : array_like
        Bound of the constraint (19).

    Returns
    -------
    Metrics
        Metrics; one that rests on glucose or insulin that is not finite is NaN, not settled and not satisfied.

    References
    ----------
    Parker, Doyle & Peppas 1999, eq. (17)-(19), Tables I and II; for the rest see `metrics.glycemic`.
    """
    t_min, glucose = trace.fine_t_min, all_or_nan(trace.fine_glucose_mg_dl)
    setpoint, insulin = trace.setpoint_mg_dl, all_or_nan(trace.insulin_mU_min)
    minimum, peak = regulation.minimum(t_min, glucose), regulation.peak(t_min, glucose)
    meal_min = first_meal_min(trace)
    settling_2pct = regulation.settling(t_min, glucose, setpoint, band_pct=2.0, from_min=meal_min)
    settling_5pct = regulation.settling(t_min, glucose, setpoint, band_pct=5.0, from_min=meal_min)
    mean = glucose.mean(axis=0)
    bolus = 0.0 if trace.bolus_mU is None else all_or_nan(trace.bolus_mU).sum(axis=0)
    risk = glycemic.risk_indices(glucose)
    sample_time_min = t_min[-1] / trace.t_min.shape[0]
    in_a_row = jnp.maximum(1.0, jnp.round(LASTING_MIN / sample_time_min))
    changes = jnp.abs(constraints.insulin_changes(insulin, trace.basal_insulin_mU_min))
    rate = constraints.rate_satisfied(insulin, trace.basal_insulin_mU_min, limits)
    magnitude = constraints.magnitude_satisfied(insulin, limits)
    above = constraints.glucose_satisfied(glucose, lowest_glucose_mg_dl)

    def samples_with(status: Status) -> jax.Array:
        return (trace.status == status).sum(axis=0)

    def events_below(bound_mg_dl: float) -> jax.Array:
        events = low_events(trace.glucose_mg_dl, bound_mg_dl, in_a_row)
        return jnp.where(jnp.isfinite(minimum.value), events, jnp.nan)

    return Metrics(
        undershoot_mg_dl=setpoint - minimum.value,
        minimum_mg_dl=minimum.value,
        minimum_t_min=minimum.t_min,
        overshoot_mg_dl=peak.value - setpoint,
        peak_mg_dl=peak.value,
        peak_t_min=peak.t_min,
        settling_2pct_min=settling_2pct.settling_min,
        settled_2pct=settling_2pct.settled,
        settling_5pct_min=settling_5pct.settling_min,
        settled_5pct=settling_5pct.settled,
        sse=regulation.sum_squared_error(trace.glucose_mg_dl, setpoint),
        time_below_54_pct=glycemic.time_below_pct(glucose, 54.0),
        time_below_60_pct=glycemic.time_below_pct(glucose, 60.0),
        time_below_70_pct=glycemic.time_below_pct(glucose, 70.0),
        time_below_validity_pct=glycemic.time_below_pct(glucose, trace.lowest_valid_mg_dl),
        low_events=events_below(LEVEL_1_MG_DL),
        very_low_events=events_below(LEVEL_2_MG_DL),
        time_70_180_pct=glycemic.time_between_pct(glucose, 70.0, 180.0),
        time_above_180_pct=glycemic.time_above_pct(glucose, 180.0),
        time_above_250_pct=glycemic.time_above_pct(glucose, 250.0),
        mean_mg_dl=mean,
        cv_pct=glycemic.coefficient_of_variation_pct(glucose),
        gmi_pct=glycemic.glucose_management_indicator_pct(mean),
        lbgi=risk.lbgi,
        hbgi=risk.hbgi,
        gri=glycemic.glycemia_risk_index(glucose),
        insulin_total_mU=insulin.sum(axis=0) * sample_time_min + bolus,
        insulin_total_variation_mU_min=changes.sum(axis=0),
        largest_change_mU_min=changes.max(axis=0),
        rate_satisfied=rate,
        magnitude_satisfied=magnitude,
        glucose_satisfied=above,
        constraints_satisfied=rate & magnitude & above,
        samples_saturated=samples_with(Status.SATURATED),
        samples_missing=(~(trace.reading_valid & jnp.isfinite(trace.reading_mg_dl))).sum(axis=0),
        samples_not_converged=samples_with(Status.NOT_CONVERGED),
        samples_non_finite=samples_with(Status.NON_FINITE)
        + samples_with(Status.RESTARTED)
        + samples_with(Status.NO_FINITE_DOSE),
        samples_rejected=samples_with(Status.READING_REJECTED),
        samples_fallback=samples_with(Status.FALLBACK_BASAL) + samples_with(Status.FALLBACK_REDUCED),
        samples_suspended=samples_with(Status.SUSPENDED),
        samples_dose_limited=samples_with(Status.DOSE_LIMITED),
    )
