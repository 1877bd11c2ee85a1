"""Pace: a controller that acts every few samples of its loop, as where the pump acts each minute."""

from __future__ import annotations

import dataclasses
from typing import Any

from glucoloop._lazy_jax import jax, jnp
from glucoloop._pytree import pytree, static
from glucoloop.arguments import checked
from glucoloop.component.effects import Need
from glucoloop.control.around import AroundAnother
from glucoloop.control.decision import eaten_in_min, is_known
from glucoloop.control.design_case import check_sample_time
from glucoloop.control.protocol import (
    Controller,
    Decision,
    DoseForecast,
    Observation,
    Status,
    forecast_of,
    uses_of,
)
from glucoloop.refusal import Refusal


@pytree
class _PacedState:
    """State of a paced controller: what is in force, and what was observed since the controller acted."""

    inner: Any
    """State of the inner controller."""
    insulin_mU_min: jax.Array
    """Rate in force."""
    status: jax.Array
    """Status of the decision in force."""
    gathered: jax.Array
    """Number of observations since the inner controller acted, the same for all people."""
    delivered_mU_min: jax.Array
    """Mean rate that the pump reported since then."""
    bolus_mU: jax.Array | None
    """Sum of the boluses that it reported; None where the inner controller gives none."""
    carbs_g: jax.Array
    """Sum of the announced carbohydrate."""
    reading_mg_dl: jax.Array
    """Newest valid reading, or NaN."""
    rescue_g: jax.Array | None = None
    """Sum of the carbohydrate that was eaten against low glucose; None where that is not told."""
    in_min: jax.Array | None = None
    """Time from the last sample until the first announced meal was to be eaten, or infinity; None if none is told."""


@pytree
class Paced(AroundAnother):
    """A controller that acts every few samples of its loop; see `paced`."""

    inner: Controller
    samples: int = static()
    """Samples of the loop from one action to the next."""
    sample_time_min: float = static()

    @property
    def uses(self) -> frozenset[Need]:
        """Needs that the inner controller meets."""
        return uses_of(self.inner)

    @property
    def horizons(self) -> tuple[int, int]:
        """Moves and predicted samples of the inner controller, if it plans moves."""
        result: tuple[int, int] = self.inner.horizons  # type: ignore[attr-defined]
        return result

    def padded(self, moves: int, horizon: int) -> Paced:
        """The same with a longer plan of the inner controller, as `LinearMPC.padded` has it."""
        return dataclasses.replace(self, inner=self.inner.padded(moves, horizon))  # type: ignore[attr-defined]

    def with_basal(self, insulin_mU_min: jax.Array) -> Paced:
        """The same for a person with the given basal rate, which the inner controller gets if it takes it."""
        with_basal = getattr(self.inner, "with_basal", None)
        return self if with_basal is None else dataclasses.replace(self, inner=with_basal(insulin_mU_min))

    def init(self, observation: Observation) -> _PacedState:
        """State before the first sample, at which the inner controller acts."""
        delivered = observation.delivered_mU_min
        return _PacedState(
            inner=self.inner.init(observation),
            insulin_mU_min=delivered,
            status=jnp.full_like(delivered, int(Status.OK), dtype=int),
            gathered=jnp.full((), self.samples - 1.0, delivered.dtype),
            delivered_mU_min=delivered,
            bolus_mU=jnp.zeros_like(delivered) if self.gives_boluses else None,
            carbs_g=jnp.zeros_like(observation.announced_carbs_g),
            reading_mg_dl=jnp.full_like(observation.glucose_mg_dl, jnp.nan),
            rescue_g=None if observation.rescue_carbs_g is None else jnp.zeros_like(delivered),
            in_min=None if observation.announced_in_min is None else jnp.full_like(delivered, jnp.inf),
        )

    def step(self, state: _PacedState, observation: Observation) -> tuple[_PacedState, Decision]:
        """Let the inner controller act where it is due, or hold its rate and give no bolus."""
        gathered, due = self._due(state)
        in_min = self._first_eaten_in(state, observation)
        seen = self._since(state, observation, gathered, in_min)
        inner, decision = self.inner.step(state.inner, seen)

        def acted(new: Any, old: Any) -> Any:
            return jax.tree.map(lambda a, b: jnp.where(due, a, b), new, old)

        insulin = acted(decision.insulin_mU_min, state.insulin_mU_min)
        status = acted(decision.status, state.status).astype(state.status.dtype)
        zero = jnp.zeros_like(state.delivered_mU_min)
        no_bolus = None if state.bolus_mU is None else zero
        state = _PacedState(
            inner=acted(inner, state.inner),
            insulin_mU_min=insulin,
            status=status,
            gathered=jnp.where(due, 0.0, gathered),
            delivered_mU_min=acted(zero, seen.delivered_mU_min),
            bolus_mU=acted(no_bolus, seen.delivered_bolus_mU),
            carbs_g=acted(jnp.zeros_like(state.carbs_g), seen.announced_carbs_g),
            reading_mg_dl=jnp.where(due | ~seen.valid, jnp.nan, seen.glucose_mg_dl),
            rescue_g=acted(None if state.rescue_g is None else zero, seen.rescue_carbs_g),
            in_min=None if in_min is None else jnp.where(due, jnp.inf, in_min),
        )
        no_glucagon = None if decision.glucagon_ug is None else zero
        return state, Decision(
            insulin_mU_min=insulin,
            status=status,
            bolus_mU=acted(decision.bolus_mU, no_bolus),
            glucagon_ug=acted(decision.glucagon_ug, no_glucagon),
        )

    def forecast(self, state: _PacedState, observation: Observation) -> DoseForecast | None:
        """Forecast of the inner controller where it acts, and NaN between."""
        gathered, due = self._due(state)
        seen = self._since(state, observation, gathered, self._first_eaten_in(state, observation))
        forecast = forecast_of(self.inner, state.inner, seen)
        return jax.tree.map(lambda numbers: jnp.where(due, numbers, jnp.nan), forecast)  # type: ignore[no-any-return]

    def _due(self, state: _PacedState) -> tuple[jax.Array, jax.Array]:
        """Number of observations since the inner controller acted, and whether it acts at this one."""
        gathered = state.gathered + 1.0
        return gathered, ~(gathered < self.samples)  # also where the number was lost

    def _first_eaten_in(self, state: _PacedState, observation: Observation) -> jax.Array | None:
        """Time until the first meal is eaten of those announced since the inner controller acted, or infinity."""
        if state.in_min is None:
            return None
        now = jnp.where(observation.announced_carbs_g > 0.0, eaten_in_min(observation), jnp.inf)
        return jnp.minimum(jnp.maximum(state.in_min - self.sample_time_min, 0.0), now)

    def _since(
        self, state: _PacedState, observation: Observation, gathered: jax.Array, in_min: jax.Array | None
    ) -> Observation:
        """Observation of the inner controller: the newest valid reading, and everything since it acted."""
        earlier = ~is_known(observation) & jnp.isfinite(state.reading_mg_dl)
        # in this form the mean of a rate that was held is that rate, to the bit
        delivered = state.delivered_mU_min + (observation.delivered_mU_min - state.delivered_mU_min) / gathered
        bolus = None
        if state.bolus_mU is not None and observation.delivered_bolus_mU is not None:
            bolus = state.bolus_mU + observation.delivered_bolus_mU
        rescue = None
        if state.rescue_g is not None and observation.rescue_carbs_g is not None:
            rescue = state.rescue_g + observation.rescue_carbs_g
        return dataclasses.replace(
            observation,
            glucose_mg_dl=jnp.where(earlier, state.reading_mg_dl, observation.glucose_mg_dl),
            valid=observation.valid | earlier,
            delivered_mU_min=delivered,
            delivered_bolus_mU=bolus,
            announced_carbs_g=state.carbs_g + observation.announced_carbs_g,
            announced_in_min=None if in_min is None else jnp.where(jnp.isfinite(in_min), in_min, 0.0),
            rescue_carbs_g=rescue,
        )


