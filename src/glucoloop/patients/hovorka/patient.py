"""The Hovorka patient at an operating point: constants, basal rate, setpoint."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, Final

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from glucoloop._pytree import pytree
from glucoloop._representation import represented
from glucoloop.arguments import checked
from glucoloop.component.routes import PUMP_OF_1999, SUBCUTANEOUS, PumpRange
from glucoloop.meals.hovorka import HovorkaGut
from glucoloop.patients.hovorka import equations
from glucoloop.patients.hovorka.equations import GLUCOSE, INSULIN, MG_DL_PER_MMOL_L, MG_PER_MMOL, HovorkaConstants
from glucoloop.patients.hovorka.rest import glucose_without_insulin_mg_dl, infusion_for, rest_at, rest_under
from glucoloop.patients.protocol import Inputs
from glucoloop.patients.resting import Rest, RestingPatient
from glucoloop.refusal import Refusal

PLASMA: Final = "plasma"
INTERSTITIAL: Final = "interstitial"


@represented
@pytree
class HovorkaPatient(RestingPatient[HovorkaConstants]):
    """A virtual person with an operating point; implements `Patient` and `SemilinearPatient`."""

    rest: ClassVar[Rest] = Rest(
        under=rest_under,
        holding=infusion_for,
        glucose_mg_dl=equations.plasma_glucose_mg_dl,
        largest_mU_min=lambda p: p.infusion_without_production_mU_min(),
        highest_mg_dl=glucose_without_insulin_mg_dl,
        beyond="the liver would make no glucose, and glucose would fall to 0 mg/dl",
    )
    insulin_route: ClassVar[str] = SUBCUTANEOUS
    usual_pump: ClassVar[PumpRange] = PUMP_OF_1999
    sites: ClassVar[tuple[str, ...]] = (PLASMA, INTERSTITIAL)
    """Sites at which glucose can be measured."""
    insulin_sensitivity: ClassVar[tuple[str, ...]] = ("S_IT", "S_ID", "S_IE")
    glucose_production: ClassVar[Mapping[str, float]] = {"EGP_0": 1.0 / MG_PER_MMOL}

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


@checked
def at_basal(p: HovorkaConstants, insulin_mU_min: jax.Array | float) -> HovorkaPatient:
    """Patient whose setpoint is the glucose that the given infusion holds; ValueError if there is none."""
    return HovorkaPatient(**HovorkaPatient.rest.at_basal(p, insulin_mU_min))


@checked
def at_setpoint(p: HovorkaConstants, glucose_mg_dl: jax.Array | float) -> HovorkaPatient:
    """Patient whose basal rate is the one that holds the given glucose; ValueError if none does."""
    return HovorkaPatient(**HovorkaPatient.rest.at_setpoint(p, glucose_mg_dl))
