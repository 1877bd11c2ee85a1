"""Functions of one sample of the loop, lowered one by one, so that all controllers share one plant.

A sample is `simulation.loop.sample` taken apart: the sensor's noise, the controller, and the pump with the patient.
Dead time is a line of readings, which the page keeps. What a person can change on the page is an input of a function,
and not part of it: the numbers of the patients, the limits of the pump, the noise, the meals, and the controllers with
all that their designs compute. So are the matrices of the integrator, so that the module depends on formulas alone and
not on how a library rounded.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import jax
import jax.numpy as jnp
import numpy as np

from glucoloop._pytree import pytree, static
from glucoloop.control import Controller
from glucoloop.control.guard import guarded
from glucoloop.control.imc import design_imc
from glucoloop.control.pid import PIDTuning, design_pid
from glucoloop.control.protocol import Decision, Observation, Status
from glucoloop.experiments.case import usual_case
from glucoloop.experiments.designs import controller_of
from glucoloop.experiments.situation import Situation
from glucoloop.meals.absorption import Absorption, appearance_moments, fasting
from glucoloop.meals.models import meal_model_of
from glucoloop.meals.protocol import Eaten
from glucoloop.native.lower import Lowered, lower
from glucoloop.patients import SemilinearPatient
from glucoloop.pumps import LimitedPump
from glucoloop.registry.patients import USUAL_PATIENT
from glucoloop.sensors import IdealSensor, white_noise
from glucoloop.simulation.exponential import Exponential, ExponentialPlant, Matrices
from glucoloop.simulation.loop import Loop, LoopState, sample
from glucoloop.simulation.people_plant import chosen, replaced, varying
from glucoloop.simulation.plant import SampleGrid

PATIENT: Final = USUAL_PATIENT.name
SAMPLE_TIME_MIN: Final = 5.0
GRID: Final = SampleGrid(sample_time_min=SAMPLE_TIME_MIN, samples=1)
LONGEST_HORIZON: Final = 24
"""Samples that a predictive controller of the page can look ahead; shorter horizons are padded without weight."""
CONTROLLERS: Final = ("pid", "imc", "mpc", "mpc-se")
GUARDED: Final = "_guarded"


def situation(operating_point: str) -> Situation:
    """Situation of a patient of the page, with noise-free readings and the usual pump."""
    return Situation(patient=PATIENT, operating_point=operating_point, sample_time_min=SAMPLE_TIME_MIN)


def patients() -> dict[str, SemilinearPatient]:
    """Patients of the page by operating point."""
    return {point.name: situation(point.name).nominal for point in USUAL_PATIENT.operating_points}


def together(people: Sequence[Any]) -> Any:
    """Trees of people as one tree: leaves that differ have a trailing axis, the others stay as they are."""
    leaves = zip(*(jax.tree.leaves(person) for person in people), strict=True)
    joined = [
        each[0] if all(np.array_equal(each[0], other) for other in each[1:]) else jnp.stack(list(each), axis=-1)
        for each in leaves
    ]
    return jax.tree.unflatten(jax.tree.structure(people[0]), joined)


@functools.cache
def plants() -> dict[str, ExponentialPlant]:
    """Patients of the page with the integrator of `glucoloop run`, by operating point."""
    found = {}
    for name, patient in patients().items():
        plant, _ = Exponential().prepare(patient, fasting(meal_model_of(patient, None)), GRID)
        found[name] = plant
    return found


def _patients_vary() -> list[bool]:
    """Whether each leaf of a patient differs between the patients of the page."""
    nominal, *others = patients().values()
    return varying(together([nominal, *others]), nominal)


def _places(matrices: Sequence[Matrices]) -> list[np.ndarray[Any, np.dtype[np.int64]] | None]:
    """Places of each matrix that are not zero in all patients; None for what holds no real numbers."""
    found: list[np.ndarray[Any, np.dtype[np.int64]] | None] = []
    for leaves in zip(*map(jax.tree.leaves, matrices), strict=True):
        each = [np.ravel(np.asarray(leaf)) for leaf in leaves]
        found.append(np.flatnonzero(np.any(each, axis=0)) if each[0].dtype == float else None)
    return found


def plant_numbers(operating_point: str) -> dict[str, list[float]]:
    """Numbers of a patient and of the integrator's matrices, as the plant takes them: what is always zero is left out.

    A zero that is known costs nothing.
    """
    of_all = plants()
    plant, places = of_all[operating_point], _places([of.matrices for of in of_all.values()])
    leaves = zip(jax.tree.leaves(plant.matrices), places, strict=True)
    kept = [np.ravel(np.asarray(leaf))[own] for leaf, own in leaves if own is not None]
    patient = chosen(plant.patient, _patients_vary())
    return {"numbers": [float(leaf) for leaf in patient], "matrices": np.concatenate(kept).tolist()}


def _filled(matrices: Matrices, places: Sequence[Any], numbers: jax.Array) -> Matrices:
    """Matrices with other numbers in the places that are not zero."""
    leaves, structure = jax.tree.flatten(matrices)
    new, start = [], 0
    for leaf, own in zip(leaves, places, strict=True):
        if own is None:
            new.append(leaf)
            continue
        flat = jnp.zeros(leaf.size).at[own].set(numbers[start : start + own.size])
        new.append(flat.reshape(leaf.shape))
        start += own.size
    filled: Matrices = jax.tree.unflatten(structure, new)
    return filled


@dataclass(frozen=True)
class Part:
    """A lowered function with the names of its inputs and outputs."""

    lowered: Lowered
    names: Mapping[str, Mapping[str, int]]
    """Name -> number of numbers, in their order, of each group; see `glucoloop.native.lower.Layout`."""


def part(step: Callable[..., Any], person: Any, carry: Any, own: Any, shared: Any = ()) -> Part:
    """Lower a function, and name what it takes and gives by the places in its trees; drawn numbers come last in own."""
    lowered = lower(step, person, carry, own, shared, jax.random.key(0))
    shapes = lowered.shapes
    groups = {"person": shapes.person, "carry": shapes.carry, "own": shapes.own, "shared": shapes.shared}
    names = {name: _names(tree) for name, tree in {**groups, "outputs": shapes.outputs}.items()}
    drawn = lowered.layout.sizes["own"] - sum(names["own"].values())
    if drawn:
        names["own"]["drawn"] = drawn
    return Part(lowered=lowered, names=names)


def _names(tree: Any) -> dict[str, int]:
    found = jax.tree_util.tree_leaves_with_path(tree)
    return {jax.tree_util.keystr(path, simple=True, separator="."): int(leaf.size) for path, leaf in found}


@pytree
class _Commanded:
    """A controller that asks for the dose in its state, so that the plant is a loop without one."""

    sample_time_min: float = static(default=SAMPLE_TIME_MIN)

    def init(self, observation: Observation) -> Any:
        return observation.delivered_mU_min

    def step(self, state: Any, observation: Observation) -> tuple[Any, Decision]:
        del observation
        return state, Decision(insulin_mU_min=state, status=jnp.asarray(int(Status.OK)))


def plant_part() -> Part:
    """Pump and patient for one sample: from a command to the state at the next sample."""
    of_all, varies, zero = plants(), _patients_vary(), jnp.zeros(())
    first, plant = next(iter(of_all.items()))
    places = _places([of.matrices for of in of_all.values()])

    def step(person: Any, carry: Any, own: Any, shared: Any, rng: Any) -> tuple[Any, Any]:
        patient = replaced(plant.patient, varies, person["patient"])
        loop = Loop(
            plant=ExponentialPlant(patient=patient, matrices=_filled(plant.matrices, places, person["matrices"])),
            controller=_Commanded(),
            sensor=IdealSensor(),
            pump=LimitedPump(limits=person["limits"]),
            setpoint_mg_dl=zero,
        )
        state = LoopState(
            x=carry["x"],
            reported_mU_min=zero,
            in_sensor=(),
            in_controller=own["command_mU_min"],
            in_pump=carry["delivered_mU_min"],
        )
        after, happened = sample(loop, state, own["moments"], zero, rng, jnp.zeros((), int))
        next_carry = {"x": after.x, "delivered_mU_min": after.in_pump}
        return next_carry, {
            "glucose_mg_dl": loop.plant.patient.glucose_mg_dl(after.x),
            "inside_mg_dl": happened.inside_mg_dl,
            "delivered_mU_min": happened.delivery.insulin_mU_min,
            "reported_mU_min": happened.delivery.reported_mU_min,
        }

    person = {
        "patient": chosen(plant.patient, varies),
        "matrices": jnp.zeros(len(plant_numbers(first)["matrices"])),
        "limits": situation(first).limits,
    }
    x = plant.patient.steady_state(plant.patient.basal_insulin_mU_min)
    own = {"command_mU_min": zero, "moments": jnp.zeros((1, 3))}
    return part(step, person, {"x": x, "delivered_mU_min": zero}, own)


def meal_part() -> Part:
    """Moments of one meal over a sample, as the plant takes them; meals are added up."""
    gut = meal_model_of(next(iter(patients().values())), None)

    def step(person: Any, carry: Any, own: Any, shared: Any, rng: Any) -> tuple[Any, Any]:
        del own, rng
        absorption = Absorption(model=gut, jumps=gut.jumps(jax.tree.map(lambda number: number[None], person)))
        return carry, appearance_moments(shared, SAMPLE_TIME_MIN, absorption)

    zero = jnp.zeros(())
    return part(step, Eaten(t_min=zero, carbs_g=zero, eating_min=zero), (), (), zero)


def noise_part() -> Part:
    """The reading of glucose with bounded white noise, from a normal number that was drawn before."""

    def step(person: Any, carry: Any, own: Any, shared: Any, rng: Any) -> tuple[Any, Any]:
        sensor = white_noise(person["variance"], person["bound_mg_dl"])
        _, reading = sensor.read((), own, rng)
        return carry, reading.glucose_mg_dl

    zero = jnp.zeros(())
    return part(step, {"variance": zero, "bound_mg_dl": zero}, (), zero)


def normals(seed: int, samples: int) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Normal numbers of the readings of a run with a seed, in the order in which `noise_part` takes them."""
    from glucoloop.arguments import random_key

    drawing = noise_part().lowered.drawing
    _, reading_key = jax.random.split(random_key(seed))
    keys = jax.vmap(lambda index: jax.random.fold_in(reading_key, index))(jnp.arange(samples))
    [drawn] = jax.vmap(drawing)(keys)
    return np.asarray(drawn).reshape(samples)


