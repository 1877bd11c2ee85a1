"""Forecast of a guard: how much insulin a sample may have so that glucose stays above a floor if none follows.

The person is not known by any equations. Filter and forecast are those of `control.therapy_mpc`: the model of ratio,
factor, basal rate and weight alone, whose gains are learned from readings. The forecast is cautious in one way: under
the basal rate glucose drifts down by a standard deviation of what is learned of that drift. Let ``G_c(t; u)`` be it for
a dose u in the coming sample and no insulin after that. The largest dose that is allowed is::

    max u  such that  G_c(t; u) >= floor  for every t up to the horizon

Insulin lowers glucose in the model the less, the lower glucose is: G_c falls with u and is convex in it. So the tangent
of a time lies below G_c, and where it meets the floor G_c has not passed it. The minimum over all times, from no dose
on, is therefore an allowed dose, and repeated from there it grows towards the largest one.

Insulin that was withheld is owed for some time: it is offered again at each sample, as far as the controller does not
ask for it by itself and none was given in its place. That of an announced meal passes like any other. Basal insulin,
which a rate told too high withholds for good reason, passes only as far as glucose stays above the target.

A meal that appears slower than the model expects looks like one that was counted too large: glucose does not rise, the
rest of the meal is no longer believed, and the basal rate is withheld for hours. So the filter of this forecast accepts
guts that are slower than those of the controller.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from typing import Any, Final

from glucoloop._lazy_jax import jax, jnp, np
from glucoloop._pytree import pytree, static
from glucoloop.control.decision import MealsToCome, no_meals_to_come
from glucoloop.control.guard_doses import MAX_BOLUS_MU
from glucoloop.control.guard_settings import ForecastSettings
from glucoloop.control.protocol import Observation
from glucoloop.control.therapy_mpc import TherapyMPC
from glucoloop.estimation.fed_filter import FedEstimate
from glucoloop.pumps.limits import DEFAULT_BOLUS_LIMITS, PARKER_1999_LIMITS
from glucoloop.therapy import Profile

_TARGET_MG_DL: Final = 110.0
"""Glucose at which the model rests; its filter learns where the person does."""
_BASAL_MU_MIN: Final = 10.0
"""Basal rate of the design, in the place of which comes that of the guard."""
_TANGENTS: Final = 2
"""Number of times that the tangents are taken."""
_DRIFT_DOUBT: Final = 1.0
"""Standard deviations of the learned drift under the basal rate by which glucose is taken to drift down."""
_SLOWEST_GUT: Final = math.log(2.0)
"""Logarithm of the longest time constant of a gut, relative to that of the controller, that is accepted."""
_LEAST_EFFECT: Final = 1e-7
"""Effect of a dose, in mg/dl for each mU, that is taken at least."""


@pytree
class ForesightState:
    """Estimate of the person, and insulin that is owed."""

    estimate: FedEstimate
    owed_mU: jax.Array
    """Insulin of announced meals that was withheld."""
    owed_for_min: jax.Array
    """Time for which it is still owed."""
    owed_basal_mU: jax.Array
    """Basal insulin that was withheld, as far as it is not forgotten."""
    to_come: MealsToCome | None = None
    """Announced meals that are still to be eaten; None where observations tell no time of eating."""


@pytree
class Foresight:
    """Forecast of a guard for a person; see the head of the file."""

    forecaster: TherapyMPC
    """Model, filter and forecast, the steps of which end with the horizon."""
    settings: ForecastSettings = static()
    carb_ratio_g_U: Any = jnp.nan
    """Numbers of the profile; NaN where they are not known."""
    correction_mg_dl_U: Any = jnp.nan
    weight_kg: Any = jnp.nan
    total_daily_dose_U: Any = jnp.nan

    @classmethod
    def of(cls, settings: ForecastSettings, sample_time_min: float) -> Foresight:
        """Forecast of a person of whom the basal rate alone is known."""
        return cls(forecaster=_forecaster(sample_time_min, settings.forecast_min), settings=settings)

    def with_profile(self, profile: Profile) -> Foresight:
        """The same forecast for a person with a profile, whose basal rate is that of the guard."""
        names = ("carb_ratio_g_U", "correction_mg_dl_U", "weight_kg", "total_daily_dose_U")
        known = {name: value for name in names if (value := getattr(profile, name)) is not None}
        return dataclasses.replace(self, **known)

    def _of_basal(self, basal_mU_min: jax.Array) -> TherapyMPC:
        """Forecaster of the person under a basal rate."""
        profile = Profile(
            basal_mU_min=basal_mU_min,
            setpoint_mg_dl=jnp.nan,
            carb_ratio_g_U=self.carb_ratio_g_U,
            correction_mg_dl_U=self.correction_mg_dl_U,
            weight_kg=self.weight_kg,
            total_daily_dose_U=self.total_daily_dose_U,
        )
        return self.forecaster.with_profile(profile)

    def init(self, observation: Observation, basal_mU_min: jax.Array) -> ForesightState:
        """State in which nothing is owed to a person at rest under the basal rate."""
        forecaster = self._of_basal(basal_mU_min)
        zero = jnp.zeros_like(basal_mU_min)
        return ForesightState(
            estimate=forecaster.filter.init(forecaster.model),
            owed_mU=zero,
            owed_for_min=zero,
            owed_basal_mU=zero,
            to_come=no_meals_to_come(observation),
        )

    def updated(
        self, state: ForesightState, observation: Observation, basal_mU_min: jax.Array, insulin_mU: jax.Array
    ) -> ForesightState:
        """State of this sample, after all insulin that counts of the last one; a lost estimate begins again."""
        forecaster = self._of_basal(basal_mU_min)
        every = forecaster.sample_time_min
        estimate, to_come, _ = forecaster.estimated(state.estimate, state.to_come, observation, insulin_mU / every)
        left_min = state.owed_for_min - every
        owes = (left_min > 0.0) & (left_min <= self.settings.owed_min)
        owes = owes & _is_bolus(state.owed_mU)
        left = math.exp(-every / self.settings.owed_min)
        return ForesightState(
            estimate=estimate,
            owed_mU=jnp.where(owes, state.owed_mU, 0.0),
            owed_for_min=jnp.where(owes, left_min, 0.0),
            owed_basal_mU=jnp.where(_is_bolus(state.owed_basal_mU), left * state.owed_basal_mU, 0.0),
            to_come=to_come,
        )

    def largest_dose(
        self,
        state: ForesightState,
        basal_mU_min: jax.Array,
        wanted_mU: jax.Array,
        floor_mg_dl: jax.Array | float | None = None,
    ) -> jax.Array:
        """Largest insulin of the coming sample up to the wanted one [mU]; NaN where there is no forecast."""
        floor = self.settings.floor_mg_dl if floor_mg_dl is None else floor_mg_dl
        forecaster = self._of_basal(basal_mU_min)
        first = jnp.zeros_like(forecaster.ahead.block_min).at[0].set(1.0 / forecaster.sample_time_min)
        cautious = forecaster.filter.drifting_down(state.estimate, _DRIFT_DOUBT)

        def glucose(dose_mU: jax.Array) -> jax.Array:
            return forecaster.expected(cautious, state.to_come, first * dose_mU)

        # From no dose on, since with one many times too large the steps of the forecast are no longer stable.
        dose = jnp.zeros_like(wanted_mU)
        for _ in range(_TANGENTS):
            ahead, slope = jax.jvp(glucose, (dose,), (jnp.ones_like(dose),))
            room = ahead - floor
            dose = jnp.clip(dose + jnp.min(room / jnp.maximum(-slope, _LEAST_EFFECT)), 0.0, wanted_mU)
        return dose

    def requested(self, state: ForesightState, eats: jax.Array, bolus_mU: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Bolus with what is owed of a meal in it, at most that of any pump, and the same with owed basal insulin."""
        of_meal = jnp.where(eats, bolus_mU + state.owed_mU, jnp.maximum(bolus_mU, state.owed_mU))
        of_meal = jnp.minimum(of_meal, MAX_BOLUS_MU)
        return of_meal, of_meal + state.owed_basal_mU

    def passed(
        self,
        state: ForesightState,
        basal_mU_min: jax.Array,
        rate_mU_min: jax.Array,
        bolus_mU: jax.Array | None,
        without_owed_basal_mU: jax.Array | None,
        target_mg_dl: jax.Array,
    ) -> tuple[jax.Array, jax.Array]:
        """Largest insulin of the coming sample that passes [mU], and whether it is all that is wanted.

        `without_owed_basal_mU` is the bolus but for owed basal insulin; both are None of a controller without boluses.
        """
        every = self.forecaster.sample_time_min
        wanted_mU = rate_mU_min * every
        if bolus_mU is None or without_owed_basal_mU is None:
            most_mU = self.largest_dose(state, basal_mU_min, wanted_mU)
        else:
            most_mU = self.largest_dose(state, basal_mU_min, wanted_mU + jnp.minimum(bolus_mU, without_owed_basal_mU))
            wanted_mU = wanted_mU + bolus_mU
            floor = jnp.maximum(self.settings.floor_mg_dl, target_mg_dl)
            most_mU = jnp.maximum(most_mU, self.largest_dose(state, basal_mU_min, wanted_mU, floor))
        return most_mU, most_mU >= wanted_mU

    def owing(
        self, state: ForesightState, eats: jax.Array, due_mU: jax.Array, extra_mU: jax.Array, withheld_mU: jax.Array
    ) -> ForesightState:
        """State after a decision.

        `due_mU` is the bolus that a meal should have had, `extra_mU` all insulin that was given beyond the basal rate,
        and `withheld_mU` what the controller asked for and did not get, up to the basal rate.
        """
        of_meal, extra_mU = jnp.where(eats, due_mU, state.owed_mU), jnp.maximum(extra_mU, 0.0)
        beyond_mU = jnp.maximum(extra_mU - of_meal, 0.0)
        return dataclasses.replace(
            state,
            owed_mU=jnp.maximum(of_meal - extra_mU, 0.0),
            owed_for_min=jnp.where(eats, self.settings.owed_min, state.owed_for_min),
            owed_basal_mU=jnp.maximum(state.owed_basal_mU - beyond_mU, 0.0) + jnp.maximum(withheld_mU, 0.0),
        )


