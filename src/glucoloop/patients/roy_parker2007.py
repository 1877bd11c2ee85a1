"""The minimal model with exercise of Roy and Parker (2007): intravenous insulin, 70 kg.

Exercise of intensity u, the oxygen uptake above that at rest in percent of the largest, makes the liver produce more
glucose, tissue take up more, and insulin leave faster. The liver's glycogen runs out in long exercise: once the
accumulated effort A has passed a threshold, production falls by k every minute, and recovers after exercise::

    V' = -0.8 V + 0.8 u                                 oxygen uptake above rest, %
    I' = -n I + p_4 u_1 - E                             plasma insulin, uU/ml
    X' = -p_2 X + p_3 (I - I_b)                         remote insulin, 1/min
    G' = -p_1 (G - G_b) - X G + W / V_G (P - L - U) + meal / V_G            glucose, mg/dl
    P' = a_1 V - a_2 P,   U' = a_3 V - a_4 U            production and uptake by exercise, mg/kg/min
    E' = a_5 V - a_6 E                                  removal of insulin by exercise, uU/ml/min
    A' = u in exercise;   A_TH = -1.1521 u^2 + 87.471 u                     %, min
    L' = 0 before A reaches A_TH, k from then on in exercise, -L / T_1 after it     lost production, mg/kg/min

Five points are made for an integrator of fixed steps, or beyond the paper:

- The paper sets A to 0 when exercise ends. A matters in exercise only, so here it decays then with a time constant of
  1 min: after ten minutes of rest nothing that counts is left.
- The switch at A_TH is a ramp of 4 min about its moment. L is the same before and after, and at most k / 2 mg/kg/min
  apart within, so that glucose differs by less than .01 mg/dl.
- The paper lets E take insulin that is not there. Here E falls in proportion to insulin below 1 uU/ml.
- What fades away fades to 1e-12 of its unit and not to 0, so that no number becomes subnormal, with which processors
  are slow.
- Two numbers are a person's own: where glucose rests, and the rate that goes with it. The restatement that is known
  here leaves them to its user, with 100 mg/dl and 1 U/h.

References
----------
A. Roy, R. S. Parker, "Dynamic modeling of exercise effects on plasma glucose and insulin levels", J. Diabetes Sci.
Technol. 1(3), 2007, 338-347.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, Final

from glucoloop._lazy_jax import jax, jnp
from glucoloop.meals.roy_parker import RoyParkerGut
from glucoloop.patients.component import Constant, OperatingPoint
from glucoloop.patients.ode import OdePatient
from glucoloop.patients.protocol import Inputs

PAPER: Final = "Roy and Parker 2007, J. Diabetes Sci. Technol. 1(3)"
RESTATED: Final = f"{PAPER}, default of the restatement in LoopInsighT1"

# fmt: off

CONSTANTS: Final = (
    Constant("weight_kg", 70.0, "kg", "body weight", PAPER),
    Constant("V_G", 117.0, "dl", "volume of glucose", PAPER),
    Constant("p_1", 0.035, "1/min", "effect of glucose on its own uptake", PAPER),
    Constant("p_2", 0.05, "1/min", "decay of remote insulin", PAPER),
    Constant("p_3", 2.8e-5, "1/min^2 per uU/ml", "growth of remote insulin with plasma insulin", PAPER),
    Constant("p_4", 0.098, "uU/ml per mU", "inverse of the volume of insulin", PAPER),
    Constant("n", 0.142, "1/min", "clearance of insulin", PAPER),
    Constant("a_1", 0.00158, "mg/kg/min^2 per %", "growth of production with exercise", PAPER),
    Constant("a_2", 0.056, "1/min", "decay of production by exercise", PAPER),
    Constant("a_3", 0.00195, "mg/kg/min^2 per %", "growth of uptake with exercise", PAPER),
    Constant("a_4", 0.0485, "1/min", "decay of uptake by exercise", PAPER),
    Constant("a_5", 0.00125, "uU/ml/min^2 per %", "growth of the removal of insulin with exercise", PAPER),
    Constant("a_6", 0.075, "1/min", "decay of the removal of insulin by exercise", PAPER),
    Constant("k", 0.0108, "mg/kg/min^2", "fall of production without glycogen", PAPER),
    Constant("T_1", 6.0, "min", "recovery of production after exercise", PAPER),
    Constant("G_b", 100.0, "mg/dl", "glucose at which the person rests with insulin at I_b", RESTATED),
    Constant("I_b", 0.098 * 1000.0 / 60.0 / 0.142, "uU/ml", "insulin at steady state under 1 U/h", RESTATED),
)
# fmt: on
OXYGEN_PER_MIN: Final = 0.8
THRESHOLD: Final = (-1.1521, 87.471)
RESET_MIN: Final = 1.0
SWITCH_MIN: Final = 4.0
MIN_INSULIN: Final = 1.0
FADED: Final = 1e-12


class RoyParkerPatient(OdePatient, name="roy-parker-2007"):
    """The minimal model with exercise of Roy and Parker (2007); intravenous insulin, 70 kg.

    States ``(G, X, I, V, P, U, E, L, A)``.
    """

    timeless: ClassVar = True
    sources = ("royparker2007",)
    operating_points = (
        OperatingPoint("fasting-100", "held at 100 mg/dl by 16.67 mU/min, which is 1 U/h", glucose_mg_dl=100.0),
    )
    pulse_mU_min = 16.0
    nominal: ClassVar[Mapping[str, float]] = {constant.name: constant.value for constant in CONSTANTS}
    near_rest = (100.0, 0.0, 11.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    near_basal_mU_min = 16.7
    takes_exercise: ClassVar[bool] = True
    insulin_sensitivity: ClassVar[tuple[str, ...]] = ("p_3",)
    meal_model: ClassVar[RoyParkerGut] = RoyParkerGut()

    @property
    def glucose_production(self) -> Mapping[str, jax.Array]:
        """Increase of G_b by 1 mg/kg/min of production."""
        c = self.parameters
        return {"G_b": c["weight_kg"] / c["V_G"] / c["p_1"]}

    def derivative(self, t_min: jax.Array, x: jax.Array, inputs: Inputs) -> jax.Array:
        """Rate of change of the state, per minute."""
        c, u = self.parameters, inputs.exercise_pct
        G, X, I, V, P, U, E, L, A = x
        exercising = u > 0.0
        threshold = (THRESHOLD[0] * u + THRESHOLD[1]) * u
        since_min = (A - threshold) / jnp.where(exercising, u, 1.0)
        exhausted = jnp.clip(since_min / SWITCH_MIN + 0.5, 0.0, 1.0)
        removed = E * jnp.clip(I / MIN_INSULIN, 0.0, 1.0)
        by_exercise = c["weight_kg"] * (P - L - U)
        return jnp.stack(
            [
                c["p_1"] * (c["G_b"] - G) - X * G + (by_exercise + inputs.meal_mg_min) / c["V_G"],
                c["p_3"] * (I - c["I_b"]) - c["p_2"] * X,
                c["p_4"] * inputs.insulin_mU_min - c["n"] * I - removed,
                OXYGEN_PER_MIN * (u + FADED - V),
                c["a_1"] * V - c["a_2"] * P,
                c["a_3"] * V - c["a_4"] * U,
                c["a_5"] * V - c["a_6"] * E,
                jnp.where(exercising, c["k"] * exhausted, (FADED - L) / c["T_1"]),
                jnp.where(exercising, u, (FADED - A) / RESET_MIN),
            ]
        )

    def glucose_mg_dl(self, x: jax.Array) -> jax.Array:
        """Concentration of glucose in plasma."""
        return x[0]
