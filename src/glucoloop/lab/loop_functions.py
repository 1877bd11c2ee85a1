"""Controllers of the page whose programs keep their loops, and the guard around one that is computed elsewhere.

Predictive control by a profile makes and solves a program at each sample, some 300 000 operations. Its functions are
compiled from C with loops, one pair for each family, in which the tables of the model are constants. The guard of such
a controller is a function of its own, so that no program is there twice: the page steps it once to learn what it shows
to the controller inside, and again with what that decided.
"""

from __future__ import annotations

import dataclasses
from typing import Any, ClassVar, Final

import jax
import jax.numpy as jnp

from glucoloop._pytree import pytree, static
from glucoloop.control.guard import guarded
from glucoloop.control.guard_settings import guard_of
from glucoloop.control.profile_mpc import ProfileMPC
from glucoloop.control.protocol import Decision, Observation
from glucoloop.lab.controllers import Adjustable, example_controller, example_observation, outputs_of
from glucoloop.lab.lowered_function import PageFunction, c_functions, page_function, start_function
from glucoloop.lab.patient_functions import SAMPLE_TIME_MIN
from glucoloop.patients.settings import PATIENTS
from glucoloop.pumps.limits import PARKER_1999_LIMITS, DoseLimits
from glucoloop.refusal import Refusal

_OF_COSTS: Final = {"low_weight": "below", "floor_weight": "floor"}
_OF_FILTER: Final = ("measurement_variance", "sensor_error_mg_dl")
_OWN: Final = ("doubt", "disturbance_doubt", "move_weight", "bolus_weight")


def looped_functions(family: str) -> dict[str, PageFunction]:
    """The two functions of predictive control by a profile for the patients of a family."""
    designed = example_controller("profile-mpc", family)
    if not isinstance(designed, ProfileMPC):
        raise Refusal(f"the predictive controller by a profile of {family} is {type(designed).__name__}")
    zero = jnp.zeros(())
    limits = DoseLimits(max_change_mU_min=zero, min_mU_min=zero, max_mU_min=zero)
    free = {name: zero for name in (*_OF_COSTS, *_OF_FILTER, *_OWN)}

    def controller(person: Any) -> ProfileMPC:
        numbers = person["controller"]
        return dataclasses.replace(
            designed,
            costs=dataclasses.replace(designed.costs, **{of: numbers[name] for name, of in _OF_COSTS.items()}),
            filter=dataclasses.replace(designed.filter, **{name: numbers[name] for name in _OF_FILTER}),
            limits=numbers["limits"],
            **{name: numbers[name] for name in _OWN},
        )

    def step(person: Any, state: Any, own: Any) -> tuple[Any, Any]:
        after, decision = controller(person).step(state, own)
        return after, outputs_of(decision)

    return c_functions(
        f"profile-mpc of {family}",
        lambda person, own: controller(person).init(own),
        step,
        {"controller": {**free, "limits": limits}},
        example_observation(boluses=True),
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
    own = {"observation": example_observation(boluses=True), "decision": nothing}

    def guard(person: Any, decision: Decision) -> Any:
        inner = dataclasses.replace(elsewhere, decision=decision)
        return around.of({**person, "controller": dataclasses.replace(person["controller"], inner=inner)})

    def init(person: Any, own: Any, rng: Any) -> Any:
        del rng
        return guard(person, nothing).init(own)

    def step(person: Any, carry: Any, own: Any, shared: Any, rng: Any) -> tuple[Any, Any]:
        del shared, rng
        state, decision = guard(person, own["decision"]).step(carry, own["observation"])
        return state, outputs_of(decision)

    state = jax.eval_shape(lambda: init(numbers, own["observation"], jax.random.key(0)))
    return {
        "start": start_function(init, numbers, own["observation"]),
        "step": page_function(step, numbers, state, own),
    }
