"""The patient of Parker, Doyle and Peppas (1999): Sorensen's 19 states, operating points and populations.

Concentrations of insulin and glucagon never fall below zero. Glucose can, in these equations: brain, gut and red cells
take up the same amount however little there is, so hours of too much insulin take even arterial glucose below zero.
What can be promised follows from the balances. Transport of glucose only ever mixes: if arterial glucose has never been
below m, the blood of the brain has never been below ``m - u_B / q_B``, its tissue not below ``m - u_B / q_B -
u_B T_B / v_BI``, and the gut not below ``m - u_G / q_G``: what each takes up at steady state. Elsewhere uptake ends
with glucose, which stays at zero or above as long as m is above what the gut takes up. Rates of uptake do not scale
with body weight while flows and volumes do, so these distances are largest for the lightest person.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, ClassVar, Final

from glucoloop._lazy_jax import jax, jit, jnp, np, npt
from glucoloop.arguments import checked
from glucoloop.component.setting import Default
from glucoloop.patients.component import OperatingPoint, PatientComponent
from glucoloop.patients.protocol import Inputs
from glucoloop.patients.resting import Rest
from glucoloop.patients.sorensen import equations as sorensen
from glucoloop.patients.sorensen.equations import INSULIN, STATE_NAMES, SorensenParameters
from glucoloop.patients.sorensen.parker1999 import PARKER_1999
from glucoloop.patients.sorensen.rest import infusion_for, insulin_at_rest, rest_at, rest_under
from glucoloop.patients.sorensen.varying import (
    ADULTS,
    FOLLOWS,
    LARGEST_VARIATION_PCT,
    MEANINGS,
    NOMINAL,
    REFERENCE_WEIGHT_KG,
    STRENGTH,
    UNCERTAIN,
    WEIGHT,
    refuse_impossible,
    with_fasting_glucose,
    with_values,
)
from glucoloop.patients.variation import Distribution, Variation

if TYPE_CHECKING:
    from glucoloop.patients.variation import JointVariation

_WORKING_INSULIN: Final = 1.35
"""Insulin of the working state in basal rates, between rest and the delivery while a meal is absorbed."""
_SPREAD_CV_PCT: Final = 20.0
"""Coefficient of variation of the constants of the population ``lognormal``."""
_AT_NOMINAL_22: Final = {
    "reference_start": Default(0),
    "glucose_process_noise": Default(10.0, noisy=0.9),
    "other_process_noise": Default(0.01),
    "glucagon_process_noise": Default(0.1, noisy=0.003),
}
_AT_FASTING_81: Final = {
    "reference_start": Default(0),
    "glucose_process_noise": Default(10.0, noisy=0.3),
    "other_process_noise": Default(0.01, noisy=0.1),
    "glucagon_process_noise": Default(0.1, noisy=0.03),
}
LIGHTEST_KG: Final = ADULTS.around(REFERENCE_WEIGHT_KG).lower
"""Minimum weight of a person in the populations."""
_ROUNDING: Final = 1e-9
_INTEGRATION_MG_DL: Final = 0.1
"""Integration error with two exponential steps per sample, on the way down to these bounds."""
_UPTAKE_ENDS: Final = tuple(STATE_NAMES.index(name) for name in ("G_L", "G_K", "G_PV", "G_PI"))


class SorensenPatient(PatientComponent, name="parker-1999"):
    """Sorensen's 19 states as Parker, Doyle and Peppas (1999) use them; intravenous insulin, 70 kg.

    Implements `SemilinearPatient`.
    """

    timeless: ClassVar = True
    takes_glucagon: ClassVar[bool] = True
    sources = ("parker1999", "parker2000", "sorensen1985", "lehmann1992")
    operating_points = (
        OperatingPoint("setpoint-81", "held at 81.1 mg/dl by 25.61 mU/min"),
        OperatingPoint(
            "nominal-22", "22.33 mU/min, which hold 92.1 mg/dl", {"mpc-se": _AT_NOMINAL_22, "nlqdmc-se": _AT_NOMINAL_22}
        ),
        OperatingPoint(
            "fasting-81",
            "22.33 mU/min, which hold 81.2 mg/dl in a person whose healthy fasting glucose is 81 mg/dl",
            {"mpc-se": _AT_FASTING_81, "nlqdmc-se": _AT_FASTING_81},
        ),
    )
    populations: ClassVar = {
        "parker2000": "up to 40 % in the eight parameters of Parker et al. (2000), uniform",
        "lognormal": "the same eight, lognormal with a coefficient of variation of 20 %, and weight of 70 kg with 15 %",
    }
    pulse_mU_min = 22.33
    nominal = NOMINAL
    follows = FOLLOWS
    meanings = MEANINGS
    hint = (
        "the known ones are the constants of the patient, such as F_LC or M_IHGP.inflection, the strength of an "
        f"effect, such as M_IHGP.{STRENGTH}, and {WEIGHT}"
    )
    rest: ClassVar[Rest] = Rest(
        under=rest_under,
        holding=infusion_for,
        glucose_mg_dl=lambda p, x: x[sorensen.ARTERIAL_GLUCOSE],
        largest_mU_min=lambda p: infusion_for(p, jnp.asarray(0.0)),
        highest_mg_dl=lambda p: rest_under(p, jnp.asarray(0.0))[sorensen.ARTERIAL_GLUCOSE],
        beyond="glucose would rest at or below 0 mg/dl",
    )
    sites: ClassVar[tuple[str, ...]] = ("arterial", "interstitial")

    @classmethod
    def parameters_of(cls, values: Mapping[str, Any]) -> SorensenParameters:
        """Constants as JAX has them; one that all people share is made once."""
        parameters: SorensenParameters = jax.tree.map(_number, with_values(values))
        return parameters

    @classmethod
    def at_operating_point(cls, name: str) -> SorensenPatient:
        """The nominal person at one of `OPERATING_POINTS`."""
        return OPERATING_POINTS[cls.point(name).name]()

    @classmethod
    def refuse_impossible(cls, varied: Mapping[str, Distribution]) -> None:
        """Refuse distributions that can make an impossible person, see `varying.refuse_impossible`."""
        refuse_impossible(varied)

    @classmethod
    def variations(cls, population: str) -> tuple[Variation | JointVariation, ...]:
        """The eight uncertain constants of Parker et al. (2000); in the population ``lognormal`` weight too."""
        if population == "parker2000":
            return tuple(
                Variation(parameter=entry.parameter, distribution="uniform", spread_pct=LARGEST_VARIATION_PCT)
                if entry.half_width is None
                else Variation(parameter=entry.parameter, distribution="uniform", spread=entry.half_width)
                for entry in UNCERTAIN
            )
        lognormal = (
            Variation(
                parameter=entry.parameter,
                distribution="lognormal",
                spread_pct=_SPREAD_CV_PCT,
                # insulin of the periphery could not be cleared beyond 0.243
                upper=0.21 if entry.parameter == "F_PC" else None,
            )
            if entry.half_width is None
            else Variation(parameter=entry.parameter, distribution="normal", spread=_SPREAD_CV_PCT / 100.0)
            for entry in UNCERTAIN
        )
        return (*lognormal, ADULTS)

    @classmethod
    def sound(cls, x: jax.Array, lowest_mg_dl: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Whether insulin and glucose of states ``(19, ...)`` are possible, by the minimum arterial glucose so far."""
        insulin = jnp.all(x[INSULIN] >= -_ROUNDING, axis=0) & (x[sorensen.GLUCAGON] >= -_ROUNDING)
        return insulin, _explained(x, lowest_mg_dl)

    @property
    def lowest_valid_glucose_mg_dl(self) -> jax.Array | float:
        """Lower end of the valid range of glucose; see `sorensen.lowest_valid_glucose`."""
        return sorensen.lowest_valid_glucose(self.parameters)

    def rest_at(self, glucose_mg_dl: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Infusion `(...)` that holds a glucose, and the state `(19, ...)` there.

        Both are NaN where none from 0 to 1000 mU/min does with glucose above zero in every organ.
        """
        infusion, state = rest_at(self.parameters, glucose_mg_dl)
        possible = jnp.all(state[sorensen.GLUCOSE] > 0.0, axis=0)
        return jnp.where(possible, infusion, jnp.nan), jnp.where(possible, state, jnp.nan)

    def derivative(self, t_min: jax.Array, x: jax.Array, inputs: Inputs) -> jax.Array:
        """Right-hand side; the patient's constants do not change with time."""
        return sorensen.derivative(self.parameters, x, inputs)

    def glucose_mg_dl(self, x: jax.Array) -> jax.Array:
        """Arterial glucose concentration G_H."""
        return x[sorensen.ARTERIAL_GLUCOSE]

    def seen_mg_dl(self, x: jax.Array, site: str) -> jax.Array:
        """Glucose at a site: arterial, or interstitial in the periphery (G_PI)."""
        return x[sorensen.STATE_NAMES.index({"arterial": "G_H", "interstitial": "G_PI"}[site])]

    def process_noise(self, glucose: float, other: float, glucagon: float) -> npt.NDArray[np.float64]:
        """Diagonal of Q `(19,)`: of the 8 glucose states, the insulin states and slow insulin effects, and glucagon."""
        return np.repeat([glucose, other, glucagon], [8, 9, 2])

    def split(self, x: jax.Array) -> tuple[jax.Array, jax.Array]:
        """State to glucose and regulation `(12, ...)`, and insulin `(7, ...)`."""
        return sorensen.split(x)

    def join(self, y: jax.Array, z: jax.Array) -> jax.Array:
        """Glucose and regulation, and insulin, back to the state."""
        return sorensen.join(y, z)

    def working_state(self) -> jax.Array:
        """Basal glucose under more insulin than basal, with the effects that it has on the liver in time.

        Errors of the integrator are largest while much insulin acts: linearising between rest and such states makes
        the worst of them a quarter of what it is when linearising at steady state.
        """
        x = self.steady_state(self.basal_insulin_mU_min)
        state: jax.Array = _at_work(self.parameters, x, self.basal_insulin_mU_min)
        return state

    def stiff_couplings(self) -> npt.NDArray[np.bool_]:
        """Mask of glucose with glucose: blood flow mixes it within minutes; its regulation acts within half an hour."""
        regulated = np.eye(sorensen.REGULATED, dtype=bool)
        regulated[sorensen.GLUCOSE, sorensen.GLUCOSE] = True
        return regulated

    def driven_derivative(self, z: jax.Array, insulin_mU_min: jax.Array) -> jax.Array:
        """Insulin balances `(7, ...)`."""
        return sorensen.insulin_balances(self.parameters, z, insulin_mU_min)

    def effects(self, z: jax.Array) -> jax.Array:
        """Effects of insulin `(4, ...)`."""
        return sorensen.insulin_effects(self.parameters, z)

    def transport(self, y: jax.Array) -> jax.Array:
        """Linear part of the glucose and regulation balances `(12, ...)`."""
        return sorensen.glucose_transport(self.parameters, y)

    def kinetics(self, y: jax.Array, effects: jax.Array, meal_mg_min: jax.Array) -> jax.Array:
        """Nonlinear part of the glucose and regulation balances `(12, ...)`."""
        return sorensen.glucose_kinetics(self.parameters, y, effects, meal_mg_min)


@jit()
def _at_work(p: SorensenParameters, x: jax.Array, basal_mU_min: jax.Array) -> jax.Array:
    """The working state, from the state at rest under the basal rate."""
    insulin = insulin_at_rest(p, _WORKING_INSULIN * basal_mU_min)
    on_production, on_uptake, *_ = sorensen.insulin_effects(p, insulin)
    production, uptake = (sorensen.STATE_NAMES.index(name) for name in ("A_IHGP", "A_IHGU"))
    return x.at[sorensen.INSULIN].set(insulin).at[production].set(on_production).at[uptake].set(on_uptake)


def _explained(x: jax.Array, lowest_mg_dl: jax.Array) -> jax.Array:
    """Whether glucose in every organ is within the bounds that follow from the minimum arterial glucose and uptake."""
    n, heavier = NOMINAL, REFERENCE_WEIGHT_KG / LIGHTEST_KG
    brain = heavier * n["brain_uptake"] / n["q_B"]
    tissue = brain + heavier * n["brain_uptake"] * n["T_B"] / n["v_BI"]
    gut = heavier * n["gut_uptake"] / n["q_G"]
    least = lowest_mg_dl - _INTEGRATION_MG_DL
    holds = (x[0] >= least - brain) & (x[1] >= least - tissue) & (x[3] >= least - gut)
    for organ in _UPTAKE_ENDS:
        holds = holds & (x[organ] >= jnp.minimum(least - gut, 0.0))
    return holds


@functools.cache
def _shared(constant: float) -> jax.Array:
    with jax.ensure_compile_time_eval():
        return jnp.asarray(constant)


def _number(value: Any) -> jax.Array:
    """A constant as JAX has it; one that all people share is made once."""
    return _shared(value) if isinstance(value, float) else jnp.asarray(value)


@checked
def at_basal(p: SorensenParameters, insulin_mU_min: jax.Array | float) -> SorensenPatient:
    """Patient whose setpoint is the glucose at steady state under the given infusion; ValueError if there is none."""
    return SorensenPatient(**SorensenPatient.rest.at_basal(p, insulin_mU_min))


@checked
def at_setpoint(p: SorensenParameters, glucose_mg_dl: jax.Array | float) -> SorensenPatient:
    """Patient whose basal rate is the one that holds the given glucose; ValueError if none does."""
    return SorensenPatient(**SorensenPatient.rest.at_setpoint(p, glucose_mg_dl))


# The paper states both 22.33 mU/min and 81 mg/dl. With the published references, which are those of a person with a
# fasting glucose of 91.89 mg/dl, no infusion gives both; with those of a fasting glucose of 81 mg/dl 22.33 mU/min does.
OPERATING_POINTS: Final[dict[str, Callable[[], SorensenPatient]]] = {
    "setpoint-81": lambda: at_setpoint(PARKER_1999, 81.1),
    "nominal-22": lambda: at_basal(PARKER_1999, 22.33),
    "fasting-81": lambda: at_basal(with_fasting_glucose(PARKER_1999, 81.0), 22.33),
}