def _is_bolus(insulin_mU: jax.Array) -> jax.Array:
    """Whether insulin is as much as a pump can give at once; NaN is not."""
    return (insulin_mU >= 0.0) & (insulin_mU <= MAX_BOLUS_MU)


@functools.cache
def _forecaster(sample_time_min: float, horizon_min: float) -> TherapyMPC:
    """The controller of which filter and forecast are used, with the steps up to a horizon, at least the first."""
    with jax.ensure_compile_time_eval():
        nobody = Profile(basal_mU_min=_BASAL_MU_MIN, setpoint_mg_dl=_TARGET_MG_DL)
        forecaster = TherapyMPC().of_person(nobody, PARKER_1999_LIMITS, DEFAULT_BOLUS_LIMITS, sample_time_min)
        ahead = forecaster.ahead
        steps = max(1, int(np.sum(np.cumsum(np.asarray(ahead.step.minutes)) <= horizon_min + 1e-9)))
        kept = dataclasses.replace(
            ahead, step=jax.tree.map(lambda leaf: leaf[:steps], ahead.step), of_block=ahead.of_block[:steps]
        )
        slow = dataclasses.replace(forecaster.filter, slowest_log_time=_SLOWEST_GUT)
        return forecaster.replaced(ahead=kept, filter=slow)
