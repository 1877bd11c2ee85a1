"""The patient of the simulator of 2008 (UVA/Padova) at an operating point: constants, basal rate, setpoint."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, Final

import jax

from glucoloop.component.routes import SUBCUTANEOUS
from glucoloop.meals.dalla_man import DallaManGut
from glucoloop.patients.dalla_man.equations import STATE_NAMES, UPTAKE_FALLS_BELOW_MG_DL, balances
from glucoloop.patients.dalla_man.parameters.dallaman2007 import CONSTANTS
from glucoloop.patients.ode import OdePatient
from glucoloop.patients.protocol import Inputs

INTERSTITIAL: Final = "interstitial"


class DallaManPatient(OdePatient):
    """A person with type 1 diabetes by the equations of Dalla Man et al.; the gut is `DallaManGut`."""

    nominal: ClassVar[Mapping[str, float]] = {constant.name: constant.value for constant in CONSTANTS}
    near_rest: ClassVar[tuple[float, ...]] = (225.0, 150.0, 225.0, 2.0, 1.0, 40.0, 40.0, -10.0, 40.0, 40.0)
    near_basal_mU_min: ClassVar[float] = 10.0
    insulin_route: ClassVar[str] = SUBCUTANEOUS
    sites: ClassVar[tuple[str, ...]] = ("plasma", INTERSTITIAL)
    """Sites at which glucose can be measured."""
    insulin_sensitivity: ClassVar[tuple[str, ...]] = ("k_p3", "V_mx")
    """Constants that Visentin et al. (2015) multiply, by which insulin acts on the liver and on tissue.

    k_p1 stays as it is, although it is EGP_b + k_p2 G_pb + k_p3 I_b of the person at steady state: production is then
    less suppressed by basal insulin too while sensitivity is low, as in the other families, and glucose rises. If k_p1
    followed, all that is lost would be the effect of insulin above basal, as it is on uptake, whose V_mx multiplies the
    excess over I_b.
    """
    glucose_production: ClassVar[Mapping[str, float]] = {"k_p1": 1.0}
    lowest_valid_glucose_mg_dl: ClassVar[float] = UPTAKE_FALLS_BELOW_MG_DL
    """Lower end of the valid range, below which the uptake by the brain is not the published one.

    The model has no counter-regulation: neither glucagon nor adrenaline raises production when glucose is low.
    """

    @property
    def meal_model(self) -> DallaManGut:
        """The gut with the person's own six constants."""
        c = self.parameters
        return DallaManGut(
            k_max=c["k_max"], k_min=c["k_min"], k_abs=c["k_abs"], b=c["b"], d=c["d"], bioavailability=c["f"]
        )

    def derivative(self, t_min: jax.Array, x: jax.Array, inputs: Inputs) -> jax.Array:
        """Balances of glucose and insulin ``(10, ...)``; the time makes no difference."""
        del t_min
        return balances(self.parameters, x, inputs.insulin_mU_min, inputs.meal_mg_min)

    def glucose_mg_dl(self, x: jax.Array) -> jax.Array:
        """Glucose in plasma, G_p / V_G."""
        glucose: jax.Array = x[0] / self.parameters["V_G"]
        return glucose

    def seen_mg_dl(self, x: jax.Array, site: str) -> jax.Array:
        """Glucose at a site: in the interstitium it is G_s / V_G."""
        del site
        seen: jax.Array = x[STATE_NAMES.index("G_s")] / self.parameters["V_G"]
        return seen
