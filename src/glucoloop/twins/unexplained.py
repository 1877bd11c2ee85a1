"""Unexplained appearance of glucose in a record, with which the equations of a person give the record again.

The most likely disturbances ``w`` of `twins.extended` minimise::

    sum |w|²  +  sum (reading - glucose(w))² / variance of a reading

They are found by Gauss and Newton: the difference between readings and simulated glucose is smoothed on the equations
linearised about the steady state, by the filter with the gain of each sample forwards and its adjoint backwards, and a
step is shortened until the sum falls. The search begins where a proportional feedback on the readings, through `w_2`,
keeps the simulation near them, however wrong the sensitivity to insulin is.

References
----------
P. de Jong, "Smoothing and interpolation with the state-space model", J. Amer. Statist. Assoc. 84(408), 1989: the
adjoint.
"""

from __future__ import annotations

import functools
from typing import Any, Final, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from glucoloop.forecasts.grid import SAMPLE_MIN, GriddedRecord
from glucoloop.refusal import Refusal
from glucoloop.twins.extended import (
    EXTRA_STATES,
    Days,
    ExtendedPatient,
    Linearised,
    Numbers,
    ProgramKey,
    days_of_record,
)

Values = npt.NDArray[np.float64]

_SMOOTHINGS: Final = 12
_HALVINGS: Final = 6
_SETTLED: Final = 1e-3
"""Relative fall of the sum below which the search has ended."""
_RESPONSE: Final = 72
"""Samples, 6 h, within which a disturbance has its largest effect."""
_FOLLOWING_MIN: Final = 30.0
"""Time constant with which the feedback of the start follows the readings."""


class _Simulated(NamedTuple):
    """Simulation under disturbances, of all samples."""

    unexplained_mg_min: Values
    seen_mg_dl: Values
    glucose_mg_dl: Values
    w_mg_min: Values
    """``(samples, 3)`` disturbances with the feedback, where there is any."""


class Explained(NamedTuple):
    """A person in a record."""

    unexplained_mg_min: Values
    """``(samples,)`` appearance of glucose beside that of the meals."""
    glucose_mg_dl: Values
    """``(samples,)`` glucose after each sample that the equations give with it."""
    start: Values
    """``(states,)`` state of the patient at the start."""
    first_mg_dl: float
    """Glucose at the start."""
    return_mg_min: float
    """Appearance less by each mg/dl by which glucose is above that of the record."""

    @property
    def other_mg_min(self) -> Values:
        """``(samples,)`` appearance without the part ``-return_mg_min`` of the glucose at the beginning of a sample."""
        begins = np.append(self.first_mg_dl, self.glucose_mg_dl[:-1])
        result: Values = self.unexplained_mg_min + self.return_mg_min * begins
        return result


def explained(patient: ExtendedPatient, p: Values, record: GriddedRecord, mean_mg_dl: float) -> Explained:
    """Unexplained appearance of a record for a person with coordinates; Refusal for one who cannot be."""
    days = days_of_record(record, mean_mg_dl)
    linear = Linearised(*map(np.asarray, _linearised(patient.fixed)(p, patient.numbers, days.working_mg_dl)))
    simulate, readings = _simulation(patient.fixed), days.reading_mg_dl
    there = np.isfinite(readings)

    def simulated(w: Values, feedback: float = 0.0) -> _Simulated:
        arguments = (days, w * linear.unit_mg_min, feedback * linear.unit_mg_min[1])
        return _Simulated(*map(np.asarray, simulate(p, patient.numbers, *arguments)))

    def cost(w: Values, result: _Simulated) -> float:
        total = float((w**2).sum() + ((readings - result.seen_mg_dl)[there] ** 2).sum() / linear.reading_variance)
        return total if np.isfinite(total) else np.inf

    gains = _gains(linear, there)
    pulse = np.zeros((_RESPONSE, 3))
    pulse[0, 1] = 1.0
    rise_mg_dl = float(_response(linear, pulse).max())
    start = simulated(np.zeros((readings.size, 3)), SAMPLE_MIN / (_FOLLOWING_MIN * rise_mg_dl))
    w = start.w_mg_min / linear.unit_mg_min
    here = simulated(w)
    total = cost(w, here)
    if not np.isfinite(total):
        raise Refusal("the equations of the twin cannot give this record; find the twin again from these days")
    for _ in range(_SMOOTHINGS):
        step, part = _smoothed(linear, gains, readings - here.seen_mg_dl + _response(linear, w)) - w, 1.0
        for _ in range(_HALVINGS):
            tried = simulated(w + part * step)
            new = cost(w + part * step, tried)
            if new < total:
                break
            part *= 0.5
        else:
            break
        fallen, w, here, total = 1.0 - new / total, w + part * step, tried, new
        if fallen < _SETTLED:
            break
    samples = record.reading_mg_dl.size
    begun = linear.state[:-EXTRA_STATES]
    return Explained(
        unexplained_mg_min=here.unexplained_mg_min[:samples],
        glucose_mg_dl=here.glucose_mg_dl[:samples],
        start=begun[:, 0],
        first_mg_dl=float(patient.person(jnp.asarray(p)).glucose_mg_dl(jnp.asarray(begun))[0]),
        return_mg_min=float(linear.return_mg_min),
    )


