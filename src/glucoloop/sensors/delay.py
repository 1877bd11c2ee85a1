"""Sensors that are late: behind a first-order lag, or by a dead time of whole samples.

Glucose under the skin follows glucose in the blood some minutes later, by the lag of one compartment,
``lag r' = G - r``. Between two samples glucose G is taken to change evenly, for which the equation is solved exactly.

References
----------
K. Rebrin, G. M. Steil, W. P. van Antwerp, J. J. Mastrototaro, "Subcutaneous glucose predicts plasma glucose independent
of insulin: implications for continuous monitoring", Am. J. Physiol. 277(3), 1999: the compartment.
"""

from __future__ import annotations

import operator
from typing import TYPE_CHECKING, Any, Final

from glucoloop._lazy_jax import jax, jnp
from glucoloop._pytree import pytree, static
from glucoloop.arguments import checked
from glucoloop.refusal import Refusal
from glucoloop.sensors.protocol import Reading, Sensor, checked_sample_time, or_ideal
from glucoloop.sensors.settings import LagSettings

if TYPE_CHECKING:
    from jax.typing import ArrayLike


def lagged(
    behind_mg_dl: jax.Array,
    before_mg_dl: jax.Array,
    now_mg_dl: jax.Array,
    lag_min: ArrayLike,
    sample_time_min: float,
) -> jax.Array:
    """Glucose behind a lag at the end of a sample, over which glucose before the lag changes evenly."""
    z = sample_time_min / jnp.asarray(lag_min, float)
    left, mean = jnp.exp(-z), -jnp.expm1(-z) / z
    return left * behind_mg_dl + (mean - left) * before_mg_dl + (1.0 - mean) * now_mg_dl


@pytree
class _State:
    inner: Any
    glucose: jax.Array
    """Glucose at the latest sample."""
    behind: jax.Array
    """Glucose behind the lag at the latest sample."""


@pytree
class Lag:
    """Shows the inner sensor glucose behind a first-order lag; make it with `lag`."""

    inner: Sensor
    lag_min: jax.Array | float
    sample_time_min: float = static()

    def init(self, glucose_mg_dl: jax.Array, key: jax.Array) -> _State:
        """State of a sensor that has read the given glucose for a long time."""
        return _State(inner=self.inner.init(glucose_mg_dl, key), glucose=glucose_mg_dl, behind=glucose_mg_dl)

    def read(self, state: _State, glucose_mg_dl: jax.Array, key: jax.Array) -> tuple[_State, Reading]:
        """Reading of the inner sensor, to which glucose comes through the lag."""
        behind = lagged(state.behind, state.glucose, glucose_mg_dl, self.lag_min, self.sample_time_min)
        inner, reading = self.inner.read(state.inner, behind, key)
        return _State(inner=inner, glucose=glucose_mg_dl, behind=behind), reading


@checked
def lag(lag_min: float = 10.0, inner: Sensor | None = None, *, sample_time_min: float = 5.0) -> Lag:
    """Sensor behind a first-order lag.

    Parameters
    ----------
    lag_min : float
        Time constant of the lag, above 0 and up to 120 min.
    inner : Sensor, optional
        Sensor behind the lag, whose noise does not lag; an ideal one by default.
    sample_time_min : float
        Time between two readings.

    Raises
    ------
    ValueError
        For a lag outside its bounds, or a sample time that is not positive and finite.
    """
    LagSettings(lag_min)
    return Lag(inner=or_ideal(inner), lag_min=lag_min, sample_time_min=checked_sample_time(sample_time_min))


LONGEST_DEAD_TIME_SAMPLES: Final = 288  # a day of 5-min samples


def filled(samples: int, glucose_mg_dl: jax.Array) -> Reading:
    """Buffer ``(samples, ...)`` of a sensor that has read the given glucose for a long time."""
    glucose = jnp.broadcast_to(glucose_mg_dl, (samples, *jnp.shape(glucose_mg_dl)))
    return Reading(glucose_mg_dl=glucose, valid=jnp.ones(glucose.shape, bool))


def joined(past: Reading, newest: Reading) -> Reading:
    """Buffer with the newest reading appended, ``(samples + 1, ...)``."""
    line: Reading = jax.tree.map(lambda old, new: jnp.concatenate([old, new[None]]), past, newest)
    return line


def one_of(line: Reading, index: int) -> Reading:
    """Reading at a position of the buffer."""
    reading: Reading = jax.tree.map(operator.itemgetter(index), line)
    return reading


def without_oldest(line: Reading) -> Reading:
    """Buffer for the next sample, without the oldest reading."""
    rest: Reading = jax.tree.map(lambda readings: readings[1:], line)
    return rest


@pytree
class _Line:
    inner: Any
    waiting: Reading
    """Readings that are not yet given, the oldest first."""


@pytree
class DeadTime:
    """Gives the reading of the inner sensor from `samples` ago; before the first such reading, the initial glucose."""

    inner: Sensor
    samples: int = static()

    def init(self, glucose_mg_dl: jax.Array, key: jax.Array) -> _Line:
        """A delay line filled with the initial glucose."""
        return _Line(inner=self.inner.init(glucose_mg_dl, key), waiting=filled(self.samples, glucose_mg_dl))

    def read(self, state: _Line, glucose_mg_dl: jax.Array, key: jax.Array) -> tuple[_Line, Reading]:
        """Append a new reading to the delay line and give the one at its head."""
        inner, newest = self.inner.read(state.inner, glucose_mg_dl, key)
        line = joined(state.waiting, newest)
        return _Line(inner=inner, waiting=without_oldest(line)), one_of(line, 0)


@checked
def dead_time(samples: int, inner: Sensor | None = None) -> DeadTime:
    """Sensor with a dead time of whole samples.

    Raises
    ------
    ValueError
        Unless `samples` is a whole number from 0 to 288.
    """
    if not 0 <= samples <= LONGEST_DEAD_TIME_SAMPLES:
        raise Refusal(f"samples is {samples}; give a whole number from 0 to {LONGEST_DEAD_TIME_SAMPLES}")
    return DeadTime(inner=or_ideal(inner), samples=samples)