@checked
def paced(controller: Controller, sample_time_min: float) -> Controller:
    """Let a controller act at its own sample time in a loop with a shorter one.

    The controller acts at the first sample of the loop and then each time that its own sample time has passed. It is
    told of the newest valid reading since it acted, the mean of the rates that the pump reported, the sum of the
    boluses, and the sum of the announced carbohydrate, with the time at which the first of it is eaten. Between, its
    rate and its status hold, and neither a bolus nor glucagon is given.

    Parameters
    ----------
    controller : Controller
        Controller that was designed for its own sample time.
    sample_time_min : float
        Sample time of the loop.

    Returns
    -------
    Controller
        The paced controller, or the given one where both sample times are the same.

    Raises
    ------
    ValueError
        For a sample time of the controller that is not a whole number of samples of the loop.

    Examples
    --------
    >>> import glucoloop as gl
    >>> controller = gl.control.paced(gl.design_pid(gl.PIDTuning(0.5, 150.0), sample_time_min=15.0), 5.0)
    >>> controller.samples, controller.sample_time_min
    (3, 5.0)
    """
    check_sample_time(sample_time_min)
    samples = samples_of_pace(controller.sample_time_min, sample_time_min)
    return controller if samples == 1 else Paced(inner=controller, samples=samples, sample_time_min=sample_time_min)


def samples_of_pace(every_min: float, sample_time_min: float) -> int:
    """Samples of a loop from one action of a controller to the next; Refusal unless it is a whole number from 1."""
    samples = max(1, round(every_min / sample_time_min))
    if abs(samples * sample_time_min - every_min) > 1e-9 * every_min:
        raise Refusal(
            f"a controller that acts every {every_min:g} min is not possible in a loop of {sample_time_min:g}-min "
            f"samples; give a whole number of them, like {samples * sample_time_min:g} min, or another sample time"
        )
    return samples
