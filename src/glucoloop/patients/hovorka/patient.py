"""Patients of Hovorka et al. (2004) and Wilinska et al. (2010): operating points, populations and forms."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any, ClassVar, Final, Self

from glucoloop._lazy_jax import jax, jnp, np, npt
from glucoloop.arguments import checked
from glucoloop.component.routes import PUMP_OF_1999, SUBCUTANEOUS
from glucoloop.component.setting import Default
from glucoloop.meals.hovorka import HovorkaGut
from glucoloop.patients.component import OperatingPoint, PatientComponent
from glucoloop.patients.hovorka import equations, glucagon, hovorka2004, wilinska
from glucoloop.patients.hovorka.equations import (
    GLUCOSE,
    INSULIN,
    MG_DL_PER_MMOL_L,
    MG_PER_MMOL,
    STATE_NAMES,
    HovorkaConstants,
    glucose_without_insulin_mg_dl,
    infusion_for,
    rest_at,
    rest_under,
)
from glucoloop.patients.hovorka.varying import (
    MIN_OF_MEAN,
    Lognormal,
    Normal,
    Uniform,
    meanings,
    nominal_values,
    refuse_impossible,
    with_values,
)
from glucoloop.patients.protocol import Inputs
from glucoloop.patients.resting import Rest
from glucoloop.patients.variation import TRUNCATION_SD, Distribution, Variation
from glucoloop.refusal import Refusal

if TYPE_CHECKING:
    from glucoloop.patients.variation import JointVariation

PLASMA: Final = "plasma"
INTERSTITIAL: Final = "interstitial"
_ROUNDING: Final = 1e-9
_INTEGRATION_MG_DL: Final = 0.1
"""Integration error with two exponential steps per sample."""
_INTERSTITIAL: Final = STATE_NAMES.index("IG")


class HovorkaPatient(PatientComponent):
    """Base of the patients of Hovorka's model; implements `SemilinearPatient`.

    The pump and the horizons are those with which the numbers of the guide were made.
    """

    person_constants: ClassVar[HovorkaConstants]
    """Constants of the nominal person."""
    distributions: ClassVar[Iterable[Normal | Uniform | Lognormal]]
    """Published distributions of the constants, of its one population."""
    within_sd: ClassVar[float]
    """Standard deviations within which they lie."""
    timeless: ClassVar = True
    insulin_route = SUBCUTANEOUS
    # The pump of 1999, 4 U/h, is ample for people who need 0.4 and 0.9 U/h.
    max_change_mU_min = PUMP_OF_1999.max_change_mU_min
    max_insulin_mU_min = PUMP_OF_1999.max_mU_min
    # Horizons of three and four hours.
    tunings: ClassVar = {
        "mpc": {"prediction_horizon": Default(36)},
        "mpc-se": {"prediction_horizon": Default(48)},
        "nlqdmc-se": {"prediction_horizon": Default(48)},
        "meal-mpc": {"prediction_horizon": Default(48)},
    }
    rest: ClassVar[Rest] = Rest(
        under=rest_under,
        holding=infusion_for,
        glucose_mg_dl=equations.plasma_glucose_mg_dl,
        largest_mU_min=lambda p: p.infusion_without_production_mU_min(),
        highest_mg_dl=glucose_without_insulin_mg_dl,
        beyond="the liver would make no glucose, and glucose would fall to 0 mg/dl",
    )
    sites: ClassVar[tuple[str, ...]] = (PLASMA, INTERSTITIAL)
    """Sites at which glucose can be measured."""
    insulin_sensitivity: ClassVar[tuple[str, ...]] = ("S_IT", "S_ID", "S_IE")
    glucose_production: ClassVar[Mapping[str, float]] = {"EGP_0": 1.0 / MG_PER_MMOL}

    @classmethod
    def parameters_of(cls, values: Mapping[str, Any]) -> HovorkaConstants:
        """The nominal person's constants, with other values in place of some."""
        return with_values(cls.person_constants, values)

    @classmethod
    def build(cls, values: Mapping[str, Any], basal_insulin_mU_min: Any, setpoint_mg_dl: Any) -> Self:
        """The person, or the people, of some values, all of whose constants are arrays of JAX."""
        people = super().build(values, basal_insulin_mU_min, setpoint_mg_dl)
        return people.replaced(parameters=jax.tree.map(jnp.asarray, people.parameters))

    @classmethod
    def refuse_impossible(cls, varied: Mapping[str, Distribution]) -> None:
        """Refuse distributions that can make an impossible person, see `varying.refuse_impossible`."""
        refuse_impossible(cls.person_constants, varied)

    @classmethod
    def variations(cls, population: str) -> tuple[Variation | JointVariation, ...]:
        """The published distributions, each within some standard deviations."""
        return tuple(_variation(distribution, cls.within_sd) for distribution in cls.distributions)

    @classmethod
    def sound(cls, x: jax.Array, lowest_mg_dl: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Whether insulin and glucose of states ``(9, ...)`` are physically possible, ``(...)`` each.

        No depot, amount, concentration or effect is ever below zero. Interstitial glucose follows plasma glucose, so
        that it has never been below the lowest of that.
        """
        insulin = jnp.all(x[INSULIN.start :] >= -_ROUNDING, axis=0)
        follows = x[_INTERSTITIAL] * MG_DL_PER_MMOL_L >= lowest_mg_dl - _INTEGRATION_MG_DL
        return insulin, jnp.all(x[GLUCOSE] >= -_ROUNDING, axis=0) & follows

    @property
    def meal_model(self) -> HovorkaGut:
        """The gut of Hovorka et al. (2004), with the person's own two constants."""
        return HovorkaGut(time_to_maximum_min=self.parameters.t_maxG, bioavailability=self.parameters.A_G)

    @property
    def lowest_valid_glucose_mg_dl(self) -> jax.Array | float:
        """Lower end of the valid range, 0 mg/dl: the balances hold for any positive glucose, and it stays positive.

        Every flow out of Q1 falls in proportion with Q1 where Q1 is small, and no flow into it is negative. The model
        has no counter-regulation, though: neither glucagon nor adrenaline raises production when glucose is low, so
        that a real person's glucose would fall less deep and recover sooner.
        """
        return 0.0

    def rest_at(self, glucose_mg_dl: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Infusion that holds a plasma glucose, and the state there; NaN for people whom no rate holds."""
        result: tuple[jax.Array, jax.Array] = rest_at(self.parameters, glucose_mg_dl)
        return result

    def derivative(self, t_min: jax.Array, x: jax.Array, inputs: Inputs) -> jax.Array:
        """Right-hand side; the patient's constants do not change with time."""
        return equations.derivative(self.parameters, x, inputs)

    def glucose_mg_dl(self, x: jax.Array) -> jax.Array:
        """Glucose concentration in plasma."""
        return equations.plasma_glucose_mg_dl(self.parameters, x)

    def seen_mg_dl(self, x: jax.Array, site: str) -> jax.Array:
        """Glucose at one of the `sites`.

        Raises
        ------
        ValueError
            For an unknown site.
        """
        if site == PLASMA:
            return self.glucose_mg_dl(x)
        if site == INTERSTITIAL:
            return equations.interstitial_glucose_mg_dl(x)
        raise Refusal(f"glucose cannot be measured at {site!r}; the known sites are: {', '.join(self.sites)}")

    def process_noise(self, glucose: float, other: float, glucagon: float = 0.0) -> npt.NDArray[np.float64]:
        """Diagonal of the process noise covariance `(9,)` that a Kalman filter of this patient takes.

        The variances are those of glucose in (mg/dl)^2, as which both amounts of glucose vary, and of plasma insulin in
        (mU/l)^2; depots and effects vary as they would at steady state under the infusion that makes up such an
        insulin. The model has no glucagon.
        """
        p = jax.tree.map(float, self.parameters)
        amount = p.V_G * p.weight_kg / MG_DL_PER_MMOL_L
        depot = p.k_e * p.V_I * p.weight_kg * p.t_maxI
        of_glucose = np.array([amount, amount, 1.0 / MG_DL_PER_MMOL_L])
        of_insulin = np.array([depot, depot, 1.0, p.S_IT, p.S_ID, p.S_IE])
        return np.concatenate([glucose * of_glucose**2, other * of_insulin**2])

    def split(self, x: jax.Array) -> tuple[jax.Array, jax.Array]:
        """State to glucose `(3, ...)`, and insulin with its effects `(6, ...)`."""
        return x[GLUCOSE], x[INSULIN]

    def join(self, y: jax.Array, z: jax.Array) -> jax.Array:
        """Glucose, and insulin with its effects, back to the state."""
        return jnp.concatenate([y, z])

    def working_state(self) -> jax.Array:
        """Steady state under the basal rate."""
        return self.steady_state(self.basal_insulin_mU_min)

    def stiff_couplings(self) -> npt.NDArray[np.bool_]:
        """Mask with all couplings, since each is slow enough to differ between people."""
        return np.ones((3, 3), dtype=bool)

    def driven_derivative(self, z: jax.Array, insulin_mU_min: jax.Array) -> jax.Array:
        """Balances of insulin and its effects `(6, ...)`."""
        return equations.insulin_balances(self.parameters, z, insulin_mU_min)

    def effects(self, z: jax.Array) -> jax.Array:
        """Effects of insulin x1, x2, x3 `(3, ...)`."""
        return z[3:]

    def transport(self, y: jax.Array) -> jax.Array:
        """Linear part of the glucose balances `(3, ...)`."""
        return equations.glucose_transport(self.parameters, y)

    def kinetics(self, y: jax.Array, effects: jax.Array, meal_mg_min: jax.Array) -> jax.Array:
        """Nonlinear part of the glucose balances `(3, ...)`."""
        return equations.glucose_kinetics(self.parameters, y, effects, meal_mg_min)


class Hovorka2004(HovorkaPatient, name="hovorka-2004"):
    """The model of Hovorka et al. (2004); subcutaneous insulin, 75 kg."""

    sources = ("hovorka2004",)
    operating_points = (
        OperatingPoint("fasting-120", "held at 120 mg/dl by 6.73 mU/min, which is 0.404 U/h", glucose_mg_dl=120.0),
    )
    populations: ClassVar = {
        "boiroux2017": "sixteen constants that differ as in the virtual people of Boiroux et al. (2017)"
    }
    pulse_mU_min = 6.5
    person_constants = hovorka2004.HOVORKA_2004
    nominal = nominal_values(hovorka2004.HOVORKA_2004)
    meanings = meanings(hovorka2004.CONSTANTS)
    distributions = hovorka2004.DISTRIBUTIONS
    within_sd = 1.0


class Wilinska2010(HovorkaPatient, name="wilinska-2010"):
    """The Cambridge simulator's model, of Wilinska et al. (2010); subcutaneous insulin, 74.9 kg."""

    sources = ("wilinska2010", "hovorka2004")
    operating_points = (
        OperatingPoint("fasting-120", "held at 120 mg/dl by 14.97 mU/min, which is 0.898 U/h", glucose_mg_dl=120.0),
    )
    populations: ClassVar = {
        "wilinska2010": "ten constants that differ as in the virtual people of Wilinska et al. (2010)"
    }
    pulse_mU_min = 14.5
    person_constants = wilinska.WILINSKA_2010
    nominal = nominal_values(wilinska.WILINSKA_2010)
    meanings = meanings(wilinska.CONSTANTS)
    distributions = wilinska.DISTRIBUTIONS
    within_sd = TRUNCATION_SD


class WilinskaGlucagon(HovorkaPatient, name="wilinska-2010-glucagon"):
    """The patient `wilinska-2010` with subcutaneous glucagon, of the McGill Diabetes Lab (2020); 74.9 kg.

    Without glucagon nothing differs.
    """

    extends: ClassVar = "wilinska-2010"
    takes_glucagon: ClassVar = True
    sources = ("mcgill2020", "wilinska2010", "hovorka2004")
    operating_points = Wilinska2010.operating_points
    populations: ClassVar = Wilinska2010.populations
    pulse_mU_min = Wilinska2010.pulse_mU_min
    person_constants = glucagon.MCGILL_2020
    nominal = nominal_values(glucagon.MCGILL_2020)
    meanings = meanings(glucagon.CONSTANTS)
    distributions = wilinska.DISTRIBUTIONS
    within_sd = Wilinska2010.within_sd
    rest: ClassVar[Rest] = dataclasses.replace(
        HovorkaPatient.rest, under=lambda p, insulin_mU_min: glucagon.without(rest_under(p, insulin_mU_min))
    )

    def rest_at(self, glucose_mg_dl: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Infusion that holds a plasma glucose, and the state there; NaN for people whom no rate holds."""
        rate, x = super().rest_at(glucose_mg_dl)
        return rate, glucagon.without(x)

    def derivative(self, t_min: jax.Array, x: jax.Array, inputs: Inputs) -> jax.Array:
        """Right-hand side; the patient's constants do not change with time."""
        return glucagon.derivative(self.parameters, x, inputs)

    def process_noise(self, glucose: float, other: float, glucagon: float = 0.0) -> npt.NDArray[np.float64]:
        """Diagonal of the process noise covariance `(11,)`, without any of the depots of glucagon."""
        return np.append(super().process_noise(glucose, other), [0.0, 0.0])

    def split(self, x: jax.Array) -> tuple[jax.Array, jax.Array]:
        """State to glucose `(3, ...)`, and insulin with its effects and glucagon `(8, ...)`."""
        return x[GLUCOSE], x[INSULIN.start :]

    def driven_derivative(self, z: jax.Array, insulin_mU_min: jax.Array) -> jax.Array:
        """Balances of insulin and its effects, and of glucagon that is left `(8, ...)`."""
        insulin = super().driven_derivative(z[:6], insulin_mU_min)
        return jnp.concatenate([insulin, glucagon.balances(self.parameters, z[6:], None)])

    def effects(self, z: jax.Array) -> jax.Array:
        """Effects of insulin, and production by glucagon [mmol/min], `(4, ...)`."""
        return jnp.concatenate([z[3:6], glucagon.production(self.parameters, z[6:])[None]])

    def kinetics(self, y: jax.Array, effects: jax.Array, meal_mg_min: jax.Array) -> jax.Array:
        """Nonlinear part of the glucose balances `(3, ...)`."""
        return glucagon.with_production(super().kinetics(y, effects[:3], meal_mg_min), effects[3])


def _variation(distribution: Normal | Uniform | Lognormal, within_sd: float) -> Variation:
    if isinstance(distribution, Uniform):
        half = (distribution.most - distribution.least) / 2.0
        return Variation(
            parameter=distribution.parameter, distribution="uniform", centre=distribution.least + half, spread=half
        )
    if isinstance(distribution, Normal):
        reach = within_sd * distribution.sd
        return Variation(
            parameter=distribution.parameter,
            distribution="normal",
            centre=distribution.mean,
            spread=distribution.sd,
            lower=distribution.mean - reach if reach < distribution.mean else MIN_OF_MEAN * distribution.mean,
            upper=distribution.mean + reach,
        )
    return Variation(
        parameter=distribution.parameter,
        distribution="lognormal",
        centre=distribution.median,
        spread_pct=100.0 * math.sqrt(math.expm1(distribution.sd_of_logarithm**2)),
        lower=distribution.median * math.exp(-within_sd * distribution.sd_of_logarithm),
        upper=distribution.median * math.exp(within_sd * distribution.sd_of_logarithm),
    )


@checked
def at_basal(p: HovorkaConstants, insulin_mU_min: jax.Array | float) -> HovorkaPatient:
    """Patient whose setpoint is the glucose that the given infusion holds; ValueError if there is none."""
    return HovorkaPatient(**HovorkaPatient.rest.at_basal(p, insulin_mU_min))


@checked
def at_setpoint(p: HovorkaConstants, glucose_mg_dl: jax.Array | float) -> HovorkaPatient:
    """Patient whose basal rate is the one that holds the given glucose; ValueError if none does."""
    return HovorkaPatient(**HovorkaPatient.rest.at_setpoint(p, glucose_mg_dl))
