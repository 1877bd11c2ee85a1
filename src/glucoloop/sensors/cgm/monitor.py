"""A continuous glucose monitor on a person: inserted, worn for days with its errors, and replaced by a new one."""

from __future__ import annotations

import math
from dataclasses import KW_ONLY
from typing import Annotated, Any, ClassVar, Final

from glucoloop._lazy_jax import jax, jnp
from glucoloop._pytree import pytree, static
from glucoloop.component.pytree_component import HOST, STATIC, derived, derived_static, wired
from glucoloop.component.setting import About
from glucoloop.refusal import Refusal
from glucoloop.sensors.cgm.model import (
    CANDIDATES,
    Constants,
    ErrorModel,
    Johnson,
    Spread,
    Ticks,
    candidate,
    constants_of,
    drawn,
)
from glucoloop.sensors.delay import LONGEST_LAG_MIN, Lag
from glucoloop.sensors.protocol import Reading, Sensor, SensorAround
from glucoloop.unit_guess import GLUCOSE_BOUND
from glucoloop.units import MIN_PER_DAY


@pytree
class _DisplayState:
    inner: Any
    since: jax.Array | None
    """Parts of a tick since the latest reading; None where each sample has one."""


class Display(SensorAround, name="cgm-display"):
    """Readings as a continuous glucose monitor shows them: its range, whole steps, one every few minutes.

    Beyond its range a monitor shows LOW or HIGH; here the reading is the end of the range, and valid: a controller has
    to act on it. The first sample at or after the time of a reading has one, samples between have none: they are not a
    number, and not valid.
    """

    low_mg_dl: Annotated[
        float,
        About("Lower end of the range, which is given for less.", at_least=0.0, at_most=2000.0, quantity=GLUCOSE_BOUND),
    ] = 40.0
    high_mg_dl: Annotated[
        float,
        About("Upper end of the range, which is given for more.", above=0.0, at_most=2000.0, quantity=GLUCOSE_BOUND),
    ] = 400.0
    step_mg_dl: Annotated[float, About("Step of the readings.", above=0.0, at_most=100.0)] = 1.0
    every_min: Annotated[
        float, About("Time between two readings; samples between have none.", above=0.0, at_most=LONGEST_LAG_MIN), HOST
    ] = 5.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.low_mg_dl < self.high_mg_dl:
            raise Refusal(
                f"a range of {self.low_mg_dl:g} to {self.high_mg_dl:g} mg/dl is not possible; "
                f"{GLUCOSE_BOUND.looks_like(self.high_mg_dl) or 'give an upper end above the lower one'}"
            )

    @derived_static
    def ticks(self) -> Ticks:
        """Times of the readings."""
        return Ticks.seen(self.sample_time_min, self.every_min)

    def init(self, glucose_mg_dl: jax.Array, key: jax.Array) -> _DisplayState:
        """State before the first sample, which has a reading."""
        every = self.ticks.ahead >= self.ticks.of_tick
        due = jnp.full(jnp.shape(glucose_mg_dl), float(self.ticks.of_tick), jnp.result_type(float, glucose_mg_dl))
        return _DisplayState(inner=self.inner.init(glucose_mg_dl, key), since=None if every else due)

    def read(self, state: _DisplayState, glucose_mg_dl: jax.Array, key: jax.Array) -> tuple[_DisplayState, Reading]:
        """Read the inner sensor, and show it if a reading is due; otherwise there is none."""
        inner, reading = self.inner.read(state.inner, glucose_mg_dl, key)
        steps = self.step_mg_dl * jnp.round(reading.glucose_mg_dl / self.step_mg_dl)
        display, valid, since = jnp.clip(steps, self.low_mg_dl, self.high_mg_dl), reading.valid, state.since
        if since is not None:
            due = since >= self.ticks.of_tick
            since = jnp.where(due, since - self.ticks.of_tick, since) + self.ticks.ahead
            display, valid = jnp.where(due, display, jnp.nan), valid & due
        return _DisplayState(inner=inner, since=since), Reading(glucose_mg_dl=display, valid=valid)


_INTERSTITIAL: Final = "interstitial"
_NUMBERS: Final = 7
_DRAWN: Final = -1.0
_LONGEST_WEAR_MIN: Final = 30.0 * MIN_PER_DAY


@pytree
class _State:
    inner: Any
    age: jax.Array
    """Samples from the insertion to the coming one."""
    own: Constants | None
    """Constants of this sensor; None where all are alike."""
    spare: Constants | None
    """Constants of the next sensor: those of the latest candidate that is taken."""
    points: jax.Array | None
    """(2, processes, ...) the latest point of the noise before the coming sample, and the one at or after it."""
    since: jax.Array | None
    """Parts of a step of the noise from the first of them to the coming sample; None where it is always a whole one."""


