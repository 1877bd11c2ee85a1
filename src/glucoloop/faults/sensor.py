"""Faults of a sensor, each one class: its settings, and what is reported in place of a reading.

A fault wraps any sensor, an ideal one by default, and faults wrap one another::

    Drift(5.0, schedule=once(12), inner=WhiteNoise())
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import KW_ONLY
from typing import Annotated, Any, ClassVar, Final

from glucoloop._lazy_jax import jax, jnp, np
from glucoloop.component.pytree_component import DATA, HOST, derived, derived_static, wired
from glucoloop.component.setting import About
from glucoloop.faults.fault import FaultState, Timed
from glucoloop.refusal import Refusal
from glucoloop.sensors.delay import LONGEST_DEAD_TIME_SAMPLES, filled, joined, one_of, without_oldest
from glucoloop.sensors.protocol import IdealSensor, Reading, Sensor
from glucoloop.unit_guess import GLUCOSE_BOUND
from glucoloop.units import MIN_PER_H

_NONSENSE: Final = (math.nan, math.inf, -math.inf, 0.0, 2000.0, 1e300, -1e300, -40.0, 600.0, 20.0)
_HAIR: Final = 1e-9  # of a sample: whole minutes over whole minutes may come out just above a whole number
_CHOICE: Final = 1  # sets the choice of a reading apart from the draws of an episode
_NOTHING: Final = 1e-4  # of a reading: far below what a sensor resolves


class SensorFault(Timed):
    """A fault around a sensor.

    One that changes single readings has the method `altered`; one that remembers has `start` and `report`.
    """

    _: KW_ONLY
    inner: Sensor = wired(DATA, default_factory=IdealSensor)

    def init(self, glucose_mg_dl: jax.Array, key: jax.Array) -> FaultState:
        """State before the first reading; what is inside has the same key as without the fault."""
        return FaultState(
            inner=self.inner.init(glucose_mg_dl, key),
            episode=self.episodes.init(glucose_mg_dl, key),
            memory=self.start(glucose_mg_dl),
        )

    def read(self, state: FaultState, glucose_mg_dl: jax.Array, key: jax.Array) -> tuple[FaultState, Reading]:
        """Read the inner sensor, and report what the fault makes of it."""
        inner, reading = self.inner.read(state.inner, glucose_mg_dl, key)
        episode, age = self.episodes.step(state.episode, key)
        memory, reported = self.report(state.memory, reading, age, key)
        return FaultState(inner=inner, episode=episode, memory=memory), reported

    def start(self, glucose_mg_dl: jax.Array) -> Any:
        """Memory of the fault after glucose has been steady for a long time; none by default."""
        return None

    def report(self, memory: Any, reading: Reading, age: jax.Array, key: jax.Array) -> tuple[Any, Reading]:
        """Memory after a reading, and the reported one; `age` counts samples since the fault began, -1 without it."""
        return memory, _where(age >= 0.0, self.altered(reading, age), reading)

    def altered(self, reading: Reading, age: jax.Array) -> Reading:
        """Reading that is reported in place of the inner sensor's while the fault is present."""
        raise NotImplementedError


def _where(condition: jax.Array, reading: Reading, otherwise: Reading) -> Reading:
    chosen: Reading = jax.tree.map(lambda a, b: b if a is b else jnp.where(condition, a, b), reading, otherwise)
    return chosen


def _valid(glucose_mg_dl: jax.Array) -> Reading:
    return Reading(glucose_mg_dl=glucose_mg_dl, valid=jnp.ones(jnp.shape(glucose_mg_dl), bool))


class Missing(SensorFault, name="missing"):
    """Readings do not arrive.

    About 90 % of the disconnections of a sensor in 72 people lasted less than 20 min: abstract of A. Facchinetti,
    S. Del Favero, G. Sparacino, C. Cobelli, "Modeling transient disconnections and compression artifacts of continuous
    glucose sensors", Diabetes Technol. Ther. 18, 264-272, 2016.
    """

    def altered(self, reading: Reading, age: jax.Array) -> Reading:
        """Reading without a number, marked as not valid."""
        none = jnp.full_like(reading.glucose_mg_dl, jnp.nan)
        return Reading(glucose_mg_dl=none, valid=jnp.zeros_like(reading.valid))


