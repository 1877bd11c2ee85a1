"""The model of Kanderian et al. (2009), the Medtronic virtual patient: Bergman's effect of subcutaneous insulin.

With insulin in the subcutaneous depot and plasma ``I_sc``, ``I_p`` [uU/ml], its effect ``I_eff`` [1/min], glucose in
plasma and tissue ``G``, ``G_isf`` [mg/dl], and the appearance of glucose from meals ``R`` [mg/min]::

    I_sc'  = (ID / C_I - I_sc) / tau_1            ID: infusion in uU/min
    I_p'   = (I_sc - I_p) / tau_2
    I_eff' = p_2 (S_I I_p - I_eff)
    G'     = -(GEZI + I_eff) G + EGP + R / V_G
    G_isf' = (G - G_isf) / tau_sensor

Glucose is absorbed in two compartments with the person's own time to peak. The model has no renal loss and no
counter-regulation.

References
----------
S. S. Kanderian, S. Weinzimer, G. Voskanyan, G. M. Steil, "Identification of intraday metabolic profiles during
closed-loop glucose control in individuals with type 1 diabetes", J. Diabetes Sci. Technol. 3(5), 2009, 1047-1057.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, ClassVar, Final

from glucoloop._lazy_jax import jax, jnp
from glucoloop.component.routes import SUBCUTANEOUS
from glucoloop.meals.hovorka import HovorkaGut
from glucoloop.patients.component import OperatingPoint
from glucoloop.patients.kanderian.parameters.kanderian2009 import CONSTANTS, NOMINAL, people
from glucoloop.patients.ode import OdePatient
from glucoloop.patients.protocol import Inputs
from glucoloop.patients.variation import Distribution, refuse_not_positive
from glucoloop.refusal import Refusal

if TYPE_CHECKING:
    from glucoloop.patients.population import Population

_UU_PER_MU: Final = 1000.0
_ROUNDING: Final = 1e-9


class KanderianPatient(OdePatient, name="kanderian-2009"):
    """The ten people of Kanderian et al. (2009), the Medtronic virtual patient; subcutaneous insulin.

    States ``(I_sc, I_p, I_eff, G, G_isf)``.
    """

    timeless: ClassVar = True
    sources = ("kanderian2009",)
    operating_points = (
        OperatingPoint(
            "fasting-120", "person 1, held at 120 mg/dl by 22.0 mU/min, which is 1.32 U/h", glucose_mg_dl=120.0
        ),
    )
    populations: ClassVar = {"kanderian2009": "the ten people of Kanderian et al. (2009), by name 1 to 10"}
    pulse_mU_min = 20.0
    nominal: ClassVar = {constant.name: constant.value for constant in CONSTANTS}
    meanings: ClassVar = {constant.name: constant.meaning for constant in CONSTANTS}
    near_rest = (11.0, 11.0, 0.009, 120.0, 120.0)
    near_basal_mU_min = 22.0
    insulin_route: ClassVar[str] = SUBCUTANEOUS
    sites: ClassVar[tuple[str, ...]] = ("plasma", "interstitial")
    insulin_sensitivity: ClassVar[tuple[str, ...]] = ("S_I",)

    @classmethod
    def population(cls, name: str) -> Population:
        """The ten people."""
        from glucoloop.patients.population import Population

        return Population(name, (), cls.populations[name], cls.name, people())

    @classmethod
    def nominal_profile(cls) -> Mapping[str, float]:
        """Known fields of person 1."""
        return people().profile_of(NOMINAL)

    @classmethod
    def refuse_impossible(cls, varied: Mapping[str, Distribution]) -> None:
        """Refuse distributions of constants that are not above 0."""
        refuse_not_positive(varied)

    @classmethod
    def sound(cls, x: jax.Array, lowest_mg_dl: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Whether insulin and glucose of states ``(5, ...)`` are possible: none is below zero."""
        return jnp.all(x[:3] >= -_ROUNDING, axis=0), jnp.all(x[3:] >= -_ROUNDING, axis=0)

    @property
    def meal_model(self) -> HovorkaGut:
        """The gut: two compartments with the person's own time to peak, from which all carbohydrate is absorbed."""
        return HovorkaGut(time_to_maximum_min=self.parameters["tau_m"], bioavailability=1.0)

    @property
    def glucose_production(self) -> Mapping[str, jax.Array]:
        """Increase of EGP by 1 mg/kg/min of production."""
        c = self.parameters
        return {"EGP": c["weight_kg"] / c["V_G"]}

    def derivative(self, t_min: jax.Array, x: jax.Array, inputs: Inputs) -> jax.Array:
        """Right-hand side of the equations."""
        c, (I_sc, I_p, I_eff, G, G_isf) = self.parameters, x
        return jnp.stack(
            [
                (_UU_PER_MU * inputs.insulin_mU_min / c["C_I"] - I_sc) / c["tau_1"],
                (I_sc - I_p) / c["tau_2"],
                c["p_2"] * (c["S_I"] * I_p - I_eff),
                c["EGP"] - (c["GEZI"] + I_eff) * G + inputs.meal_mg_min / c["V_G"],
                (G - G_isf) / c["tau_sensor"],
            ]
        )

    def glucose_mg_dl(self, x: jax.Array) -> jax.Array:
        """Glucose concentration in plasma."""
        return x[3]

    def seen_mg_dl(self, x: jax.Array, site: str) -> jax.Array:
        """Glucose at one of the `sites`; ValueError for an unknown site."""
        if site not in self.sites:
            raise Refusal(f"glucose cannot be measured at {site!r}; the known sites are: {', '.join(self.sites)}")
        return x[3 + self.sites.index(site)]
