"""Actions: what a person does by hand or tells a controller in a run, each one class around the controller.

An action joins every command that has meals by one class, entered in `ACTIONS` or by the entry point of another package
in the group ``glucoloop.actions``. It is put inside the guard, if there is one, so that a bolus by hand passes the
guard as any other does.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Annotated, Any, ClassVar, Final

from glucoloop._lazy_jax import jax, jnp
from glucoloop._pytree import pytree
from glucoloop.component.catalogue import Catalogue
from glucoloop.component.effects import BOLUSES, CORRECTION, PROFILE, READINGS, TEMPORARY_TARGETS, Need
from glucoloop.component.pytree_component import HOST, derived, wired
from glucoloop.component.setting import About
from glucoloop.control.around import ControllerAround
from glucoloop.control.decision import is_known
from glucoloop.control.protocol import Decision, DoseForecast, Observation, forecast_of, gives_boluses
from glucoloop.unit_guess import GLUCOSE_BOUND
from glucoloop.units import LONGEST_RUN_MIN, MU_PER_U

_LONG_MIN: Final = 5e5
"""Time from which on no action begins, which a clock of a run does not pass; within the guard's bound on memories."""


@pytree
class _ActionState:
    """State of the inner controller, the time of the coming sample, and insulin by hand at the last one."""

    inner: Any
    t_min: jax.Array
    given_mU: jax.Array


class ActionComponent(ControllerAround):
    """Declaration of an action: a controller around another one, with what the person does or tells.

    One that tells something has the method `tell`, and one that stops boluses `confirms`; one that gives insulin has
    `give`, and says so by `doses`.
    """

    kind: ClassVar = "action"
    doses: ClassVar[bool] = False
    """Whether it gives boluses."""

    warm_up_min: float = wired(HOST, default=0.0)
    """Time before minute 0 of the settings."""

    @property
    def gives_boluses(self) -> bool:
        """Whether it or the inner controller gives boluses."""
        return self.doses or super().gives_boluses

    def uses(self) -> frozenset[Need]:
        """Needs that the action meets by itself."""
        return frozenset({READINGS, PROFILE, CORRECTION, BOLUSES} if self.doses else ())

    @derived
    def first_min(self) -> float:
        """Time of the first sample."""
        return -self.warm_up_min

    def init(self, observation: Observation) -> _ActionState:
        """State before the first sample, without insulin by hand."""
        zero = jnp.zeros_like(observation.delivered_mU_min)
        inner = self.inner.init(self._for_inner(zero + self.first_min, zero, observation))
        return _ActionState(inner=inner, t_min=zero + self.first_min, given_mU=zero)

    def step(self, state: _ActionState, observation: Observation) -> tuple[_ActionState, Decision]:
        """Tell the inner controller what is told, let it decide, and add what is given by hand."""
        inner, decision = self.inner.step(state.inner, self._for_inner(state.t_min, state.given_mU, observation))
        given, bolus = state.given_mU, decision.bolus_mU
        if bolus is not None:
            bolus = jnp.where(self.confirms(state.t_min), bolus, 0.0)
        if self.doses:
            given = self.give(state.t_min, observation)
            bolus = given if bolus is None else bolus + given
        decision = dataclasses.replace(decision, bolus_mU=bolus)
        t_min = jnp.minimum(state.t_min + self.sample_time_min, _LONG_MIN)
        return _ActionState(inner=inner, t_min=t_min, given_mU=given), decision

    def forecast(self, state: _ActionState, observation: Observation) -> DoseForecast | None:
        """Forecast of the inner controller, which knows of no bolus to come by hand."""
        return forecast_of(self.inner, state.inner, self._for_inner(state.t_min, state.given_mU, observation))

    def _for_inner(self, t_min: jax.Array, given_mU: jax.Array, observation: Observation) -> Observation:
        """Observation of the inner controller; one without boluses is told of those by hand as of a rate."""
        observation = self.tell(t_min, given_mU, observation)
        bolus = observation.delivered_bolus_mU
        if bolus is None or gives_boluses(self.inner):
            return observation
        rate = observation.delivered_mU_min + jnp.where(jnp.isfinite(bolus), bolus, 0.0) / self.sample_time_min
        return dataclasses.replace(observation, delivered_mU_min=rate, delivered_bolus_mU=None)

    def tell(self, t_min: jax.Array, given_mU: jax.Array, observation: Observation) -> Observation:
        """Observation with what the person tells at a time; `given_mU` was given by hand at the last sample."""
        return observation

    def give(self, t_min: jax.Array, observation: Observation) -> jax.Array:
        """Bolus [mU] that the person gives by hand at a time."""
        raise NotImplementedError

    def confirms(self, t_min: jax.Array) -> jax.Array | bool:
        """Whether the person lets the boluses of the controller be given at a time."""
        return True


