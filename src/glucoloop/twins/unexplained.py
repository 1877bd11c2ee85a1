"""Unexplained appearance of glucose in a record, with which the equations of a person give the record again.

The disturbances of `twins.extended` are smoothed over the whole record: the gain of the stationary filter forwards, its
adjoint backwards, on the equations linearised about the steady state. What the linearised equations miss is smoothed
again on the difference between the readings and the simulated glucose (Gauss and Newton), a few times.

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

from glucoloop.forecasts.grid import GriddedRecord
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

_SMOOTHINGS: Final = 20
_RELAXED: Final = 0.7
"""Part of each step that is made, since the equations are not linear."""


class Explained(NamedTuple):
    """A person in a record."""

    unexplained_mg_min: Values
    """``(samples,)`` appearance of glucose beside that of the meals."""
    glucose_mg_dl: Values
    """``(samples,)`` glucose after each sample that the equations give with it."""
    start: Values
    """``(states,)`` state of the patient at the start."""


def explained(patient: ExtendedPatient, p: Values, record: GriddedRecord, mean_mg_dl: float) -> Explained:
    """Unexplained appearance of a record for a person with coordinates; Refusal for one who cannot be."""
    days = days_of_record(record, mean_mg_dl)
    linear = Linearised(*map(np.asarray, _linearised(patient.fixed)(p, patient.numbers, days.working_mg_dl)))
    simulate = _simulation(patient.fixed)
    w = np.zeros((days.reading_mg_dl.size, linear.disturbance.shape[1]))
    for _ in range(_SMOOTHINGS):
        _, seen, _ = map(np.asarray, simulate(p, patient.numbers, days, w * linear.unit_mg_min))
        w = w + _RELAXED * (_smoothed(linear, days.reading_mg_dl - seen + _response(linear, w)) - w)
    unexplained, _, glucose = map(np.asarray, simulate(p, patient.numbers, days, w * linear.unit_mg_min))
    if not np.isfinite(glucose).all():
        raise Refusal("the equations of the twin cannot give this record; find the twin again from these days")
    samples = record.reading_mg_dl.size
    return Explained(unexplained[:samples], glucose[:samples], linear.state[:-EXTRA_STATES, 0])


def _response(linear: Linearised, w: Values) -> Values:
    """Glucose ``(samples,)`` by disturbances ``(samples, 3)`` in the linearised equations."""
    state, result = np.zeros(linear.readout.size), np.empty(len(w))
    for sample, forced in enumerate(w @ linear.disturbance.T):
        state = linear.transition @ state + forced
        result[sample] = linear.readout @ state
    return result


def _smoothed(linear: Linearised, signal: Values) -> Values:
    """Most likely disturbances ``(samples, 3)`` for a signal ``(samples,)``, NaN where there is none."""
    A, c, gain = linear.transition, linear.readout, linear.gain
    scale = float(c @ linear.predicted @ c + linear.reading_variance)
    state, innovation = np.zeros(c.size), np.zeros(signal.size)
    there = np.isfinite(signal)
    for sample in range(signal.size):
        state = A @ state
        if there[sample]:
            innovation[sample] = signal[sample] - c @ state
            state = state + gain * innovation[sample]
    corrected = np.eye(c.size) - np.outer(gain, c)
    adjoint, result = np.zeros(c.size), np.empty((signal.size, linear.disturbance.shape[1]))
    for sample in range(signal.size - 1, -1, -1):
        adjoint = A.T @ adjoint
        if there[sample]:
            adjoint = corrected.T @ adjoint + c * (innovation[sample] / scale)
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
def _simulation(fixed: ProgramKey) -> Any:
    """Unexplained appearance, glucose at the sensor, and the controlled one, under disturbances in mg/min."""

    @jax.jit
    def simulated(p: jax.Array, numbers: Numbers, days: Days, w_mg_min: jax.Array) -> Any:
        patient = ExtendedPatient.traced(fixed, numbers)
        person = patient.person(p)
        linear = patient.linearised(person, p, days.working_mg_dl)
        return patient.disturbed(person, p, linear, days, patient.moments(person, days), jnp.asarray(w_mg_min))

    return simulated
