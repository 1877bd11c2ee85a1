"""One patient, stepped sample by sample with doses from outside: for a real-time loop, a game, or another program."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Sequence
from typing import Any, Final, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from glucoloop._kept_programs import kept_jit
from glucoloop._pytree import pytree
from glucoloop.arguments import ArgumentTypeError, checked, random_key
from glucoloop.component.effects import RHYTHMS, warn_without_effect
from glucoloop.control.protocol import Decision, Observation, Status
from glucoloop.meals.absorption import Absorption, absorb
from glucoloop.meals.models import meal_model_of
from glucoloop.meals.protocol import SHORTEST_EATING_MIN, Eaten, MealModel, OdeMealModel
from glucoloop.meals.scenario import Meal, Scenario
from glucoloop.patients.capabilities import takes_exercise
from glucoloop.patients.protocol import Patient
from glucoloop.physiology.exercise import Bouts, Exercise, refuse_exercise
from glucoloop.physiology.rhythm import Rhythm
from glucoloop.pumps import LimitedPump, Pump
from glucoloop.pumps.protocol import gives_bolus
from glucoloop.refusal import Refusal
from glucoloop.sensors import IdealSensor, Sensor
from glucoloop.simulation.closed_loop import (
    on_the_grid,
    sample_grid,
    start_of,
    trace_of,
    usual_limits,
    with_minute_inputs,
)
from glucoloop.simulation.integrators import default_integrator
from glucoloop.simulation.loop import Loop, LoopState, Sampled, begin, look, sample
from glucoloop.simulation.minute_inputs import minute_inputs_between, minute_inputs_of, refuse_minute_inputs
from glucoloop.simulation.plant import MinuteInputs, SampleGrid, SteppingIntegrator
from glucoloop.simulation.trace import Trace
from glucoloop.simulation.user_objects import Fixed, apart
from glucoloop.simulation.vector_stepper import ExternalDoses
from glucoloop.snapshot import fingerprint, pack, unpack
from glucoloop.units import LONGEST_RUN_MIN, MIN_PER_DAY

E = TypeVar("E")

_FIRST_ROOM: Final = 8
"""Initial number of meals that can be stored; it is doubled where more than half of them still reach the gut."""
_NO_MEALS: Final = Eaten(**{name: np.zeros(_FIRST_ROOM) for name in ("t_min", "carbs_g", "eating_min")})

_NO_BOUTS: Final = np.zeros((3, 0))
"""Intensity, time and duration of no bout of exercise."""


@pytree
class _Now:
    """State of a stepper."""

    loop: LoopState
    sample: jax.Array
    """Number of the coming sample."""
    key: jax.Array
    eaten: Eaten
    """(room,) meals that have begun, but for those whose last jump was before; 0 g for free places."""
    meals: jax.Array
    """Number of meals there."""
    gut: Any
    """State of the gut before the coming sample."""


@kept_jit(static_argnums=1)
def _begin(numbers: list[Any], fixed: Fixed, x: jax.Array, insulin: jax.Array, key: jax.Array) -> Any:
    return begin(fixed.joined(numbers), x, insulin, jnp.zeros(()), key)


@kept_jit(static_argnums=1)
def _look(numbers: list[Any], fixed: Fixed, now: _Now, announced_g: float, start_min: float | None) -> Observation:
    loop: Loop = fixed.joined(numbers)
    time = None if start_min is None else (start_min + now.sample * loop.controller.sample_time_min) % MIN_PER_DAY
    return look(loop, now.loop, jnp.asarray(announced_g), now.key, now.sample, time)[2]


@kept_jit(static_argnums=(1, 2, 3))
def _step(
    numbers: list[Any],
    fixed: Fixed,
    integrator: SteppingIntegrator,
    grid: SampleGrid,
    now: _Now,
    absorption: Absorption,
    minute_inputs: MinuteInputs,
    insulin_mU_min: float,
    bolus_mU: float | None,
) -> tuple[_Now, Sampled]:
    loop: Loop = fixed.joined(numbers)
    plant, outside, gut = integrator.at_sample(loop.plant, absorption.goes_on(now.gut), grid, now.sample)
    outside = dataclasses.replace(outside, minute_inputs=minute_inputs)
    bolus = None if bolus_mU is None else jnp.asarray(bolus_mU, float)
    controller = dataclasses.replace(
        loop.controller,  # type: ignore[type-var]
        insulin_mU_min=jnp.asarray(insulin_mU_min),
        bolus_mU=bolus,
    )
    loop = dataclasses.replace(loop, plant=plant, controller=controller)
    after, happened = sample(loop, now.loop, outside, jnp.zeros(()), now.key, now.sample)
    return dataclasses.replace(now, loop=after, sample=now.sample + 1, gut=gut), happened


class Stepper:
    """A patient with sensor and pump, stepped from sample to sample.

    It is the loop of `simulate` with the controller left out: given the doses of a controller, it goes through the same
    numbers. `observation` is what a controller may see; the patient's own glucose is there for whoever watches.

    Parameters
    ----------
    sensor, pump : Sensor, Pump, optional
        Argument as for `simulate`.
    setpoint_mg_dl : float, optional
        Setpoint in the observations; the patient's own by default.
    initial_glucose_mg_dl : float, optional
        The patient starts at steady state at this value; at the setpoint of the patient by default.
    allow_unusual : bool
        Whether an implausible glucose, such as 5.5 mg/dl, is accepted.
    key : JAX key or int
        Source of all randomness.
    integrator : SteppingIntegrator, optional
        Argument as for `simulate`.
    meal_model : MealModel, optional
        Model of absorption; the patient's own by default.
    start_min : float, optional
        Time of day at the start, in minutes after midnight, of which the observations tell; by default they do not.
    warm_up_min : float
        Time to `start_min`, or to midnight by default, at which the stepper begins.
    rhythms, rhythm_seed, rhythm_person
        Arguments as for `Scenario`.
    announced_in_min : float, optional
        Time to eating that an announcement tells; by default meals are announced when they begin.

    Examples
    --------
    >>> import glucoloop as gl
    >>> stepper = gl.Stepper(gl.patient(), gl.white_noise(1.45), key=3)
    >>> controller = gl.design_pid(gl.PIDTuning(0.5, 150.0))
    >>> seen = stepper.observation()
    >>> state = controller.init(seen)
    >>> for sample in range(3):
    ...     state, decision = controller.step(state, seen)
    ...     seen = stepper.step(decision.insulin_mU_min, carbs_g=50.0 if sample == 1 else 0.0)
    >>> stepper.t_min
    15.0
    """

    @checked
    def __init__(
        self,
        patient: Patient,
        sensor: Sensor | None = None,
        pump: Pump | None = None,
        *,
        sample_time_min: float = 5.0,
        setpoint_mg_dl: float | None = None,
        initial_glucose_mg_dl: float | None = None,
        allow_unusual: bool = False,
        key: jax.Array | int = 0,
        integrator: SteppingIntegrator | None = None,
        meal_model: MealModel | None = None,
        start_min: float | None = None,
        warm_up_min: float = 0.0,
        rhythms: Iterable[Rhythm] = (),
        rhythm_seed: int = 0,
        rhythm_person: int = 0,
        announced_in_min: float | None = None,
    ) -> None:
        begins_min = ((start_min or 0.0) - warm_up_min) % MIN_PER_DAY
        self._grid = SampleGrid(sample_time_min=sample_time_min, samples=1, start_min=begins_min)
        self._rhythms = tuple(rhythms), rhythm_seed, rhythm_person
        if not self._rhythms[0]:
            seeds = {"rhythm_seed": rhythm_seed, "rhythm_person": rhythm_person}
            notes = (f"{name} has no effect: {RHYTHMS.reason}." for name, value in seeds.items() if value)
            warn_without_effect(notes, stacklevel=3)
        self._integrator = integrator or default_integrator(patient, minute_inputs=bool(self._rhythms[0]))
        fasting = Scenario(
            (),
            setpoint_mg_dl=setpoint_mg_dl,
            initial_glucose_mg_dl=initial_glucose_mg_dl,
            allow_unusual=allow_unusual,
            start_min=start_min,
        )
        self._start_min = None if start_min is None else begins_min
        self.start: Final = start_of(patient, fasting)
        self._meal_model = meal_model_of(patient, meal_model)
        self._takes_exercise = takes_exercise(patient)
        self._bouts = _NO_BOUTS
        refuse_minute_inputs(patient, self._minute_inputs(0))
        self._fasting = absorb(self._meal_model, _NO_MEALS)
        plant, _ = self._integrator.prepare(patient, self._fasting, self._grid)
        pump = LimitedPump(limits=usual_limits(patient)) if pump is None else pump
        self._no_bolus = 0.0 if gives_bolus(pump) else None
        loop = Loop(
            plant=plant,
            controller=ExternalDoses(
                insulin_mU_min=self.start.insulin_mU_min,
                bolus_mU=None if self._no_bolus is None else jnp.asarray(self._no_bolus),
                sample_time_min=sample_time_min,
            ),
            sensor=IdealSensor() if sensor is None else sensor,
            pump=pump,
            setpoint_mg_dl=self.start.setpoint_mg_dl,
            announced_in_min=None if announced_in_min is None else jnp.asarray(announced_in_min, float),
        )
        self._numbers, self._fixed = apart(loop)
        self._of = fingerprint(
            (patient, self._meal_model, loop.sensor, loop.pump, loop.controller, loop.setpoint_mg_dl)
        )
        self._of += f" {self._integrator} {self._start_min}"
        self._of += f" {self._rhythms}" if self._rhythms[0] else ""
        self._of += "" if announced_in_min is None else f" {announced_in_min:g} min"
        self._key = random_key(key)
        self.last: Sampled | None = None
        self.reset()

    @property
    def patient(self) -> Patient:
        """The patient that is stepped."""
        loop: Loop = self._fixed.joined(self._numbers)
        return loop.plant.patient

    @property
    def sample_time_min(self) -> float:
        """Time between two steps."""
        return self._grid.sample_time_min

    @property
    def sample(self) -> int:
        """Number of the coming sample; 0 at the start."""
        return int(self._now.sample)

    @property
    def t_min(self) -> float:
        """Time since the start [min]."""
        return self.sample * self.sample_time_min

    @property
    def glucose_mg_dl(self) -> float:
        """The patient's own glucose, free of noise, which no controller may see."""
        return float(self.patient.glucose_mg_dl(self._now.loop.x))

    @property
    def state(self) -> jax.Array:
        """The patient's state ``(states,)``."""
        return self._now.loop.x

    def reset(self, key: jax.Array | int | None = None) -> Observation:
        """Go back to the start, with other randomness if a key is given, and return the first observation."""
        self._key = self._key if key is None else random_key(key)
        start = self.start
        loop, reading_key = _begin(self._numbers, self._fixed, start.x, start.insulin_mU_min, self._key)
        self._now = _Now(
            loop=loop,
            sample=jnp.asarray(0),
            key=reading_key,
            eaten=jax.tree.map(jnp.asarray, _NO_MEALS),
            meals=jnp.asarray(0),
            gut=self._fasting.state,
        )
        self._bouts = _NO_BOUTS
        self._absorption = self._fasting
        self.last = None
        return self.observation()

    @checked
    def observation(self, announced_carbs_g: float = 0.0) -> Observation:
        """Observation of a controller at the coming sample; repeated calls give the same.

        Parameters
        ----------
        announced_carbs_g : float
            Carbohydrate of which the controller is told [g], of a meal during that sample, or after `announced_in_min`.
        """
        seen: Observation = _look(self._numbers, self._fixed, self._now, announced_carbs_g, self._start_min)
        return seen

    @checked
    def eat(self, carbs_g: float, after_min: float = 0.0, eating_min: float = 0.0) -> None:
        """Begin a meal during the coming sample.

        Parameters
        ----------
        carbs_g : float
            Carbohydrate of the meal [g].
        after_min : float
            Minutes from the beginning of the sample; less than its length.
        eating_min : float
            Duration of eating; 0 for a meal that is eaten at once.

        Raises
        ------
        ValueError
            For a meal that is not possible, or one that begins outside of the sample.
        """
        if not 0.0 <= after_min < self.sample_time_min:
            raise Refusal(
                f"a meal {after_min:g} min into a sample of {self.sample_time_min:g} min is not possible; "
                f"give 0 or more and less than {self.sample_time_min:g}"
            )
        meal = Meal(carbs_g, self.t_min + after_min, eating_min)
        eaten, number = self._now.eaten, int(self._now.meals)
        room = eaten.t_min.size
        if number == room:
            reaching = np.flatnonzero(_last_jumps_min(self._meal_model, eaten) >= self.t_min)
            number = reaching.size  # what other meals did is in the state of the gut
            room *= 2 if 2 * number > room else 1
            eaten = jax.tree.map(lambda part: jnp.zeros(room).at[:number].set(part[reaching]), eaten)
        with_meal = Eaten(**{name: part.at[number].set(getattr(meal, name)) for name, part in vars(eaten).items()})
        self._now = dataclasses.replace(self._now, eaten=with_meal, meals=jnp.asarray(number + 1))
        self._absorption = absorb(self._meal_model, with_meal)

    @checked
    def exercise(self, intensity_pct: float, duration_min: float, after_min: float = 0.0) -> None:
        """Begin a bout of exercise during the coming sample.

        Parameters
        ----------
        intensity_pct : float
            Oxygen uptake above that at rest, in percent of the largest.
        duration_min : float
            Time for which it lasts.
        after_min : float
            Minutes from the beginning of the sample; less than its length.

        Raises
        ------
        ValueError
            For a patient that takes no exercise, or exercise that is not possible or begins outside of the sample.
        """
        refuse_exercise(self.patient)
        if not 0.0 <= after_min < self.sample_time_min:
            raise Refusal(
                f"exercise {after_min:g} min into a sample of {self.sample_time_min:g} min is not possible; "
                f"give 0 or more and less than {self.sample_time_min:g}"
            )
        bout = Exercise(intensity_pct, self.t_min + after_min, duration_min)
        new = np.array([[bout.intensity_pct], [bout.t_min], [bout.duration_min]])
        going_on = self._bouts[:, self._bouts[1] + self._bouts[2] >= self.t_min]
        self._bouts = np.concatenate([going_on, new], axis=1)

    def _minute_inputs(self, sample: int) -> MinuteInputs:
        """Exercise and what rhythms change in a sample, ``(points,)`` each."""
        edges = sample * self.sample_time_min + np.concatenate([[0.0], self._grid.inside_min])
        bouts = Bouts(*self._bouts[..., None]) if self._takes_exercise else None
        rhythms, seed, person = self._rhythms
        minute_inputs = minute_inputs_between(edges, bouts, rhythms, seed, [person], self._grid.start_min)
        return MinuteInputs(**{name: getattr(minute_inputs, name)[..., 0] for name in minute_inputs.names})

    @checked
    def step(self, insulin_mU_min: float, carbs_g: float = 0.0, bolus_mU: float | None = None) -> Observation:
        """Deliver a dose until the next sample, and return what is observed then.

        Parameters
        ----------
        insulin_mU_min : float
            Rate that is commanded [mU/min], any number or NaN; the pump keeps its limits.
        carbs_g : float
            Carbohydrate of a meal that begins with this sample [g]; 0 for none. `eat` is for one that begins within it.
        bolus_mU : float, optional
            Bolus that is asked of the pump beside that rate [mU]; none by default. Anything, also NaN.

        Returns
        -------
        Observation
            Observation at the next sample. `last` holds the events until then: the reading, the decision, the delivery,
            and glucose by the minute.

        Raises
        ------
        ValueError
            For a meal that is not possible, a bolus where the pump can give none, or after a year.
        """
        if bolus_mU is not None and self._no_bolus is None:
            raise Refusal("the pump of this stepper cannot give a bolus; leave it out, or take another pump")
        if self.t_min >= LONGEST_RUN_MIN:
            raise Refusal(f"a run of more than {LONGEST_RUN_MIN:g} min is not possible; reset the stepper")
        if carbs_g != 0.0:
            self.eat(carbs_g)
        self._now, self.last = _step(
            self._numbers,
            self._fixed,
            self._integrator,
            self._grid,
            self._now,
            self._absorption,
            self._minute_inputs(self.sample),
            insulin_mU_min,
            self._no_bolus if bolus_mU is None else bolus_mU,
        )
        return self.observation()

    def save(self) -> bytes:
        """State of the stepper as bytes, for `restore`."""
        return pack((self._now, self._bouts) if self._takes_exercise else self._now, self._of)

    def restore(self, saved: bytes) -> Observation:
        """Continue from the saved state of a stepper with the same patient, sensor and pump, to the same bits.

        The coming observation is returned.

        Raises
        ------
        ValueError
            For bytes that are damaged, of another version, or of a stepper that differs from this one. The stepper
            is then unchanged.
        """
        if self._takes_exercise:
            now, bouts = unpack(saved, (self._now, self._bouts), self._of)
            self._bouts = np.asarray(bouts)
        else:
            now = unpack(saved, self._now, self._of)
        self._now, self._absorption, self.last = now, absorb(self._meal_model, now.eaten), None
        return self.observation()