def example_controller(name: str) -> Controller:
    """A controller of a kind, with room for the longest horizon of the page."""
    if name == "pid":
        return design_pid(PIDTuning(1.0, 60.0, 1.0), situation("setpoint-81").limits)
    if name == "imc":
        return design_imc(-3.0, 80.0, SAMPLE_TIME_MIN, situation("setpoint-81").limits)
    around = situation("setpoint-81")
    controller: Any = controller_of(around, usual_case(name, around))
    moves, _ = controller.horizons
    padded: Controller = controller.padded(moves, LONGEST_HORIZON)
    return padded


def controller_parts(controller: Controller) -> dict[str, Part]:
    """The two functions of a controller: its state at the start, and its step."""
    zero = jnp.zeros(())
    observation = Observation(
        glucose_mg_dl=zero,
        valid=jnp.asarray(True),
        setpoint_mg_dl=zero,
        delivered_mU_min=zero,
        announced_carbs_g=zero,
    )

    def start(person: Any, carry: Any, own: Any, shared: Any, rng: Any) -> tuple[Any, Any]:
        del shared, rng
        return carry, person.init(own)

    def step(person: Any, carry: Any, own: Any, shared: Any, rng: Any) -> tuple[Any, Any]:
        del shared, rng
        state, decision = person.step(carry, own)
        return state, {"insulin_mU_min": decision.insulin_mU_min, "status": decision.status}

    numbers = jax.tree.map(jnp.asarray, controller)
    state = jax.eval_shape(lambda person: person.init(observation), numbers)
    return {"start": part(start, numbers, (), observation), "step": part(step, numbers, state, observation)}


def parts() -> dict[str, Part]:
    """All functions of the page, by the name under which the module exports them."""
    found = {"plant": plant_part(), "meal": meal_part(), "noise": noise_part()}
    for name in CONTROLLERS:
        bare = example_controller(name)
        limits = situation("setpoint-81").limits
        for suffix, controller in (("", bare), (GUARDED, guarded(bare, None, limits))):
            for what, of in controller_parts(controller).items():
                found[f"{name.replace('-', '_')}{suffix}_{what}"] = of
    return found