class Late(SensorFault, name="late"):
    """Readings arrive late and do not say so.

    Before the first late reading, the initial glucose is reported. A delay that is always there is `DeadTime`.
    """

    delay_min: Annotated[float, About("Delay of the readings, rounded up to samples.", above=0.0), HOST] = 15.0
    shared: ClassVar = {"delay_min": lambda whole: 5.0 * whole("delay", 1, 12)}

    @derived_static
    def samples(self) -> int:
        """The delay in samples."""
        samples = math.ceil(self.delay_min / self.sample_time_min - _HAIR)
        if not 1 <= samples <= LONGEST_DEAD_TIME_SAMPLES:
            raise Refusal(
                f"a delay of {samples} samples is not possible; give 1 to {LONGEST_DEAD_TIME_SAMPLES} samples, up to "
                f"{LONGEST_DEAD_TIME_SAMPLES * self.sample_time_min:g} min"
            )
        return samples

    def start(self, glucose_mg_dl: jax.Array) -> Reading:
        """The initial glucose as past readings."""
        return filled(self.samples, glucose_mg_dl)

    def report(self, memory: Reading, reading: Reading, age: jax.Array, key: jax.Array) -> tuple[Reading, Reading]:
        """The oldest reading of the delay line."""
        line = joined(memory, reading)
        return without_oldest(line), _where(age >= 0.0, one_of(line, 0), reading)


