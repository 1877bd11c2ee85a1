"""Controllers of the page as functions whose numbers are inputs, and the models on which the page designs them.

Some settings of a controller belong to its program, at their defaults for the patient, and cannot be changed on the
page: the dead time of IMC, the longest horizon, the states of MPC/SE, what linear MPC keeps of a long response, and
some limits of the guard.
There is one program of PID and of IMC for each route of insulin, and of the predictive controllers for each size of
what they keep of the patient.

Predictive control by a profile solves a program at each sample, some 300 000 operations. Its functions are compiled
from C with loops, whose tables are constants: one pair for each patient model on whose equations it is designed, and
one pair for all patients where it knows none, with the numbers of the person's profile as inputs. The guard of such a
controller is a function of its own, so that no program is there twice: the page steps it once to learn what it shows to
the controller inside, and again with what that decided.
"""

from __future__ import annotations

import dataclasses
import functools
import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, Final

import jax
import jax.numpy as jnp

from glucoloop._pytree import pytree, static
from glucoloop.build.designs import controller_of, nominal_model
from glucoloop.component.routes import INTRAVENOUS, SUBCUTANEOUS
from glucoloop.component.setting import Value
from glucoloop.control import LinearMPC
from glucoloop.control.basal_bolus import BasalBolus
from glucoloop.control.catalogue import CONTROLLERS
from glucoloop.control.guard import Guard, guarded
from glucoloop.control.guard_settings import GuardSettings, guard_of
from glucoloop.control.horizon import identified_response, least_horizon, linear_response
from glucoloop.control.imc import design_imc
from glucoloop.control.mpc_se import MPCSE
from glucoloop.control.pid import PIDTuning, design_pid
from glucoloop.control.profile_mpc import ProfileMPC
from glucoloop.control.protocol import Controller, Decision, Observation, gives_boluses
from glucoloop.lab.device_functions import MONITORS
from glucoloop.lab.lowered_function import PageFunction, names_of, page_function, start_function
from glucoloop.lab.patient_functions import SAMPLE_TIME_MIN, patients, situation
from glucoloop.native.targets.c.source import trace, write_source
from glucoloop.native.targets.wasm import CFunction
from glucoloop.patients.catalogue import PATIENTS
from glucoloop.pumps.limits import PARKER_1999_LIMITS, DoseLimits
from glucoloop.refusal import Refusal
from glucoloop.simulation import linear_model
from glucoloop.situations.case import default_case
from glucoloop.therapy import Profile

_CONTROLLERS: Final = ("pid", "imc", "mpc", "mpc-se")
"""Controllers of all patients."""
_BY_PROFILE: Final = ("basal-bolus",)
"""Controllers that dose by the person's profile and give boluses: of patients with subcutaneous insulin."""
LOOPED: Final = {
    "profile-mpc": ("hovorka-2004", "uva-padova-2008", "kanderian-2009"),
    "therapy-mpc": ("hovorka-2004", "wilinska-2010", "uva-padova-2008", "kanderian-2009"),
}
"""Controllers whose programs keep their loops, of which each is 20 kB of the page, with the families that have one."""
_LONGEST_HORIZON: Final = {INTRAVENOUS: 24, SUBCUTANEOUS: 48}
"""Samples that a predictive controller of the page can look ahead, by the route of insulin, or more where a patient
needs it: see `longest_horizon`. Shorter horizons are padded without weight.
"""
_HORIZON_STEP: Final = 24
"""Longest horizons are multiples of it."""
_PREDICTIVE: Final = ("mpc", "mpc-se")
_FIXED_LIMITS: Final = ("on_board_tau_min", "doubt_tau_min", "profile_span")
"""Limits of the guard from which it computes tables when it is made, so that they are part of its program."""
_FREE_LIMITS: Final = tuple(name for name in GuardSettings.settings() if name not in _FIXED_LIMITS)


def controllers_of(family: str) -> tuple[str, ...]:
    """Controllers that the page has for the patients of a family."""
    by_profile = _BY_PROFILE if PATIENTS.find(family).insulin_route == SUBCUTANEOUS else ()
    return (*_CONTROLLERS, *by_profile, *(name for name, families in LOOPED.items() if family in families))