@pytree
class MonitorErrors:
    """Adds the errors of a model over the days of wear to the reading of the inner sensor."""

    inner: Sensor
    constants: Constants | None
    """Constants of all sensors; None for sensors that differ."""
    warm_up: jax.Array | float
    """Samples after an insertion without a reading."""
    wear: jax.Array | float
    """Samples from one insertion to the next."""
    worn: jax.Array | float
    """Samples since the insertion at the start; below 0 where it is drawn."""
    calibrated: jax.Array | float
    """Samples from one calibration to the next; those of the wear for a sensor that is not calibrated."""
    sample_time_min: float = static()
    spread: Spread | None = static()
    shape: Johnson | None = static()
    steps: Ticks = static()
    """Steps of the noise."""
    noise: bool = static()
    drift: bool = static()

    def init(self, glucose_mg_dl: jax.Array, key: jax.Array) -> _State:
        """State before the first reading; sensor, noise and, unless it is set, the time since insertion are drawn."""
        age_key, sensor_key, noise_key, inner_key = jax.random.split(key, 4)
        shape, dtype = jnp.shape(glucose_mg_dl), jnp.result_type(float, glucose_mg_dl)
        span = self.wear - self.warm_up
        within = jnp.minimum(jnp.floor(span * jax.random.uniform(age_key, shape, dtype)), span - 1.0)
        age = jnp.where(self.worn < 0.0, self.warm_up + within, self.worn)
        own = None
        if self.spread is not None:
            own = drawn(self.spread, jax.random.normal(sensor_key, (_NUMBERS, CANDIDATES, *shape), dtype))
        points = self._of(own, shape).begin(self._normal(noise_key, 2, shape, dtype)) if self.noise else None
        return _State(
            inner=self.inner.init(glucose_mg_dl, inner_key),
            age=age,
            own=own,
            spare=own,
            points=points,
            since=jnp.full(shape, float(self.steps.of_tick), dtype) if self._between else None,
        )

    def read(self, state: _State, glucose_mg_dl: jax.Array, key: jax.Array) -> tuple[_State, Reading]:
        """Read the inner sensor with the errors of this day; there is no reading while the sensor warms up."""
        sensor_key, noise_key, inner_key = jax.random.split(key, 3)
        inner, reading = self.inner.read(state.inner, glucose_mg_dl, inner_key)
        shape, dtype = state.age.shape, state.age.dtype
        constants, value = self._of(state.own, shape), reading.glucose_mg_dl
        if self.drift:
            days = jnp.fmod(state.age, self.calibrated) * (self.sample_time_min / MIN_PER_DAY)
            value = constants.altered(value, days)
        if state.points is not None:
            value = value + self._error(state.points, state.since)
        ready = state.age >= self.warm_up
        reported = Reading(glucose_mg_dl=jnp.where(ready, value, jnp.nan), valid=reading.valid & ready)

        # and on to the next sample
        age, own, spare, points, since = state.age + 1.0, state.own, state.spare, state.points, state.since
        new = age >= self.wear
        if self.spread is not None:
            constants_of_candidate, taken = candidate(
                self.spread, jax.random.normal(sensor_key, (_NUMBERS, *shape), dtype)
            )
            spare = _where(taken, constants_of_candidate, spare)
            own = _where(new, spare, own)
        if points is not None:
            normal = self._normal(noise_key, max(2, self._most_steps), shape, dtype)
            later, since = self._advanced(constants, points, since, normal)
            points = jnp.where(new, self._of(own, shape).begin(normal[:2]), later)
        age = jnp.where(new, 0.0, age)
        return _State(inner=inner, age=age, own=own, spare=spare, points=points, since=since), reported

    @property
    def _between(self) -> bool:
        """Whether samples lie between the points of the noise."""
        return self.noise and self.steps.of_tick > 1

    @property
    def _most_steps(self) -> int:
        """Largest number of steps of the noise from one sample to the next."""
        return -(-self.steps.ahead // self.steps.of_tick)

    def _of(self, own: Constants | None, shape: tuple[int, ...]) -> Constants:
        """Constants of the sensor, or of all of them with axes for people."""
        if own is not None:
            return own
        alike: Constants = jax.tree.map(lambda c: c.reshape(-1, *[1] * len(shape)), self.constants)
        return alike

    def _normal(self, key: jax.Array, points: int, shape: tuple[int, ...], dtype: Any) -> jax.Array:
        processes = 1 if self.constants is None else self.constants.alpha1.shape[0]
        return jax.random.normal(key, (points, processes, *shape), dtype)

    def _error(self, points: jax.Array, since: jax.Array | None) -> jax.Array:
        """Noise of a sample, on the line between two points."""
        total = points.sum(axis=1)
        if self.shape is not None:
            total = self.shape(total)
        if since is None:
            return total[1]
        share = since / self.steps.of_tick
        return (1.0 - share) * total[0] + share * total[1]

    def _advanced(
        self, constants: Constants, points: jax.Array, since: jax.Array | None, normal: jax.Array
    ) -> tuple[jax.Array, jax.Array | None]:
        """Points around the next sample, of normal numbers ``(steps, processes, ...)``."""
        if since is None:
            for numbers in normal[: self.steps.ahead]:
                points = constants.advance(points, numbers)
            return points, None
        since = since + self.steps.ahead
        for numbers in normal[: self._most_steps]:
            beyond = since > self.steps.of_tick
            points = jnp.where(beyond, constants.advance(points, numbers), points)
            since = jnp.where(beyond, since - self.steps.of_tick, since)
        return points, since


def _where(condition: jax.Array, new: Any, old: Any) -> Any:
    return jax.tree.map(lambda a, b: jnp.where(condition, a, b), new, old)


class Monitor(SensorAround):
    """A continuous glucose monitor with the errors of a model, from the tissue to the display.

    The reading of the inner sensor has the errors of the model, then the range, the step and the 5 min of a display,
    and glucose comes to it through a lag. A class of a monitor has its model, and its own defaults.
    """

    model: ClassVar[ErrorModel] = ErrorModel()
    """Errors of the sensor."""
    lag_min: Annotated[
        float | None,
        About(
            "Lag of glucose at the sensor behind that of blood; by default that of the model, and none where the site "
            "is interstitial.",
            at_least=0.0,
            at_most=LONGEST_LAG_MIN,
        ),
        HOST,
    ] = None
    noise: Annotated[bool, About("Whether readings have noise: true or false.")] = True
    drift: Annotated[
        bool, About("Whether readings have the error of calibration, which changes with time: true or false.")
    ] = True
    display: Annotated[
        bool, About("Whether readings are those of a display, as cgm-display has them: true or false.")
    ] = True
    warm_up_min: Annotated[
        float, About("Time after an insertion without readings.", at_least=0.0, at_most=MIN_PER_DAY), HOST
    ] = 120.0
    wear_min: Annotated[
        float,
        About("Time from one insertion to the next, of another sensor.", above=0.0, at_most=_LONGEST_WEAR_MIN),
        HOST,
    ] = 10.0 * MIN_PER_DAY
    worn_min: Annotated[
        float | None,
        About(
            "Time since the insertion at the start; by default drawn for each person, and 0 begins with the warm-up.",
            at_least=0.0,
            at_most=_LONGEST_WEAR_MIN,
        ),
        HOST,
    ] = None

    _: KW_ONLY
    site: str | None = wired(STATIC, default=None)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.warm_up_min >= self.wear_min:
            raise Refusal(
                f"warm_up_min is {self.warm_up_min:g} min, but the sensor is replaced after {self.wear_min:g} min, "
                "so that it never has a reading; give less"
            )
        if self.worn_min is not None and self.worn_min >= self.wear_min:
            raise Refusal(
                f"worn_min is {self.worn_min:g} min, but the sensor is replaced after {self.wear_min:g} min; give less"
            )

    def recorded(self) -> Monitor:
        """Lag of the monitor alone: a model is identified from readings that were corrected with references."""
        return type(self)(lag_min=self.lag_min, noise=False, drift=False, display=False, warm_up_min=0.0)

    @derived
    def chain(self) -> Sensor:
        """The sensor inside with the errors, the display and the lag, one around another."""
        sensor: Sensor = self._errors()
        if self.display:
            sensor = Display(inner=sensor, sample_time_min=self.sample_time_min)
        lag_min = self.lag_min
        if lag_min is None:
            lag_min = 0.0 if self.site == _INTERSTITIAL else self.model.lag_min
        return Lag(lag_min, inner=sensor, sample_time_min=self.sample_time_min) if lag_min else sensor

    def _errors(self) -> MonitorErrors:
        model = self.model
        if self.drift and self.wear_min > model.longest_wear_min:
            raise Refusal(
                f"wear_min is {self.wear_min:g} min, but the drift of this sensor is known for "
                f"{model.longest_wear_min / MIN_PER_DAY:g} days; give up to {model.longest_wear_min:g} min, or "
                "drift=false"
            )

        def samples(minutes: float) -> int:
            return math.ceil(minutes / self.sample_time_min - 1e-9)

        wear = max(samples(self.wear_min), samples(self.warm_up_min) + 1)
        worn = _DRAWN
        if self.worn_min is not None:
            worn = min(math.floor(self.worn_min / self.sample_time_min + 1e-9), wear - 1)
        return MonitorErrors(
            inner=self.inner,
            constants=constants_of(model) if model.spread is None else None,
            warm_up=float(samples(self.warm_up_min)),
            wear=float(wear),
            worn=float(worn),
            calibrated=float(min(samples(min(model.calibrated_every_min, self.wear_min)), wear)),
            sample_time_min=self.sample_time_min,
            spread=model.spread,
            shape=model.shape,
            steps=Ticks.seen(self.sample_time_min, model.step_min),
            noise=self.noise,
            drift=self.drift,
        )

    def made(self, **surroundings: Any) -> Sensor:
        """The chain of the monitor in its surroundings."""
        chain: Sensor = super().made(**surroundings).chain
        return chain

    def init(self, glucose_mg_dl: jax.Array, key: jax.Array) -> Any:
        """State of the chain."""
        return self.chain.init(glucose_mg_dl, key)

    def read(self, state: Any, glucose_mg_dl: jax.Array, key: jax.Array) -> tuple[Any, Reading]:
        """Reading of the chain."""
        return self.chain.read(state, glucose_mg_dl, key)