class HandBolus(ActionComponent, name="bolus"):
    """Bolus by hand with the pump, by the correction factor of the person's profile: ``(G - target) / CF``.

    It is given once, if the reading is above a bound then. Insulin on board is not taken off, as by a person who does
    not trust what the pump counts. The pump reports it together with the boluses of the controller, so that it is
    counted once; with `told` false it is taken off that report, as if it came from a pen of which nobody knows.
    """

    doses: ClassVar = True
    time_min: Annotated[
        float, About("Time of the run at which it is given.", at_least=0.0, at_most=LONGEST_RUN_MIN)
    ] = 840.0
    above_mg_dl: Annotated[
        float,
        About("Reading above which it is given, in mg/dl.", at_least=0.0, quantity=GLUCOSE_BOUND),
    ] = 180.0
    units_U: Annotated[
        float, About("Insulin of the bolus; 0: by the correction factor.", at_least=0.0, at_most=100.0)
    ] = 0.0
    told: Annotated[bool, About("Whether the controller is told of it: true or false.")] = True

    @derived
    def fall_per_U(self) -> Any:
        """Fall of glucose by 1 U in the person's profile [mg/dl/U]; without a profile no correction is given."""
        return math.inf if self.profile is None else self.profile.correction_factor()

    def tell(self, t_min: jax.Array, given_mU: jax.Array, observation: Observation) -> Observation:
        """The report of the pump, without the bolus by hand where it is not told."""
        report = observation.delivered_bolus_mU
        if self.told or report is None:
            return observation
        return dataclasses.replace(observation, delivered_bolus_mU=jnp.maximum(report - given_mU, 0.0))

    def give(self, t_min: jax.Array, observation: Observation) -> jax.Array:
        """Correction of the reading, or the given insulin."""
        due = (t_min >= self.time_min) & (t_min < self.time_min + self.sample_time_min)
        high = is_known(observation) & (observation.glucose_mg_dl > self.above_mg_dl)
        excess = observation.glucose_mg_dl - observation.setpoint_mg_dl
        correction = jnp.maximum(excess, 0.0) / self.fall_per_U
        units = jnp.where(self.units_U > 0.0, self.units_U, correction)
        return jnp.where(due & high & jnp.isfinite(units), units * MU_PER_U, 0.0)


class NoBolus(ActionComponent, name="no-bolus"):
    """Boluses of the controller that are not given for some time, as when nobody confirms them; the basal rate is.

    The pump reports what it gives, so that the controller knows.
    """

    time_min: Annotated[
        float, About("Time of the run from which on none is given.", at_least=0.0, at_most=LONGEST_RUN_MIN)
    ] = 705.0
    duration_min: Annotated[float, About("Time for which none is given.", above=0.0, at_most=1440.0)] = 45.0

    def confirms(self, t_min: jax.Array) -> jax.Array:
        """Whether a time is outside of that time."""
        return (t_min < self.time_min) | (t_min >= self.time_min + self.duration_min)


class ExerciseAnnouncement(ActionComponent, name="exercise"):
    """Exercise of which the controller is told, some time before it begins and until it ends.

    It changes nothing in the patient: the exercise itself is that of the scenario or a rhythm like ``sensitivity``.
    """

    time_min: Annotated[
        float, About("Time of the run at which exercise begins.", at_least=0.0, at_most=LONGEST_RUN_MIN)
    ] = 960.0
    duration_min: Annotated[float, About("Time for which it lasts.", above=0.0, at_most=1440.0)] = 45.0

    def uses(self) -> frozenset[Need]:
        """Needs that the action meets; the target of exercise is a temporary one."""
        return super().uses() | {TEMPORARY_TARGETS}

    before_min: Annotated[float, About("Time before it begins at which it is told.", at_least=0.0, at_most=1440.0)] = (
        90.0
    )

    def tell(self, t_min: jax.Array, given_mU: jax.Array, observation: Observation) -> Observation:
        """Observation with the time until exercise begins, 0 while it lasts and infinity where none is announced."""
        known = (t_min >= self.time_min - self.before_min) & (t_min < self.time_min + self.duration_min)
        ahead = jnp.where(known, jnp.maximum(self.time_min - t_min, 0.0), jnp.inf)
        earlier = observation.exercise_in_min  # of another announcement
        return dataclasses.replace(
            observation, exercise_in_min=ahead if earlier is None else jnp.minimum(ahead, earlier)
        )


ACTIONS: Final = Catalogue(
    ActionComponent,
    {
        "bolus": "glucoloop.control.action:HandBolus",
        "no-bolus": "glucoloop.control.action:NoBolus",
        "exercise": "glucoloop.control.action:ExerciseAnnouncement",
    },
    example="bolus, time=14h",
)