def default_tuning(name: str, family: str, operating_point: str, *sensor: str) -> dict[str, Value]:
    """Default settings of a controller for a patient of the page, and for a sensor where one is named.

    A horizon that suits the model is that of the model which the page has.
    """
    tuning = dict(default_case(name, situation(family, operating_point, *sensor)).tuning)
    if horizon_suits_model(name, family):
        exact = [of for of in sensor if of != "white-noise"]  # the page's models are free of noise
        at_point = situation(family, operating_point, *exact)
        designed: Any = controller_of(at_point, default_case(name, at_point))
        _, tuning["prediction_horizon"] = designed.horizons
    return tuning


@functools.cache
def horizon_suits_model(name: str, family: str) -> bool:
    """Whether the default horizon of a controller for a family is the one that suits the model."""
    tuning = default_case(name, situation(family, next(iter(patients(family))))).tuning
    return dict(tuning).get("prediction_horizon") == 0


@functools.cache
def longest_horizon(family: str) -> int:
    """Samples that a predictive controller of the page can look ahead for a family, at least its default."""
    horizons = [
        int(default_tuning(name, family, point, *sensor)["prediction_horizon"])
        for name in _PREDICTIVE
        for point in patients(family)
        for sensor in ((), MONITORS[:1])
    ]
    return max(
        _LONGEST_HORIZON[PATIENTS.find(family).insulin_route], _HORIZON_STEP * math.ceil(max(horizons) / _HORIZON_STEP)
    )


@functools.cache
def default_mpc(family: str, operating_point: str, *sensor: str) -> LinearMPC:
    """Linear MPC of a patient, on the model that is identified without noise, with room for the longest horizon."""
    result: LinearMPC = _with_room("mpc", family, operating_point, *sensor)
    return result


@functools.cache
def default_mpc_se(family: str, operating_point: str) -> MPCSE:
    """MPC/SE of a patient, with room for the longest horizon."""
    result: MPCSE = _with_room("mpc-se", family, operating_point)
    return result


def shortest_horizon(name: str, family: str, *sensor: str) -> int:
    """Minimum horizon that a predictive controller accepts for every patient of a family."""

    def of_patient(operating_point: str) -> int:
        if name == "mpc-se":
            response = linear_response(linear_model(patients(family)[operating_point]))
        else:
            at_point = situation(family, operating_point, *sensor)
            response = identified_response(nominal_model(at_point, default_case(name, at_point)).model)
        return least_horizon(*response) or longest_horizon(family)

    return max(map(of_patient, patients(family)))


def _with_room(name: str, family: str, operating_point: str, *sensor: str) -> Any:
    at_point = situation(family, operating_point, *sensor)
    controller: Any = controller_of(at_point, default_case(name, at_point))
    moves, _ = controller.horizons
    return controller.padded(moves, longest_horizon(family))


@functools.cache
def looped_controller(name: str, family: str, operating_point: str) -> ProfileMPC:
    """A predictive controller by a profile, for the nominal person at an operating point."""
    at_point = situation(family, operating_point)
    designed = controller_of(at_point, default_case(name, at_point))
    if not isinstance(designed, ProfileMPC):
        raise Refusal(f"the predictive controller by a profile of {family} is {type(designed).__name__}")
    return designed


def of_profile(name: str, family: str, operating_point: str) -> dict[str, float]:
    """Numbers of the model of a controller that follow from the profile, where it knows no equations of the patient."""
    if CONTROLLERS[name].on_equations:
        return {}
    model = looped_controller(name, family, operating_point).model
    return {f"model.{number}": float(getattr(model, number)) for number in _OF_PROFILE}


@functools.cache
def _example_controller(name: str, family: str) -> Controller:
    """A controller of a kind for the patients of a family."""
    point = next(iter(patients(family)))
    if name == "basal-bolus":
        profile = Profile(basal_mU_min=10.0, setpoint_mg_dl=110.0)
        return BasalBolus(carb_ratio_g_U=10.0, correction_mg_dl_U=40.0).of_person(profile)
    if name in LOOPED:
        return looped_controller(name, family, point)
    if name == "pid":
        return design_pid(PIDTuning(1.0, 60.0, 1.0), PARKER_1999_LIMITS)
    if name == "imc":
        delay_min = float(default_tuning("imc", family, point)["delay_min"])
        return design_imc(-3.0, 80.0, delay_min, PARKER_1999_LIMITS, sample_time_min=SAMPLE_TIME_MIN)
    return default_mpc(family, point) if name == "mpc" else default_mpc_se(family, point)


