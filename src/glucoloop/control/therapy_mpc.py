"""Model predictive control by the settings of insulin therapy alone, whose gains are learned, for subcutaneous insulin.

Objective, forecast and program are those of `control.profile_mpc`, on the equations of `models.therapy_settings`.
"""

from __future__ import annotations

from typing import Annotated, ClassVar

from glucoloop._lazy_jax import jnp
from glucoloop.component.pytree_component import DATA, HOST
from glucoloop.component.setting import About
from glucoloop.control.design_case import DesignCase
from glucoloop.control.profile_mpc import ProfileMPC
from glucoloop.estimation.fed_filter import FedEstimate, Learning
from glucoloop.models.profiled import GutCompartments, profiled_model
from glucoloop.models.therapy_settings import DRIFT, LOG_GAIN, WEIGHT_KG, TherapySettingsModel
from glucoloop.pumps.limits import BolusLimits, DoseLimits
from glucoloop.therapy import Profile
from glucoloop.unit_guess import GLUCOSE_BOUND


class TherapyMPC(ProfileMPC, name="therapy-mpc"):
    """Predictive control that knows no equations of the patient: by ratio, factor, basal rate and weight alone.

    The model is the same for everybody, insulin through three lags and a gut, scaled so that a unit lowers glucose by
    the person's correction factor and covers the carbohydrate of the person's ratio. What the profile has wrong is
    learned from readings: the drift of glucose under the basal rate, and the gains of insulin and of meals. The state
    of the controller holds them, so that they outlast a restart from a stored state. In the cautious forecast insulin
    does more than is learned.

    Objective, variables and program are those of `profile-mpc`.
    """

    on_equations: ClassVar = False
    role_of_settings: ClassVar = HOST

    glucose_floor_mg_dl: Annotated[
        float,
        About("Floor under the cautious forecast, in mg/dl, at most the target.", above=0.0, quantity=GLUCOSE_BOUND),
        DATA,
    ] = 85.0
    meal_noise_g: Annotated[
        float, About("Standard deviation of the carbohydrate that is eaten unannounced in 5 min.", at_least=0.0)
    ] = 3.0
    basal_error_pct: Annotated[
        float, About("Standard deviation of the error of the basal rate, which is learned, in percent.", at_least=0.0)
    ] = 25.0
    insulin_gain_error_pct: Annotated[
        float, About("Standard deviation of what insulin does, which is learned, in percent.", at_least=0.0)
    ] = 30.0
    meal_gain_error_pct: Annotated[
        float, About("Standard deviation of what carbohydrate does, which is learned, in percent.", at_least=0.0)
    ] = 30.0
    gain_walk_pct: Annotated[
        float, About("Standard deviation of the change of each of these in a day, in percent.", at_least=0.0)
    ] = 5.0
    gain_doubt: Annotated[
        float,
        About("Standard deviations by which the cautious forecast takes insulin to do more.", at_least=0.0),
        DATA,
    ] = 0.25
    min_profile_share: Annotated[
        float,
        About(
            "Minimum ratio and factor that are accepted, relative to those of profile-mpc, 0.29 and 0.43 of the rules.",
            at_least=0.0,
        ),
    ] = 0.25

    def designed(self, case: DesignCase) -> TherapyMPC:
        """The controller for a patient's profile."""
        return self.of_person(case.profile, case.limits, case.bolus, case.sample_time_min, case.noise_variance)

    def of_person(
        self,
        profile: Profile,
        limits: DoseLimits,
        bolus: BolusLimits,
        sample_time_min: float,
        noise_variance: float = 0.0,
    ) -> TherapyMPC:
        """The controller for a person with a profile, a pump and a sensor."""
        equations = TherapySettingsModel(
            target_mg_dl=jnp.asarray(profile.setpoint_mg_dl, float),
            sensor_lag_min=jnp.asarray(self.sensor_lag_min, float),
            sample_time_min=sample_time_min,
        )
        gut = GutCompartments(time_to_peak_min=self.gut_min)
        model = profiled_model(equations, equations.linearised(), gut, WEIGHT_KG, self.min_profile_share)
        learning = Learning(
            basal_error=self.basal_error_pct / 100.0,
            insulin_gain_error=self.insulin_gain_error_pct / 100.0,
            meal_gain_error=self.meal_gain_error_pct / 100.0,
            walk=self.gain_walk_pct / 100.0,
            states=(DRIFT, LOG_GAIN),
        )
        return self._of_profiled(model.with_profile(profile), gut, limits, bolus, noise_variance, learning)

    def _doubted(self, estimate: FedEstimate) -> FedEstimate:
        return self.filter.less_sure(super()._doubted(estimate), self.gain_doubt)
