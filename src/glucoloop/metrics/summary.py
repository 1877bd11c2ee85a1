"""Metrics of a trace: the scan of the fold that also runs in the loops of cohorts."""

from __future__ import annotations

import functools
from collections.abc import Sequence

import jax
import jax.numpy as jnp

from glucoloop.arguments import checked
from glucoloop.control.protocol import Decision
from glucoloop.metrics.metrics import Metrics
from glucoloop.metrics.protocol import LOWEST_GLUCOSE_MG_DL
from glucoloop.metrics.running import RunningMetrics, Tally
from glucoloop.pumps import Delivery
from glucoloop.pumps.limits import PARKER_1999_LIMITS, DoseLimits
from glucoloop.sensors import Reading
from glucoloop.simulation.closed_loop import Trace
from glucoloop.simulation.loop import Sampled


def first_meal_min(trace: Trace) -> jax.Array:
    """Time of the sample in which the first meal begins [min]; 0 if nothing is eaten.

    A trace knows the sample of a meal, not the moment within it.
    """
    eats = trace.carbs_g > 0.0
    # argmax gives the first sample, which is the start of the run, if nothing is eaten
    return jnp.asarray(trace.t_min)[eats.argmax(axis=0)]


@checked
def summarise(
    trace: Trace,
    limits: DoseLimits = PARKER_1999_LIMITS,
    *,
    lowest_glucose_mg_dl: jax.Array | float = LOWEST_GLUCOSE_MG_DL,
    metrics: Sequence[str] = (),
) -> Metrics:
    """Metrics of a run, of one person or of many.

    Parameters
    ----------
    trace : Trace
    limits : DoseLimits
        Bounds of the constraints (17) and (18).
    lowest_glucose_mg_dl : array_like
        Bound of the constraint (19).
    metrics : sequence of str
        Metrics of other packages, which are computed beside those of this one: name and settings, see
        `parts.metrics`.

    Returns
    -------
    Metrics
        Metrics; one that rests on glucose or insulin that is not finite is NaN, not settled and not satisfied.

    Raises
    ------
    ValueError
        For an unknown metric, or one that gives other results than its entry says.

    References
    ----------
    Parker, Doyle & Peppas 1999, eq. (17)-(19), Tables I and II; for the rest see the modules of `metrics`.
    """
    found: Metrics = _summarised(trace, limits, lowest_glucose_mg_dl, tuple(metrics))
    return found


@functools.partial(jax.jit, static_argnums=3)
def _summarised(
    trace: Trace, limits: DoseLimits, lowest_glucose_mg_dl: jax.Array | float, further: tuple[str, ...]
) -> Metrics:
    samples, fine = trace.t_min.shape[0], trace.fine_glucose_mg_dl
    inside = (fine.shape[0] - 1) // samples
    fold = RunningMetrics(
        setpoint_mg_dl=trace.setpoint_mg_dl,
        limits=limits,
        lowest_glucose_mg_dl=lowest_glucose_mg_dl,
        inside_min=tuple(trace.fine_t_min[1 : inside + 1]),
        further=further,
    )

    def sample(tally: Tally, entry: tuple[Sampled, jax.Array]) -> tuple[Tally, None]:
        return fold.step(tally, *entry), None

    start = fold.init(fine[0], jnp.broadcast_to(trace.basal_insulin_mU_min, fine.shape[1:]))
    sample_time_min = fold.inside_min[-1]
    happened = _happened(trace, inside, sample_time_min)
    tally: Tally = jax.lax.scan(sample, start, (happened, trace.t_min))[0]
    return fold.finished(tally, samples=samples, sample_time_min=sample_time_min, first_meal_min=first_meal_min(trace))


def _happened(trace: Trace, inside: int, sample_time_min: jax.Array | float) -> Sampled:
    """Events of all samples of a trace, with time on the leading axis."""
    fine, shape = trace.fine_glucose_mg_dl, trace.glucose_mg_dl.shape
    bolus = trace.bolus_mU
    return Sampled(
        x=trace.states[:-1],
        glucose_mg_dl=trace.glucose_mg_dl,
        reading=Reading(glucose_mg_dl=trace.reading_mg_dl, valid=trace.reading_valid),
        decision=Decision(insulin_mU_min=trace.command_mU_min, status=trace.status, bolus_mU=trace.command_bolus_mU),
        delivery=Delivery(
            insulin_mU_min=trace.insulin_mU_min,
            reported_mU_min=trace.reported_mU_min,
            bolus_mU=bolus,
            reported_bolus_mU=trace.reported_bolus_mU,
        ),
        infused_mU_min=trace.insulin_mU_min if bolus is None else trace.insulin_mU_min + bolus / sample_time_min,
        inside_mg_dl=fine[1:].reshape(shape[0], inside, *shape[1:]),
        lowest_valid_mg_dl=jnp.broadcast_to(trace.lowest_valid_mg_dl, shape),
    )