def program_of(name: str, family: str) -> str:
    """Name of the functions of a controller, which patients with insulin by one route share.

    Linear MPC has one for each number of coefficients that it keeps, MPC/SE for each horizon and number of states, and
    a controller on the equations of the patient one for each family.
    """
    example: Any = _example_controller(name, family)
    if name in LOOPED and example.on_equations:
        return "_".join([re.sub(r"\W", "_", family), name.replace("-", "_")])
    sizes = {"mpc": "step_response", "mpc-se": "free_state"}
    size = getattr(example, sizes[name]).shape if name in sizes else ()
    return "_".join([PATIENTS.find(family).insulin_route, name.replace("-", "_"), *map(str, size)])


def guard_program_of(family: str) -> str:
    """Name of the functions of the guard around a controller that keeps its loops."""
    return f"{PATIENTS.find(family).insulin_route}_guard"


class _FreeLimits:
    """Limits of a guard that are inputs of the program, beside those that are not; stands for `GuardSettings`."""

    def __init__(self, free: dict[str, Any], fixed: GuardSettings) -> None:
        for name in _FIXED_LIMITS:
            setattr(self, name, getattr(fixed, name))
        for name, value in free.items():
            setattr(self, name, value)


@dataclass(frozen=True)
class Adjustable:
    """A controller whose numbers are inputs of a program, the limits of a guard among them."""

    example: Controller

    @property
    def numbers(self) -> dict[str, Any]:
        """Example of the numbers."""
        limits = dict.fromkeys(_FREE_LIMITS, jnp.zeros(())) if isinstance(self.example, Guard) else {}
        return {"controller": jax.tree.map(jnp.asarray, self.example), "guard": limits}

    def of(self, numbers: dict[str, Any]) -> Any:
        """The controller with other numbers; the guard's limits are no part of its tree."""
        controller = numbers["controller"]
        if not isinstance(controller, Guard):
            return controller
        limits: Any = _FreeLimits(numbers["guard"], controller.settings)
        return dataclasses.replace(controller, settings=limits)


def adjustable(name: str, family: str, *, guard: bool) -> Adjustable:
    """A controller of the page for the patients of a family, in a guard with their default limits or not."""
    bare = _example_controller(name, family)
    if not guard:
        return Adjustable(bare)
    return Adjustable(guarded(bare, guard_of(PATIENTS.find(family)), PARKER_1999_LIMITS))


def _example_observation(*, boluses: bool) -> Observation:
    """Observation as the page shows it to a controller."""
    zero = jnp.zeros(())
    return Observation(
        glucose_mg_dl=zero,
        valid=jnp.asarray(True),
        setpoint_mg_dl=zero,
        delivered_mU_min=zero,
        announced_carbs_g=zero,
        delivered_bolus_mU=zero if boluses else None,
        announced_in_min=zero if boluses else None,
    )


def _outputs_of(decision: Decision) -> dict[str, jax.Array]:
    """Decision as the functions of the page give it."""
    boluses = {} if decision.bolus_mU is None else {"bolus_mU": decision.bolus_mU}
    return {"insulin_mU_min": decision.insulin_mU_min, "status": decision.status, **boluses}


def controller_functions(adjusted: Adjustable) -> dict[str, PageFunction]:
    """The two functions of a controller: its state at the start, and its step."""
    observation = _example_observation(boluses=gives_boluses(adjusted.example))

    def init(person: Any, own: Any, rng: Any) -> Any:
        del rng
        return adjusted.of(person).init(own)

    def step(person: Any, carry: Any, own: Any, shared: Any, rng: Any) -> tuple[Any, Any]:
        del shared, rng
        state, decision = adjusted.of(person).step(carry, own)
        return state, _outputs_of(decision)

    person = adjusted.numbers
    state = jax.eval_shape(lambda: adjusted.of(person).init(observation))
    return {"start": start_function(init, person, observation), "step": page_function(step, person, state, observation)}


_OF_COSTS: Final = {"low_weight": "below", "floor_weight": "floor"}
_OF_FILTER: Final = ("measurement_variance", "sensor_error_mg_dl")
_OF_PROFILE: Final = ("basal_mU_min", "insulin_gain", "meal_gain", "own_correction_mg_dl_U")
_OWN: Final = ("doubt", "disturbance_doubt", "move_weight", "bolus_weight")


