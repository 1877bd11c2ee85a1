"""Kalman filter of a scalar reading of a small linear system, for several systems and several signals at once.

::

    x(t + 1) = A x(t) + w(t),  w ~ N(0, Q);    y(t) = c x(t) + v(t),  v ~ N(0, r)

The filter is linear in the readings, so that signals that are filtered with the same gains stand side by side as
columns: the readings, and what each known input would read. A missing reading has a gain of 0.

References
----------
B. D. O. Anderson, J. B. Moore, Optimal Filtering, Prentice-Hall, 1979, chapters 3 and 4.
C. F. Van Loan, "Computing integrals involving the matrix exponential", IEEE Trans. Autom. Control 23(3), 1978.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from glucoloop._lazy_jax import np, scipy

if TYPE_CHECKING:
    from glucoloop.forecasts.grid import Values


class LinearSystem(NamedTuple):
    """Systems ``(systems, ...)`` with the same number of states, in discrete time."""

    transition: Values
    """Transition matrices ``(systems, states, states)``."""
    process_noise: Values
    """Covariances ``(systems, states, states)`` of the noise of a step."""
    readout: Values
    """Row ``(states,)`` by which a reading follows from the states."""
    reading_variance: Values
    """Variances ``(systems,)`` of the noise of a reading."""


def discretised(rate: Values, noise_density: Values, step_min: float) -> tuple[Values, Values]:
    """Transition and covariance of the noise over a step, of ``dx = rate x dt + dW``; by Van Loan.

    `rate` and `noise_density` are ``(..., states, states)``.
    """
    states = rate.shape[-1]
    block = np.zeros((*rate.shape[:-2], 2 * states, 2 * states))
    block[..., :states, :states] = -rate
    block[..., :states, states:] = noise_density
    block[..., states:, states:] = np.swapaxes(rate, -1, -2)
    exponential = scipy.linalg.expm(step_min * block)
    transition = np.swapaxes(exponential[..., states:, states:], -1, -2)
    noise = transition @ exponential[..., :states, states:]
    return transition, 0.5 * (noise + np.swapaxes(noise, -1, -2))


def steady_gains(system: LinearSystem) -> Values:
    """Gains ``(systems, states)`` of the filter that has read for long."""
    gains = []
    c = system.readout
    for transition, noise, variance in zip(
        system.transition, system.process_noise, system.reading_variance, strict=True
    ):
        predicted = scipy.linalg.solve_discrete_are(transition.T, c[:, None], noise, np.atleast_2d(variance))
        gains.append(predicted @ c / (c @ predicted @ c + variance))
    return np.array(gains)


def exact_gains(system: LinearSystem, start: Values, readable: np.ndarray) -> tuple[Values, Values]:
    """Gains ``(samples, states)`` of one system, and the covariance ``(samples, states, states)`` after each reading.

    `start` is the covariance before the first reading, and `readable` says of each sample whether there is one.
    """
    [transition], [noise], [variance] = system.transition, system.process_noise, system.reading_variance
    c, predicted = system.readout, start
    gains = np.zeros((readable.size, c.size))
    after = np.empty((readable.size, c.size, c.size))
    for sample, is_read in enumerate(readable):
        if is_read:
            gain = predicted @ c / (c @ predicted @ c + variance)
            rest = np.eye(c.size) - np.outer(gain, c)
            predicted = rest @ predicted @ rest.T + variance * np.outer(gain, gain)  # Joseph's form
            gains[sample] = gain
        after[sample] = predicted
        predicted = transition @ predicted @ transition.T + noise
    return gains, after


def recursion(transitions: Values, drives: Values) -> Values:
    """States ``(samples + 1, ..., states, columns)`` of ``x(t + 1) = transitions(t) x(t) + drives(t)``, from 0.

    `transitions` is ``(samples or 1, ..., states, states)`` and `drives` ``(samples, ..., states, columns)``.
    """
    states = np.zeros((drives.shape[0] + 1, *drives.shape[1:]))
    still = transitions.shape[0] == 1
    for sample in range(drives.shape[0]):
        np.matmul(transitions[0 if still else sample], states[sample], out=states[sample + 1])
        states[sample + 1] += drives[sample]
    return states


def filtered(system: LinearSystem, gains: Values, signals: Values) -> Values:
    """States after each reading, ``(samples, systems, states, columns)``, from a mean of 0 before the first one.

    `gains` is ``(samples, systems, states)``, 0 where a reading is missing, and `signals` ``(samples, systems,
    columns)``, finite everywhere.
    """
    corrected = np.eye(system.readout.size) - gains[..., :, None] * system.readout  # x after = this x before + gain y
    drives = gains[..., :, None] * signals[..., None, :]
    before = recursion(system.transition @ corrected, system.transition @ drives)[:-1]
    result: Values = corrected @ before + drives
    return result