def under_doses(patient: ExtendedPatient, p: Values, of: Explained, record: GriddedRecord) -> Values:
    """Glucose ``(samples,)`` of an explained person under the doses of a record, with the same appearance of glucose.

    What returns glucose to its mean acts on glucose as it is under these doses. Under the doses of the record by which
    the person was explained it is the glucose of `of`.
    """
    days, appearance = days_of_record(record, 0.0), of.other_mg_min
    appearance = np.append(appearance, np.zeros(days.reading_mg_dl.size - appearance.size))
    dosed = _dosed(patient.fixed)
    result: Values = np.asarray(dosed(p, patient.numbers, days, of.start, appearance, of.return_mg_min))
    return result[: record.reading_mg_dl.size]


def _response(linear: Linearised, w: Values) -> Values:
    """Glucose ``(samples,)`` by disturbances ``(samples, 3)`` in the linearised equations."""
    state, result = np.zeros(linear.readout.size), np.empty(len(w))
    for sample, forced in enumerate(w @ linear.disturbance.T):
        state = linear.transition @ state + forced
        result[sample] = linear.readout @ state
    return result


class _Gains(NamedTuple):
    """Filter of the linearised equations from a known start, by which samples have a reading."""

    gain: Values
    """``(samples, states)`` correction by the innovation of each reading; 0 where there is none."""
    variance: Values
    """``(samples,)`` variance of that innovation."""


def _gains(linear: Linearised, there: npt.NDArray[np.bool_]) -> _Gains:
    """Gains of each sample: after a gap, and at the start, they are others than those of the stationary filter."""
    A, c = linear.transition, linear.readout
    covariance = np.zeros_like(A)
    gain, variance = np.zeros((there.size, c.size)), np.ones(there.size)
    for sample, reading in enumerate(there.tolist()):
        covariance = A @ covariance @ A.T + linear.noise
        if reading:
            with_reading = covariance @ c
            variance[sample] = c @ with_reading + linear.reading_variance
            gain[sample] = with_reading / variance[sample]
            covariance = covariance - np.outer(gain[sample], with_reading)
    return _Gains(gain, variance)


def _smoothed(linear: Linearised, gains: _Gains, signal: Values) -> Values:
    """Most likely disturbances ``(samples, 3)`` for a signal ``(samples,)``, NaN where there is none."""
    A, c = linear.transition, linear.readout
    state, innovation = np.zeros(c.size), np.zeros(signal.size)
    there = np.isfinite(signal).tolist()
    for sample, reading in enumerate(there):
        state = A @ state
        if reading:
            innovation[sample] = signal[sample] - c @ state
            state = state + gains.gain[sample] * innovation[sample]
    adjoint, result = np.zeros(c.size), np.empty((signal.size, linear.disturbance.shape[1]))
    scaled = innovation / gains.variance
    for sample in range(signal.size - 1, -1, -1):
        adjoint = A.T @ adjoint
        if there[sample]:
            adjoint = adjoint + c * (scaled[sample] - gains.gain[sample] @ adjoint)
        result[sample] = linear.disturbance.T @ adjoint
    return result


@functools.lru_cache(maxsize=8)
def _linearised(fixed: ProgramKey) -> Any:
    @jax.jit
    def linearised(p: jax.Array, numbers: Numbers, working_mg_dl: jax.Array) -> Linearised:
        patient = ExtendedPatient.traced(fixed, numbers)
        return patient.linearised(patient.person(p), p, working_mg_dl)

    return linearised


@functools.lru_cache(maxsize=8)
def _dosed(fixed: ProgramKey) -> Any:
    """Program of `ExtendedPatient.under_doses`."""

    @jax.jit
    def dosed(p: jax.Array, numbers: Numbers, days: Days, *given: Any) -> jax.Array:
        patient = ExtendedPatient.traced(fixed, numbers)
        person = patient.person(p)
        start, *appearing = given
        return patient.under_doses(person, p, start, days, patient.moments(person, days), *appearing)

    return dosed


@functools.lru_cache(maxsize=8)
def _simulation(fixed: ProgramKey) -> Any:
    """Program of `ExtendedPatient.disturbed`."""

    @jax.jit
    def simulated(p: jax.Array, numbers: Numbers, days: Days, w_mg_min: jax.Array, feedback: jax.Array) -> Any:
        patient = ExtendedPatient.traced(fixed, numbers)
        person = patient.person(p)
        linear = patient.linearised(person, p, days.working_mg_dl)
        return patient.disturbed(
            person, p, linear, days, patient.moments(person, days), jnp.asarray(w_mg_min), feedback
        )

    return simulated