class Repeated(SensorFault, name="repeated"):
    """Each reading is given several times.

    The first of them is that at which the fault begins.
    """

    times: Annotated[int, About("Number of times that each reading is given.", at_least=2), DATA] = 3
    drawn: ClassVar = {"times": lambda even: even(2.0, 13.0) // 1.0}

    def start(self, glucose_mg_dl: jax.Array) -> tuple[Reading, jax.Array]:
        """A reading that was not yet reported."""
        return _valid(glucose_mg_dl), jnp.zeros_like(glucose_mg_dl)

    def report(
        self, memory: tuple[Reading, jax.Array], reading: Reading, age: jax.Array, key: jax.Array
    ) -> tuple[tuple[Reading, jax.Array], Reading]:
        """The last reading, until it was reported often enough."""
        last, count = memory
        again = (age > 0.0) & (count < self.times)
        reported = _where(again, last, reading)
        return (reported, jnp.where(again, count + 1.0, 1.0)), reported


class OutOfOrder(SensorFault, name="out-of-order"):
    """A random one of the latest readings is given.

    Each has the same probability, and it is drawn again at each sample.
    """

    among: Annotated[int, About("Number of latest readings among which one is drawn.", at_least=2, at_most=48)] = 4
    shared: ClassVar = {"among": lambda whole: whole("among", 2, 8)}

    def start(self, glucose_mg_dl: jax.Array) -> Reading:
        """The initial glucose as past readings."""
        return filled(self.among - 1, glucose_mg_dl)

    def report(self, memory: Reading, reading: Reading, age: jax.Array, key: jax.Array) -> tuple[Reading, Reading]:
        """One of the latest readings."""
        line = joined(memory, reading)
        choice_key = jax.random.fold_in(self.episodes.own(key), _CHOICE)
        choice = self.among * jax.random.uniform(choice_key, age.shape, age.dtype)
        reported = reading
        for place in range(self.among - 1):
            # native code cannot take a random place of an array, but it can choose between values
            chosen = (age >= 0.0) & (choice >= place) & (choice < place + 1)
            reported = _where(chosen, one_of(line, place), reported)
        return without_oldest(line), reported


class Spikes(SensorFault, name="spikes"):
    """Readings are off by a fixed amount."""

    size_mg_dl: Annotated[float, About("Error of the readings, of either sign.")] = 60.0
    drawn: ClassVar = {"size_mg_dl": lambda even: even(-1000.0, 1000.0)}

    def altered(self, reading: Reading, age: jax.Array) -> Reading:
        """The reading and the fixed amount."""
        return dataclasses.replace(reading, glucose_mg_dl=reading.glucose_mg_dl + self.size_mg_dl)


class Stuck(SensorFault, name="stuck"):
    """The reading at the start of the fault is repeated."""

    def start(self, glucose_mg_dl: jax.Array) -> Reading:
        """The initial glucose, until there is a reading."""
        return _valid(glucose_mg_dl)

    def report(self, memory: Reading, reading: Reading, age: jax.Array, key: jax.Array) -> tuple[Reading, Reading]:
        """The reading at which the fault began."""
        reported = _where(age > 0.0, memory, reading)
        return reported, reported


class Drift(SensorFault, name="drift"):
    """Readings have an error that grows with time.

    It grows from zero at the start, and readings are correct again after the fault.
    """

    mg_dl_h: Annotated[float, About("Growth of the error in an hour, of either sign.", unit="mg/dl per hour"), HOST] = (
        5.0
    )
    drawn: ClassVar = {"mg_dl_h": lambda even: even(-1.0, 1.0) * 10.0 ** even(0.0, 3.0, 1)}

    @derived
    def mg_dl_sample(self) -> float:
        """Growth from one sample to the next."""
        return self.mg_dl_h * self.sample_time_min / MIN_PER_H

    def altered(self, reading: Reading, age: jax.Array) -> Reading:
        """The reading and the drift since the start."""
        return dataclasses.replace(reading, glucose_mg_dl=reading.glucose_mg_dl + self.mg_dl_sample * age)


class Calibration(SensorFault, name="calibration"):
    """Readings are wrong by a gain and an offset."""

    gain: Annotated[float, About("Factor from the correct reading to the given one.", above=0.0)] = 1.15
    offset_mg_dl: Annotated[float, About("Offset that is added after the gain.")] = 0.0
    drawn: ClassVar = {
        "gain": lambda even: 10.0 ** even(-1.0, 1.0),
        "offset_mg_dl": lambda even: even(-200.0, 200.0, 1),
    }

    def altered(self, reading: Reading, age: jax.Array) -> Reading:
        """Gain and offset applied to the reading."""
        return dataclasses.replace(reading, glucose_mg_dl=self.gain * reading.glucose_mg_dl + self.offset_mg_dl)


class Compression(SensorFault, name="compression"):
    """Readings fall because someone lies on the sensor.

    ``(1 - fall) * reading``, where the fall goes to its depth and back as a first-order system driven by a rectangular
    function, as in A. Facchinetti, S. Del Favero, G. Sparacino, C. Cobelli, "Modeling transient disconnections and
    compression artifacts of continuous glucose sensors", Diabetes Technol. Ther. 18, 264-272, 2016. Its abstract gives
    for Dexcom G4 sensors a median duration of 45 min (30 to 70 min from the 5th to the 95th percentile) and a median
    amplitude of 24 mg/dl (10 to 48 mg/dl). Here the fall is a fraction of the reading, so that it never exceeds the
    reading. The first affected sample has the fall after one sample time; a fall that has gone back to a ten-thousandth
    of the reading is over. The time constant is a choice: nearly the full depth is reached within the median duration.
    """

    sources = ("facchinetti2016",)
    depth: Annotated[float, About("Part of the reading that is finally lost.", above=0.0, at_most=1.0)] = 0.3
    tau_min: Annotated[float, About("Time constant of fall and recovery.", above=0.0), HOST] = 10.0
    drawn: ClassVar = {"depth": lambda even: even(0.05, 1.0), "tau_min": lambda even: even(1.0, 60.0, 1)}

    @derived
    def left(self) -> Any:
        """Share of the remaining way that is left after a sample."""
        return np.exp(-self.sample_time_min / self.tau_min)

    def start(self, glucose_mg_dl: jax.Array) -> jax.Array:
        """Fraction of the reading that is lost: none."""
        return jnp.zeros_like(glucose_mg_dl)

    def report(self, memory: jax.Array, reading: Reading, age: jax.Array, key: jax.Array) -> tuple[jax.Array, Reading]:
        """The part of the reading that is not lost."""
        present = age >= 0.0
        goal = jnp.where(present, self.depth, 0.0)
        fall = goal + self.left * (memory - goal)
        fall = jnp.where(present | (fall > _NOTHING), fall, 0.0)
        glucose = reading.glucose_mg_dl
        reported = jnp.where(fall > 0.0, glucose - fall * glucose, glucose)
        return fall, dataclasses.replace(reading, glucose_mg_dl=reported)


class Saturation(SensorFault, name="saturation"):
    """Readings are limited to a range.

    The default is the range in which continuous glucose monitors give a number.
    """

    low_mg_dl: Annotated[float, About("Lower end of the range.", at_least=0.0, quantity=GLUCOSE_BOUND)] = 40.0
    high_mg_dl: Annotated[float, About("Upper end of the range.", above=0.0, quantity=GLUCOSE_BOUND)] = 400.0
    drawn: ClassVar = {
        "low_mg_dl": lambda even: even(0.0, 150.0),
        "high_mg_dl": lambda even: even(0.0, 150.0) + even(1.0, 300.0, 1),
    }

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.low_mg_dl < self.high_mg_dl:
            raise Refusal(
                f"a sensor range of {self.low_mg_dl:g} to {self.high_mg_dl:g} mg/dl is not possible; "
                "give an upper end above the lower one"
            )

    def altered(self, reading: Reading, age: jax.Array) -> Reading:
        """The reading, clipped to the range; a reading that is not a number stays so."""
        glucose = jnp.clip(reading.glucose_mg_dl, self.low_mg_dl, self.high_mg_dl)
        return dataclasses.replace(reading, glucose_mg_dl=glucose)


class Nonsense(SensorFault, name="nonsense"):
    """A fixed number is given as a valid reading: nan, inf, 0, 2000."""

    value: Annotated[float, About("Number that is given.", finite=False)] = 0.0
    drawn: ClassVar = {"value": lambda even: [_NONSENSE[int(place)] for place in even(0.0, float(len(_NONSENSE)))]}

    def altered(self, reading: Reading, age: jax.Array) -> Reading:
        """The number, whatever glucose is."""
        number = jnp.broadcast_to(self.value, jnp.shape(reading.glucose_mg_dl))
        return Reading(glucose_mg_dl=number, valid=jnp.ones_like(reading.valid))