def _last_jumps_min(model: MealModel, eaten: Eaten) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Time of the last moment at which each meal makes a gut jump, or is eaten."""
    ends: np.ndarray[Any, np.dtype[np.float64]] = np.asarray(
        eaten.t_min + jnp.maximum(eaten.eating_min, SHORTEST_EATING_MIN)
    )
    if isinstance(model, OdeMealModel):
        return ends
    last = jax.vmap(lambda meal: jnp.max(model.jumps(meal).t_min))(jax.tree.map(lambda part: part[:, None], eaten))
    ends = np.maximum(ends, np.asarray(last))
    return ends


Decide = Callable[[int, Observation], Decision]
"""Function of the number of a sample and its observation."""


def scenario_stepper(
    patient: Patient,
    sensor: Sensor,
    pump: Pump,
    scenario: Scenario,
    *,
    sample_time_min: float,
    key: jax.Array | int,
    integrator: SteppingIntegrator | None = None,
) -> Stepper:
    """The patient of a scenario, to be stepped from outside; one who eats against low glucose is refused."""
    if scenario.rescue is not None:
        raise Refusal(
            "a patient who is stepped from outside eats what is given by eat(), and nothing else; "
            "leave the rescue out of the scenario"
        )
    return Stepper(
        patient,
        sensor,
        pump,
        sample_time_min=sample_time_min,
        setpoint_mg_dl=scenario.setpoint_mg_dl,
        initial_glucose_mg_dl=scenario.initial_glucose_mg_dl,
        allow_unusual=scenario.allow_unusual,
        key=key,
        integrator=integrator,
        meal_model=scenario.meal_model,
        start_min=scenario.start_min,
        warm_up_min=scenario.warm_up_min,
        rhythms=scenario.rhythms,
        rhythm_seed=scenario.rhythm_seed,
        rhythm_person=scenario.rhythm_person,
        announced_in_min=scenario.announced_in_min,
    )


def simulate_stepped(stepper: Stepper, scenario: Scenario, decide: Decide, *, gives_boluses: bool = False) -> Trace:
    """Run a scenario with decisions from outside; the trace is that of `simulate` with the same decisions.

    The stepper is at the start of the scenario (see `scenario_stepper`); the numbers of a decision need not be finite,
    and its bolus counts if `gives_boluses` says so.
    """
    counted = sample_grid(scenario.horizon_min, stepper.sample_time_min, scenario.start_min, scenario.warm_up_min)
    grid, meals = counted.whole, scenario.eaten()
    on_grid = on_the_grid(scenario, grid)
    announced = np.asarray(on_grid.announced_g).tolist()
    meals_at = _by_sample(scenario.meals, [float(t_min) for t_min in meals.t_min], grid.sample_time_min)
    begins_min = [bout.t_min + scenario.warm_up_min for bout in scenario.exercise]
    bouts_at = _by_sample(scenario.exercise, begins_min, grid.sample_time_min)
    happened: list[Sampled] = []
    for index in range(grid.samples):
        decision = decide(index, stepper.observation(announced[index]))
        for meal, t_min in meals_at.get(index, ()):
            stepper.eat(meal.carbs_g, max(0.0, t_min - stepper.t_min), meal.eating_min)
        for bout, t_min in bouts_at.get(index, ()):
            stepper.exercise(bout.intensity_pct, bout.duration_min, max(0.0, t_min - stepper.t_min))
        if decision.glucagon_ug is not None:
            raise ArgumentTypeError("a stepper has no route for glucagon; decide on insulin alone, or use simulate")
        bolus = None if decision.bolus_mU is None or not gives_boluses else float(decision.bolus_mU)
        stepper.step(float(decision.insulin_mU_min), bolus_mU=bolus)
        assert stepper.last is not None
        happened.append(_with_status(stepper.last, decision))
    together: Any = jax.tree.map(lambda *each: jnp.asarray(np.stack(each)), *happened)
    trace = trace_of(stepper.patient, stepper.start, on_grid, together, stepper.state)
    if not gives_boluses:
        trace = dataclasses.replace(trace, command_bolus_mU=None, bolus_mU=None, reported_bolus_mU=None)
    minute_inputs = minute_inputs_of(stepper.patient, scenario, grid)
    return with_minute_inputs(trace, scenario, on_grid, minute_inputs).after(counted.warm_up)


def _by_sample(
    events: Sequence[E], begins_min: Iterable[float], sample_time_min: float
) -> dict[int, list[tuple[E, float]]]:
    """Events with their times, by the number of the sample in which they begin."""
    by_sample: dict[int, list[tuple[E, float]]] = {}
    for event, t_min in zip(events, begins_min, strict=True):
        by_sample.setdefault(int(t_min / sample_time_min), []).append((event, t_min))
    return by_sample


def _with_status(happened: Sampled, decision: Decision) -> Sampled:
    finite = happened.decision.status != Status.NO_FINITE_DOSE
    status = jnp.where(finite, decision.status, happened.decision.status)
    return dataclasses.replace(happened, decision=dataclasses.replace(happened.decision, status=status))
