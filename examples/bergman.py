"""A patient of your own: Bergman's minimal model, intravenous insulin, with exercise and rhythms.

    glucoloop run --patient bergman:Minimal --controller pid --exercise "40%@2h/30min" --rhythm visentin-2015

References
----------
R. N. Bergman, L. S. Phillips, C. Cobelli, "Physiologic evaluation of factors controlling glucose tolerance in man",
J. Clin. Invest. 68(6), 1981, 1456-1467: the equations. Without insulin of the person's own, glucose rises to that at
which the liver makes as much as is taken up; volumes and rates are of the usual size for 70 kg. The uptake by exercise
is an example.
"""

from __future__ import annotations

from typing import ClassVar

import jax.numpy as jnp

import glucoloop as gl
from glucoloop.plugin import OdePatient, OperatingPoint, PatientComponent, Population, Variation

# mg/dl, min, mU/l; volumes in dl and in l
CONSTANTS = {"p_1": 0.02, "p_2": 0.025, "p_3": 1.3e-5, "n": 0.09, "glucose_alone": 150.0, "V_G": 120.0, "V_I": 12.0}


class Bergman(OdePatient):
    """State: glucose (mg/dl), effect of insulin (1/min), insulin (mU/l), of one person or of many on the last axis."""

    nominal = CONSTANTS
    near_rest = (90.0, 0.015, 25.0)
    near_basal_mU_min = 27.0
    takes_exercise = True
    insulin_sensitivity = ("p_3",)  # constants that a rhythm changes

    def derivative(self, t_min, x, inputs):
        c, (glucose, effect, insulin) = self.parameters, x
        taken_up = c["p_1"] + effect + 2e-4 * inputs.exercise_pct
        return jnp.stack(
            [
                c["p_1"] * c["glucose_alone"] - taken_up * glucose + inputs.meal_mg_min / c["V_G"],
                c["p_3"] * insulin - c["p_2"] * effect,
                inputs.insulin_mU_min / c["V_I"] - c["n"] * insulin,
            ]
        )

    def glucose_mg_dl(self, x):
        return x[0]


def populations():
    varied = (Variation(parameter=name, distribution="lognormal", spread_pct=25.0) for name in ("p_1", "p_3", "n"))
    return {"varied": Population("varied", tuple(varied), patient="bergman:Minimal")}


MODEL = Bergman.model({"at-90": 90.0}, populations)


class Minimal(PatientComponent, name="bergman:Minimal"):  # a name that is found wherever the module is
    """Bergman's minimal model, intravenous insulin, 70 kg."""

    model = "bergman:MODEL"
    operating_points = (OperatingPoint("at-90", "held at 90 mg/dl by 27.7 mU/min"),)
    populations: ClassVar = {"varied": "three constants, lognormal with a coefficient of variation of 25 %"}
    pulse_mU_min = 20.0


if __name__ == "__main__":
    person = Bergman.resting_at(90.0)
    trace = gl.simulate(person, gl.design_pid(gl.PIDTuning(0.5, 150.0, 20.0)))
    print(f"{float(person.basal_insulin_mU_min):.1f} mU/min hold {float(person.setpoint_mg_dl):.0f} mg/dl")
    print(f"After 50 g glucose is {float(trace.fine_glucose_mg_dl.max()):.0f} mg/dl at most")
