"""Sensors that are late: behind a first-order lag, or by a dead time of whole samples.

Subcutaneous glucose follows glucose in the blood some minutes later, by the lag of one compartment,
``lag r' = G - r``. Between two samples glucose G is taken to change evenly, for which the equation is solved exactly.

References
----------
K. Rebrin, G. M. Steil, W. P. van Antwerp, J. J. Mastrototaro, "Subcutaneous glucose predicts plasma glucose independent
of insulin: implications for continuous monitoring", Am. J. Physiol. 277(3), 1999: the compartment.
"""

from __future__ import annotations

import operator
from dataclasses import KW_ONLY
from typing import TYPE_CHECKING, Annotated, Any, Final

from glucoloop._lazy_jax import jax, jnp
from glucoloop._pytree import pytree
from glucoloop.arguments import checked
from glucoloop.component.pytree_component import HOST, STATIC, derived_static, wired
from glucoloop.component.setting import About
from glucoloop.refusal import Refusal
from glucoloop.sensors.protocol import IdealSensor, Reading, Sensor, SensorAround, whole_samples
from glucoloop.unit_guess import DEAD_TIME, LAG
from glucoloop.units import MIN_PER_DAY

if TYPE_CHECKING:
    from jax.typing import ArrayLike

LONGEST_LAG_MIN: Final = 120.0


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


class Lag(SensorAround, name="lag"):
    """Glucose behind a first-order lag, as under the skin.

    The noise of the sensor inside does not lag.
    """

    sources = ("rebrin1999",)
    lag_min: Annotated[
        float, About("Time constant of the lag behind glucose.", above=0.0, at_most=LONGEST_LAG_MIN, quantity=LAG)
    ] = 10.0

    _: KW_ONLY
    sample_time_min: float = wired(STATIC, default=5.0)

    def init(self, glucose_mg_dl: jax.Array, key: jax.Array) -> _State:
        """State of a sensor that has read the given glucose for a long time."""
        return _State(inner=self.inner.init(glucose_mg_dl, key), glucose=glucose_mg_dl, behind=glucose_mg_dl)

    def read(self, state: _State, glucose_mg_dl: jax.Array, key: jax.Array) -> tuple[_State, Reading]:
        """Reading of the inner sensor, to which glucose comes through the lag."""
        behind = lagged(state.behind, state.glucose, glucose_mg_dl, self.lag_min, self.sample_time_min)
        inner, reading = self.inner.read(state.inner, behind, key)
        return _State(inner=inner, glucose=glucose_mg_dl, behind=behind), reading


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


class DeadTime(SensorAround, name="dead-time"):
    """Readings that are given some time later.

    Before the first such reading, the initial glucose is given.
    """

    minutes: Annotated[
        float,
        About(
            "Time after which a reading is given; a whole number of samples.",
            at_least=0.0,
            at_most=MIN_PER_DAY,
            unit="min",
            quantity=DEAD_TIME,
        ),
        HOST,
    ] = 5.0

    @derived_static
    def samples(self) -> int:
        """The time as a number of samples; Refusal unless it is a whole number of them."""
        return whole_samples(self.minutes, self.sample_time_min, "a dead time")

    def recorded(self) -> None:
        """Leave the delay out."""

    def made(self, **surroundings: Any) -> Sensor:
        """The sensor; the one inside where the time is 0."""
        late = super().made(**surroundings)
        chosen: Sensor = late if late.samples else late.inner
        return chosen

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
    return DeadTime(5.0 * samples, inner=IdealSensor() if inner is None else inner)
