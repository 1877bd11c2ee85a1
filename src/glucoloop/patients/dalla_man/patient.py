"""The patient of the simulator of 2008 (UVA/Padova): the average person of Dalla Man et al. (2007), and populations.

The spreads of the population ``lognormal`` are our own: no distribution of these constants is published.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, ClassVar, Final

from glucoloop._lazy_jax import jax, jnp
from glucoloop.component.routes import SUBCUTANEOUS
from glucoloop.meals.dalla_man import DallaManGut
from glucoloop.patients.component import OperatingPoint
from glucoloop.patients.dalla_man.equations import STATE_NAMES, UPTAKE_FALLS_BELOW_MG_DL, balances
from glucoloop.patients.dalla_man.parameters.dallaman2007 import CONSTANTS
from glucoloop.patients.ode import OdePatient
from glucoloop.patients.protocol import Inputs
from glucoloop.patients.variation import Distribution, Variation
from glucoloop.refusal import Refusal

if TYPE_CHECKING:
    from glucoloop.patients.joint import JointVariation
    from glucoloop.patients.population import Population

INTERSTITIAL: Final = "interstitial"
_VARIED: Final = ("V_mx", "k_p3", "m_1", "m_4", "p_2U", "k_d", "k_a2", "k_max", "k_min", "k_abs")
_SPREAD_CV_PCT: Final = 20.0
_WEIGHT_CV_PCT: Final = 15.0
_SHARES: Final = ("b", "d", "HE_b")
_ROUNDING: Final = 1e-9
_EFFECT: Final = STATE_NAMES.index("X")


class DallaManPatient(OdePatient, name="uva-padova-2008"):
    """The model of the UVA/Padova simulator of 2008, of Dalla Man et al. (2007); subcutaneous insulin, 78 kg.

    The gut is `DallaManGut`.
    """

    timeless: ClassVar = True
    sources = ("dallaman2007", "dallaman2007gim", "kovatchev2009")
    operating_points = (
        OperatingPoint("fasting-120", "held at 120 mg/dl by 6.99 mU/min, which is 0.419 U/h", glucose_mg_dl=120.0),
    )
    populations: ClassVar = {
        "lognormal": "ten constants, lognormal with a coefficient of variation of 20 %, and weight with 15 %",
        "simglucose": "the thirty people of the simulator, read from an installed simglucose",
    }
    # A unit moves glucose little, and readings with noise of variance 1.45 still give a gain that can be trusted.
    pulse_mU_min = 6.95
    laguerre_pole = 0.95
    laguerre_functions = 5
    of_other_packages = ("simglucose",)
    meanings: ClassVar = {constant.name: constant.meaning.partition(",")[0] for constant in CONSTANTS}
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

    @classmethod
    def population(cls, name: str) -> Population:
        """A population by its name; the thirty people of the simulator are read from an installed simglucose."""
        from glucoloop.patients.dalla_man.simglucose import NAME, people_of_simglucose

        return people_of_simglucose(cls.name) if name == NAME else super().population(name)

    @classmethod
    def variations(cls, population: str) -> tuple[Variation | JointVariation, ...]:
        """Ten constants and body weight, lognormal."""
        constants = (Variation(parameter=name, distribution="lognormal", spread_pct=_SPREAD_CV_PCT) for name in _VARIED)
        return (*constants, Variation(parameter="weight_kg", distribution="lognormal", spread_pct=_WEIGHT_CV_PCT))

    @classmethod
    def refuse_impossible(cls, varied: Mapping[str, Distribution]) -> None:
        """Refuse distributions that can make an impossible person.

        Every constant must stay above 0, what is a share below 1, and the stomach must not empty faster at its minimum.
        """
        for name, distribution in varied.items():
            if not distribution.lower > 0.0 or (name in _SHARES and not distribution.upper < 1.0):
                bound = "between 0 and 1" if name in _SHARES else "above 0"
                raise Refusal(
                    f"{name} can vary from {distribution.lower:g} to {distribution.upper:g} but must stay {bound}; "
                    "narrow its spread, or give lower and upper"
                )

    @classmethod
    def sound(cls, x: jax.Array, lowest_mg_dl: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Whether insulin and glucose of states ``(10, ...)`` are physically possible: no amount is below zero.

        The effect X may be, which is counted from basal insulin.
        """
        del lowest_mg_dl
        possible = x >= -_ROUNDING
        insulin = jnp.all(possible[3:_EFFECT], axis=0) & jnp.all(possible[_EFFECT + 1 :], axis=0)
        return insulin, jnp.all(possible[:3], axis=0)

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
