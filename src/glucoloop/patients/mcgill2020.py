"""The minimal model of Bergman et al. (1979) with subcutaneous insulin, as the McGill Diabetes Lab has it: 70 kg.

Insulin passes two depots. Glucose has no production by name: ``P_1 G_b`` is what enters without insulin. In exercise of
intensity u, from 0 to 1, the effect of glucose on its own uptake grows at once, and insulin acts more the longer
exercise lasts::

    S_1' = u_1 - S_1 / tau_I,   S_2' = (S_1 - S_2) / tau_I             mU
    I = S_2 / (tau_I MCR W)                                            plasma insulin, mU/l
    X' = -P_2 X + P_3 (1 + e_2 (u + h)) I                              remote insulin, 1/min
    G' = -P_1 (1 + e_1 u) G - X G + P_1 G_b + meal / V_G               glucose, mg/dl
    C' = (G - C) / tau_S                                               interstitial glucose, mg/dl
    h' = 1 / 60 in exercise                                            hours since it began; 0 outside

The program from which the constants are adapts them to a person of 0.74 U/h of basal insulin, 9.5 g/U and 3 mmol/l per
U; it sets h to 0 when exercise ends, where here it decays with a time constant of 1 min, which matters to nothing: h
acts in exercise only.

References
----------
R. N. Bergman, Y. Z. Ider, C. R. Bowden, C. Cobelli, "Quantitative estimation of insulin sensitivity", Am. J. Physiol.
236(6), 1979, E667-E677.
McGill Diabetes Lab, "Artificial Pancreas Simulator", 2020: the class BergmanPatient with the constants of patientAvg.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, Final

from glucoloop._lazy_jax import jax, jnp
from glucoloop.component.routes import SUBCUTANEOUS
from glucoloop.meals.hovorka import HovorkaGut
from glucoloop.patients.component import Constant, OperatingPoint
from glucoloop.patients.ode import OdePatient
from glucoloop.patients.protocol import Inputs
from glucoloop.refusal import Refusal
from glucoloop.units import MG_DL_PER_MMOL_L, MIN_PER_H, MU_PER_U

MCGILL: Final = "McGill Diabetes Lab 2020, Artificial Pancreas Simulator, patientAvg"
_BASAL_MU_MIN: Final = 0.53 * 70.0 * 0.48 / 24.0 * MU_PER_U / MIN_PER_H
_BASAL_INSULIN: Final = _BASAL_MU_MIN / (0.02 * 70.0)
GLUCOSE_MG_DL: Final = 6.5 * MG_DL_PER_MMOL_L

# fmt: off
# ruff: noqa: E501 (a table reads best with one value on each line)
CONSTANTS: Final = (
    Constant("weight_kg", 70.0, "kg", "body weight", MCGILL),
    Constant("tau_I", 70.0, "min", "time constant of each depot of insulin", MCGILL),
    Constant("MCR", 0.02, "l/kg/min", "clearance of insulin", MCGILL),
    Constant("P_1", 0.001, "1/min", "effect of glucose on its own uptake", MCGILL),
    Constant("P_2", 0.075, "1/min", "decay of remote insulin", MCGILL),
    Constant("P_3", 5e-5, "1/min^2 per mU/l", "growth of remote insulin with plasma insulin", MCGILL),
    Constant("V_G", 2.0, "dl/kg", "volume of glucose", MCGILL),
    Constant("G_b", GLUCOSE_MG_DL * (1.0 + 5e-5 / 0.075 * _BASAL_INSULIN / 0.001), "mg/dl", "glucose at steady state without insulin; 6.5 mmol/l under 48 % of 0.53 U/kg a day", MCGILL),
    Constant("tau_S", 10.0, "min", "delay of interstitial glucose behind plasma glucose", MCGILL),
    Constant("e_1", 2.0, "1", "effect of exercise on the uptake of glucose without insulin", MCGILL),
    Constant("e_2", 2.0, "1", "effect of exercise on the action of insulin", MCGILL),
    Constant("t_maxG", 40.0, "min", "time to the maximum of the appearance of glucose after a meal", MCGILL),
    Constant("A_G", 0.8, "1", "fraction of eaten carbohydrate that appears as glucose", MCGILL),
)
# fmt: on
RESET_MIN: Final = 1.0
FADED: Final = 1e-12
"""Hours to which h decays, so that no number becomes subnormal, with which processors are slow."""
PLASMA: Final = "plasma"
INTERSTITIAL: Final = "interstitial"


class McGillPatient(OdePatient, name="mcgill-2020"):
    """Bergman's minimal model with exercise and subcutaneous insulin, of the McGill Diabetes Lab (2020); 70 kg.

    States ``(G, X, S_1, S_2, C, h)``.
    """

    timeless: ClassVar = True
    sources = ("bergman1979", "mcgill2020")
    operating_points = (
        OperatingPoint(
            "fasting-117", "held at 117.1 mg/dl by 12.37 mU/min, which is 0.742 U/h", glucose_mg_dl=GLUCOSE_MG_DL
        ),
    )
    pulse_mU_min = 12.0
    nominal: ClassVar[Mapping[str, float]] = {constant.name: constant.value for constant in CONSTANTS}
    near_rest = (117.0, 0.006, 870.0, 870.0, 117.0, 0.0)
    near_basal_mU_min = 12.4
    insulin_route: ClassVar[str] = SUBCUTANEOUS
    sites: ClassVar[tuple[str, ...]] = (PLASMA, INTERSTITIAL)
    takes_exercise: ClassVar[bool] = True
    insulin_sensitivity: ClassVar[tuple[str, ...]] = ("P_3",)

    @property
    def meal_model(self) -> HovorkaGut:
        """Two compartments with one time constant, the person's own."""
        c = self.parameters
        return HovorkaGut(time_to_maximum_min=c["t_maxG"], bioavailability=c["A_G"])

    @property
    def glucose_production(self) -> Mapping[str, jax.Array]:
        """Increase of G_b by 1 mg/kg/min of production."""
        c = self.parameters
        return {"G_b": 1.0 / (c["V_G"] * c["P_1"])}

    def derivative(self, t_min: jax.Array, x: jax.Array, inputs: Inputs) -> jax.Array:
        """Rate of change of the state, per minute."""
        c, u = self.parameters, inputs.exercise_pct / 100.0
        G, X, S_1, S_2, C, h = x
        exercising = u > 0.0
        I = S_2 / (c["tau_I"] * c["MCR"] * c["weight_kg"])
        action = jnp.where(exercising, 1.0 + c["e_2"] * (u + h), 1.0)
        return jnp.stack(
            [
                c["P_1"] * (c["G_b"] - (1.0 + c["e_1"] * u) * G)
                - X * G
                + inputs.meal_mg_min / (c["V_G"] * c["weight_kg"]),
                c["P_3"] * action * I - c["P_2"] * X,
                inputs.insulin_mU_min - S_1 / c["tau_I"],
                (S_1 - S_2) / c["tau_I"],
                (G - C) / c["tau_S"],
                jnp.where(exercising, 1.0 / MIN_PER_H, (FADED - h) / RESET_MIN),
            ]
        )

    def glucose_mg_dl(self, x: jax.Array) -> jax.Array:
        """Concentration of glucose in plasma."""
        return x[0]

    def seen_mg_dl(self, x: jax.Array, site: str) -> jax.Array:
        """Glucose at one of the `sites`; ValueError for an unknown one."""
        if site not in self.sites:
            raise Refusal(f"glucose cannot be measured at {site!r}; the known sites are: {', '.join(self.sites)}")
        return x[0] if site == PLASMA else x[4]