def looped_functions(name: str, family: str) -> dict[str, PageFunction]:
    """The two functions of predictive control by a profile for the patients of a family."""
    point = next(iter(patients(family)))
    designed = looped_controller(name, family, point)
    zero = jnp.zeros(())
    limits = DoseLimits(max_change_mU_min=zero, min_mU_min=zero, max_mU_min=zero)
    free = {name: zero for name in (*_OF_COSTS, *_OF_FILTER, *_OWN)}
    model = {"model": dict.fromkeys(_OF_PROFILE, zero)} if of_profile(name, family, point) else {}

    def controller(person: Any) -> ProfileMPC:
        numbers = person["controller"]
        return designed.replaced(
            model=dataclasses.replace(designed.model, **numbers.get("model", {})),
            costs=dataclasses.replace(designed.costs, **{of: numbers[name] for name, of in _OF_COSTS.items()}),
            filter=dataclasses.replace(designed.filter, **{name: numbers[name] for name in _OF_FILTER}),
            limits=numbers["limits"],
            **{name: numbers[name] for name in _OWN},
        )

    def step(person: Any, state: Any, own: Any) -> tuple[Any, Any]:
        after, decision = controller(person).step(state, own)
        return after, _outputs_of(decision)

    return _c_functions(
        f"{name} of {family}" if not model else name,
        lambda person, own: controller(person).init(own),
        step,
        {"controller": {**free, **model, "limits": limits}},
        _example_observation(boluses=True),
    )


@pytree
class _Elsewhere:
    """A controller that decides elsewhere, and keeps what it is shown."""

    decision: Decision
    sample_time_min: float = static()
    gives_boluses: ClassVar[bool] = True
    heals: ClassVar[bool] = True
    """True, since the page takes no others, and what this one keeps is replaced at each step."""

    def init(self, observation: Observation) -> Observation:
        """State: the observation."""
        return observation

    def step(self, state: Observation, observation: Observation) -> tuple[Observation, Decision]:
        """Keep the observation, and decide what was decided."""
        del state
        return observation, self.decision


def guard_functions(family: str) -> dict[str, PageFunction]:
    """The two functions of the guard around a controller that decides elsewhere, for the route of a family."""
    zero = jnp.zeros(())
    nothing = Decision(insulin_mU_min=zero, status=jnp.zeros((), int), bolus_mU=zero)
    elsewhere = _Elsewhere(decision=nothing, sample_time_min=SAMPLE_TIME_MIN)
    around = Adjustable(guarded(elsewhere, guard_of(PATIENTS.find(family)), PARKER_1999_LIMITS))
    person = around.numbers
    numbers = {**person, "controller": dataclasses.replace(person["controller"], inner=None)}
    own = {"observation": _example_observation(boluses=True), "decision": nothing}

    def guard(person: Any, decision: Decision) -> Any:
        inner = dataclasses.replace(elsewhere, decision=decision)
        return around.of({**person, "controller": dataclasses.replace(person["controller"], inner=inner)})

    def init(person: Any, own: Any, rng: Any) -> Any:
        del rng
        return guard(person, nothing).init(own)

    def step(person: Any, carry: Any, own: Any, shared: Any, rng: Any) -> tuple[Any, Any]:
        del shared, rng
        state, decision = guard(person, own["decision"]).step(carry, own["observation"])
        return state, _outputs_of(decision)

    state = jax.eval_shape(lambda: init(numbers, own["observation"], jax.random.key(0)))
    return {
        "start": start_function(init, numbers, own["observation"]),
        "step": page_function(step, numbers, state, own),
    }


def _c_functions(
    title: str,
    init: Callable[[Any, Any], Any],
    step: Callable[[Any, Any, Any], tuple[Any, Any]],
    person: Any,
    own: Any,
) -> dict[str, PageFunction]:
    """Two functions of a controller that keep their loops: its state at the start, and its step.

    The functions are called with the numbers of the person, the state, and the person's own at a sample.
    """
    precision = "float64"
    traced = trace(
        lambda observation: init(observation["person"], observation["own"]),
        lambda state, observation: step(observation["person"], state, observation["own"]),
        {"own": own, "person": person},
        precision,
    )
    source = write_source(traced, [title], "compact")

    def init_step(person: Any, carry: Any, own: Any, shared: Any, rng: Any) -> tuple[Any, Any]:
        del shared, rng
        return carry, init(person, own)

    def stepping(person: Any, carry: Any, own: Any, shared: Any, rng: Any) -> tuple[Any, Any]:
        del shared, rng
        return step(person, carry, own)

    state = traced.state
    outer = {"person": names_of(person), "own": names_of(own), "shared": {}}
    return {
        "start": PageFunction(
            init_step, CFunction(source, is_init=True), {**outer, "carry": {}, "outputs": names_of(state)}
        ),
        "step": PageFunction(
            stepping,
            CFunction(source, is_init=False),
            {**outer, "carry": names_of(state), "outputs": names_of(traced.decision)},
        ),
    }
