"""A patient of your own in twenty lines: Bergman's minimal model, with exercise and a clock.

    glucoloop run --patient bergman:Person --controller pid --exercise "40%@2h/30min"

References
----------
R. N. Bergman, Y. Z. Ider, C. R. Bowden, C. Cobelli, "Quantitative estimation of insulin sensitivity", Am. J. Physiol.
236(6), 1979. The constants are examples; so are the uptake of glucose by exercise, and its production by the clock.
"""

from __future__ import annotations

from typing import ClassVar

import jax.numpy as jnp

import glucoloop as gl
from glucoloop.patients import OdePatient
from glucoloop.patients.settings import OperatingPoint, PatientPart


class Bergman(OdePatient):
    """State: glucose (mg/dl), remote insulin (1/min), plasma insulin (mU/l)."""

    nominal: ClassVar = {"p_1": 0.02, "p_2": 0.025, "p_3": 1.3e-5, "n": 0.09, "basal_glucose": 150.0}
    near_rest = (90.0, 0.015, 25.0)
    near_basal_mU_min = 27.0
    takes_exercise = True
    insulin_sensitivity = ("p_3",)

    def derivative(self, t_min, x, inputs):
        c, (glucose, effect, insulin) = self.parameters, x
        made = c["p_1"] * c["basal_glucose"] * (1.0 + 0.1 * jnp.sin(2.0 * jnp.pi * t_min / 1440.0))
        taken_up = c["p_1"] + effect + 2e-4 * inputs.exercise_pct
        return jnp.stack(
            [
                made - taken_up * glucose + inputs.meal_mg_min / 120.0,
                c["p_3"] * insulin - c["p_2"] * effect,
                inputs.insulin_mU_min / 12.0 - c["n"] * insulin,
            ]
        )

    def glucose_mg_dl(self, x):
        return x[0]


MODEL = Bergman.model({"at-90": 90.0})


class Person(PatientPart, name="bergman:Person"):
    """A person of Bergman's model, insulin into a vein."""

    model = "bergman:MODEL"
    operating_points = (OperatingPoint("at-90", "held at 90 mg/dl by 27.7 mU/min"),)
    pulse_mU_min = 22.0


if __name__ == "__main__":
    person, controller = Bergman.resting_at(90.0), gl.design_pid(gl.PIDTuning(0.5, 150.0))
    bouts = [gl.Exercise(intensity_pct=40.0, t_min=120.0, duration_min=30.0)]
    trace = gl.simulate(person, controller, scenario=gl.Scenario([], 300.0, exercise=bouts))
    print(f"Exercise lowers glucose from 90 to {float(trace.fine_glucose_mg_dl.min()):.0f} mg/dl")
