"""The patient of the simulator of 2008 (UVA/Padova): the average person of Dalla Man et al. (2007), and populations.

With glucose in plasma and slow tissues G_p, G_t and in the interstitium G_s [mg/kg], insulin in plasma and liver
I_p, I_l and under the skin I_sc1, I_sc2 [pmol/kg], insulin I = I_p / V_I [pmol/l] and its effects X, I_1, I_d, in a
body of the weight BW [kg]:

    G_p'   = EGP + Ra / BW - U_ii - E - k_1 G_p + k_2 G_t       EGP = max(k_p1 - k_p2 G_p - k_p3 I_d, 0)
    G_t'   = -U_id + k_1 G_p - k_2 G_t                          U_id = (V_m0 + V_mx X) G_t / (K_m0 + G_t)
    G_s'   = k_sc (G_p - G_s)                                   E = k_e1 max(G_p - k_e2, 0)
    I_p'   = -(m_2 + m_4) I_p + m_1 I_l + k_a1 I_sc1 + k_a2 I_sc2
    I_l'   = -(m_1 + m_30) I_l + m_2 I_p                        m_30 = HE_b m_1 / (1 - HE_b)
    I_sc1' = u / BW - (k_a1 + k_d) I_sc1,    I_sc2' = k_d I_sc1 - k_a2 I_sc2
    X'     = p_2U (I - I_b - X),    I_1' = k_i (I - I_1),    I_d' = k_i (I_1 - I_d)

The uptake U_ii = F_cns by the brain does not depend on glucose, and would draw G_p below zero under an overdose. The
simulator stops a state for good once it is below zero, which also makes every such state one of rest. Here U_ii falls
in proportion to glucose below 5 mg/dl instead: no state ever goes below zero, glucose recovers, and above 5 mg/dl
nothing differs.

The constants:

- Table I of the paper lists a normal and a type 2 diabetic subject. Constants are those of the normal one; b and d are
  those of meals in that table (0.82 and 0.010), not those of the group's paper of 2006 on glucose alone.
- Body weight and basal insulin of that subject are not in the table; 78 kg and 25 pmol/l are those of the curated
  encoding of the paper at BioModels, whose other constants are those of the table.
- The paper has no subcutaneous insulin. Its kinetics are those of the group's simulation software GIM, with the
  values that the open simulator LoopInsighT1 takes from there. The delay of interstitial glucose, 10 min, is that of
  LoopInsighT1 too.
- It is our own choice to make of the normal subject a person with type 1 diabetes: the pancreas is left out, and with
  it the effect of portal insulin on the liver (k_p4), as in the simulator of 2008. No such person is published, and
  this one needs less insulin (I_b is 25 pmol/l) than the simulator's thirty people.

The spreads of the population ``lognormal`` are our own: no distribution of these constants is published.

References
----------
C. Dalla Man, R. A. Rizza, C. Cobelli, "Meal simulation model of the glucose-insulin system", IEEE Trans. Biomed. Eng.
54(10), 2007, 1740-1749.
C. Dalla Man, D. M. Raimondo, R. A. Rizza, C. Cobelli, "GIM, simulation software of meal glucose-insulin model", J.
Diabetes Sci. Technol. 1(3), 2007, 323-330.
B. P. Kovatchev, M. Breton, C. Dalla Man, C. Cobelli, "In silico preclinical trials: a proof of concept in closed-loop
control of type 1 diabetes", J. Diabetes Sci. Technol. 3(1), 2009, 44-55.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar, Final

from glucoloop._lazy_jax import jax, jnp
from glucoloop.component.routes import SUBCUTANEOUS
from glucoloop.meals.dalla_man import DallaManGut
from glucoloop.patients.component import Constant, OperatingPoint
from glucoloop.patients.ode import OdePatient
from glucoloop.patients.protocol import Inputs
from glucoloop.patients.variation import Distribution, Variation
from glucoloop.refusal import Refusal
from glucoloop.units import MU_MIN_PER_PMOL_MIN

if TYPE_CHECKING:
    from glucoloop.patients.population import Population
    from glucoloop.patients.variation import JointVariation

DALLA_MAN_2007: Final = "Dalla Man et al. 2007, IEEE Trans. Biomed. Eng. 54(10), Table I, normal subject"
GIM: Final = "Dalla Man et al. 2007 (GIM), J. Diabetes Sci. Technol. 1(3), as LoopInsighT1 has it"
LOOPINSIGHT: Final = "LoopInsighT1 (hpeuscher/loopinsight1), UVA/Padova model"
BIOMODELS: Final = f"BioModels BIOMD0000000379, after {DALLA_MAN_2007}"

# fmt: off
# ruff: noqa: E501 (a table reads best with one value on each line)
CONSTANTS: Final = (
    Constant("weight_kg", 78.0, "kg", "body weight", BIOMODELS),
    Constant("V_G", 1.88, "dl/kg", "volume of glucose", DALLA_MAN_2007),
    Constant("k_1", 0.065, "1/min", "transfer of glucose from plasma to slow tissues", DALLA_MAN_2007),
    Constant("k_2", 0.079, "1/min", "transfer of glucose from slow tissues to plasma", DALLA_MAN_2007),
    Constant("V_I", 0.05, "l/kg", "volume of insulin", DALLA_MAN_2007),
    Constant("m_1", 0.190, "1/min", "transfer of insulin from the liver to plasma", DALLA_MAN_2007),
    Constant("m_2", 0.484, "1/min", "transfer of insulin from plasma to the liver", DALLA_MAN_2007),
    Constant("m_4", 0.194, "1/min", "degradation of insulin in the periphery", DALLA_MAN_2007),
    Constant("HE_b", 0.6, "1", "share of insulin that the liver extracts", DALLA_MAN_2007),
    Constant("k_p1", 2.70, "mg/kg/min", "production of glucose by the liver, extrapolated to no glucose and no insulin", DALLA_MAN_2007),
    Constant("k_p2", 0.0021, "1/min", "effectiveness of glucose on production", DALLA_MAN_2007),
    Constant("k_p3", 0.009, "mg/kg/min per pmol/l", "effect of insulin on production", DALLA_MAN_2007),
    Constant("k_i", 0.0079, "1/min", "rate at which the effect of insulin on production follows insulin", DALLA_MAN_2007),
    Constant("F_cns", 1.0, "mg/kg/min", "uptake of glucose by brain and erythrocytes", DALLA_MAN_2007),
    Constant("V_m0", 2.50, "mg/kg/min", "maximum uptake by slow tissues under basal insulin", DALLA_MAN_2007),
    Constant("V_mx", 0.047, "mg/kg/min per pmol/l", "effect of insulin on this uptake", DALLA_MAN_2007),
    Constant("K_m0", 225.59, "mg/kg", "glucose in slow tissues at which uptake is half of its maximum", DALLA_MAN_2007),
    Constant("p_2U", 0.0331, "1/min", "rate at which the effect of insulin on uptake follows insulin", DALLA_MAN_2007),
    Constant("I_b", 25.0, "pmol/l", "basal insulin, from which the effect on uptake is counted", BIOMODELS),
    Constant("k_e1", 0.0005, "1/min", "excreted fraction of what exceeds the renal threshold", DALLA_MAN_2007),
    Constant("k_e2", 339.0, "mg/kg", "renal threshold of glucose in plasma", DALLA_MAN_2007),
    Constant("k_a1", 0.0018, "1/min", "absorption of insulin that is not yet monomeric", GIM),
    Constant("k_a2", 0.0182, "1/min", "absorption of monomeric insulin", GIM),
    Constant("k_d", 0.0164, "1/min", "dissociation of subcutaneous insulin", GIM),
    Constant("k_sc", 0.1, "1/min", "rate at which interstitial glucose follows plasma glucose, of a delay of 10 min", LOOPINSIGHT),
    Constant("k_max", 0.0558, "1/min", "largest rate of emptying of the stomach, and rate of trituration", DALLA_MAN_2007),
    Constant("k_min", 0.0080, "1/min", "smallest rate of emptying of the stomach", DALLA_MAN_2007),
    Constant("k_abs", 0.057, "1/min", "rate of absorption from the gut", DALLA_MAN_2007),
    Constant("b", 0.82, "1", "share of the meal in the stomach at which emptying is slower by half", DALLA_MAN_2007),
    Constant("d", 0.010, "1", "share of the meal in the stomach at which emptying is faster by half", DALLA_MAN_2007),
    Constant("f", 0.90, "1", "share of absorbed glucose that appears in plasma", DALLA_MAN_2007),
)
# fmt: on


STATE_NAMES: Final = ("G_p", "G_t", "G_s", "I_p", "I_l", "I_sc1", "I_sc2", "X", "I_1", "I_d")
UPTAKE_FALLS_BELOW_MG_DL: Final = 5.0
"""Glucose below which the uptake by the brain falls, so that glucose stays above zero."""


def _balances(c: Mapping[str, Any], x: jax.Array, insulin_mU_min: jax.Array, meal_mg_min: jax.Array) -> jax.Array:
    """Rate of change of the state ``(10, ...)`` per minute, in the order of `STATE_NAMES`."""
    G_p, G_t, G_s, I_p, I_l, I_sc1, I_sc2, X, I_1, I_d = x
    # what is divided by is a person's own, so that a reciprocal is found once
    per_kg, uptake_falls_below = 1.0 / c["weight_kg"], UPTAKE_FALLS_BELOW_MG_DL * c["V_G"]
    u = insulin_mU_min / MU_MIN_PER_PMOL_MIN * per_kg
    insulin = I_p * (1.0 / c["V_I"])
    EGP = jnp.maximum(c["k_p1"] - c["k_p2"] * G_p - c["k_p3"] * I_d, 0.0)
    U_ii = c["F_cns"] * jnp.minimum(G_p * (1.0 / uptake_falls_below), 1.0)
    E = c["k_e1"] * jnp.maximum(G_p - c["k_e2"], 0.0)
    U_id = (c["V_m0"] + c["V_mx"] * X) * G_t / (c["K_m0"] + G_t)
    to_tissues = c["k_1"] * G_p - c["k_2"] * G_t
    dissociates = c["k_d"] * I_sc1
    extracted = c["HE_b"] / (1.0 - c["HE_b"]) * c["m_1"]
    return jnp.stack(
        [
            EGP + meal_mg_min * per_kg - U_ii - E - to_tissues,
            to_tissues - U_id,
            c["k_sc"] * (G_p - G_s),
            c["m_1"] * I_l - (c["m_2"] + c["m_4"]) * I_p + c["k_a1"] * I_sc1 + c["k_a2"] * I_sc2,
            c["m_2"] * I_p - (c["m_1"] + extracted) * I_l,
            u - c["k_a1"] * I_sc1 - dissociates,
            dissociates - c["k_a2"] * I_sc2,
            c["p_2U"] * (insulin - c["I_b"] - X),
            c["k_i"] * (insulin - I_1),
            c["k_i"] * (I_1 - I_d),
        ]
    )


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
        from glucoloop.patients.simglucose import NAME, people_of_simglucose

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
        return _balances(self.parameters, x, inputs.insulin_mU_min, inputs.meal_mg_min)

    def glucose_mg_dl(self, x: jax.Array) -> jax.Array:
        """Glucose in plasma, G_p / V_G."""
        glucose: jax.Array = x[0] / self.parameters["V_G"]
        return glucose

    def seen_mg_dl(self, x: jax.Array, site: str) -> jax.Array:
        """Glucose at a site: in the interstitium it is G_s / V_G."""
        del site
        seen: jax.Array = x[STATE_NAMES.index("G_s")] / self.parameters["V_G"]
        return seen
