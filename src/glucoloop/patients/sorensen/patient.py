"""Sorensen patient at steady state: constants, basal rate and initial state."""

from __future__ import annotations

from collections.abc import Callable
from typing import ClassVar, Final

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from glucoloop._pytree import pytree
from glucoloop._representation import represented
from glucoloop.arguments import checked
from glucoloop.patients.protocol import Inputs
from glucoloop.patients.resting import Rest, RestingPatient
from glucoloop.patients.sorensen import equations as sorensen
from glucoloop.patients.sorensen.equations import SorensenParameters
from glucoloop.patients.sorensen.parameters.parker1999 import PARKER_1999
from glucoloop.patients.sorensen.rest import infusion_for, insulin_at_rest, rest_at, rest_under
from glucoloop.patients.sorensen.varying import with_fasting_glucose

_WORKING_INSULIN: Final = 1.35
"""Insulin of the working state in basal rates, between rest and the delivery while a meal is absorbed."""


@represented
@pytree
class SorensenPatient(RestingPatient[SorensenParameters]):
    """A virtual person with an operating point; implements `Patient` and `SemilinearPatient`."""

    rest: ClassVar[Rest] = Rest(
        under=rest_under,
        holding=infusion_for,
        glucose_mg_dl=lambda p, x: x[sorensen.ARTERIAL_GLUCOSE],
        largest_mU_min=lambda p: infusion_for(p, jnp.asarray(0.0)),
        highest_mg_dl=lambda p: rest_under(p, jnp.asarray(0.0))[sorensen.ARTERIAL_GLUCOSE],
        beyond="glucose would rest at or below 0 mg/dl",
    )
    sites: ClassVar[tuple[str, ...]] = ("arterial", "interstitial")

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
        insulin = insulin_at_rest(self.parameters, _WORKING_INSULIN * self.basal_insulin_mU_min)
        on_production, on_uptake, *_ = sorensen.insulin_effects(self.parameters, insulin)
        production, uptake = (sorensen.STATE_NAMES.index(name) for name in ("A_IHGP", "A_IHGU"))
        return x.at[sorensen.INSULIN].set(insulin).at[production].set(on_production).at[uptake].set(on_uptake)

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
