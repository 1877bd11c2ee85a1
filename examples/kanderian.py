"""A patient of your own: the model of Kanderian et al. (2009) with insulin under the skin.

    glucoloop run --patient kanderian:Person1 --controller pid

References
----------
S. S. Kanderian, S. Weinzimer, G. Voskanyan, G. M. Steil, "Identification of intraday metabolic profiles during
closed-loop glucose control in individuals with type 1 diabetes", J. Diabetes Sci. Technol. 3(5), 2009: the equations,
and the constants of person 1.
"""

from __future__ import annotations

from typing import ClassVar

import jax.numpy as jnp

import glucoloop as gl
from glucoloop.meals import HovorkaGut
from glucoloop.patients import Inputs, OdePatient, OperatingPoint, PatientPart, Population, Variation

# Constants of person 1; they may vary from person to person.
CONSTANTS = {
    "clearance_ml_min": 2010.0,
    "tau_1_min": 49.0,
    "tau_2_min": 47.0,
    "p_2": 0.0106,  # 1/min
    "sensitivity": 0.000811,  # ml/uU/min
    "GEZI": 0.0022,  # 1/min
    "EGP": 1.33,  # mg/dl/min
    "volume_dl": 253.0,
    "tau_sensor_min": 10.0,
}


class Kanderian(OdePatient):
    """State: insulin under the skin and in plasma (mU/l), its effect (1/min), glucose in plasma and in tissue (mg/dl).

    Every function works for one person and for many, who are on the last axis.
    """

    nominal = CONSTANTS
    near_rest = (11.0, 11.0, 0.009, 120.0, 120.0)
    near_basal_mU_min = 22.0
    insulin_route = "subcutaneous"  # from which the usual pump, identification and tunings follow
    sites = "plasma", "interstitial"  # where glucose can be read; the first is controlled
    meal_model = HovorkaGut(time_to_maximum_min=47.0, bioavailability=1.0)  # as after breakfast

    def derivative(self, t_min, x, inputs: Inputs):
        c, (under_skin, plasma, effect, glucose, tissue) = self.parameters, x
        infused = 1000.0 * inputs.insulin_mU_min / c["clearance_ml_min"]
        return jnp.stack(
            [
                (infused - under_skin) / c["tau_1_min"],
                (under_skin - plasma) / c["tau_2_min"],
                c["p_2"] * (c["sensitivity"] * plasma - effect),
                c["EGP"] - (c["GEZI"] + effect) * glucose + inputs.meal_mg_min / c["volume_dl"],
                (glucose - tissue) / c["tau_sensor_min"],
            ]
        )

    def glucose_mg_dl(self, x):
        return x[3]

    def seen_mg_dl(self, x, site):
        return x[{"plasma": 3, "interstitial": 4}[site]]


def populations():
    varied = [
        Variation(parameter=name, distribution="lognormal", spread_pct=25.0)
        for name in ("sensitivity", "clearance_ml_min", "tau_1_min", "EGP")
    ]
    return {"varied": Population("varied", tuple(varied), patient="kanderian:Person1")}


MODEL = Kanderian.model({"at-120": 120.0}, populations)


class Person1(PatientPart, name="kanderian:Person1"):  # a name that is found wherever the module is
    """Person 1 of Kanderian et al. (2009), insulin under the skin."""

    model = "kanderian:MODEL"
    operating_points = (OperatingPoint("at-120", "held at 120 mg/dl by 22.0 mU/min, which is 1.32 U/h"),)
    populations: ClassVar = {"varied": "four constants, lognormal with a coefficient of variation of 25 %"}
    insulin_route = "subcutaneous"
    max_change_mU_min = 100.0
    max_insulin_mU_min = 150.0
    pulse_mU_min = 20.0
    memory_min = 480.0
    laguerre_pole = 0.93
    laguerre_functions = 6


if __name__ == "__main__":
    person = Kanderian.resting_at(120.0)
    limits = gl.dose_limits(max_mU_min=150.0, max_change_mU_min=100.0)
    controller = gl.design_pid(gl.PIDTuning(0.15, 400.0, 20.0), limits)
    trace = gl.simulate(person, controller, pump=gl.pumps.LimitedPump(limits=limits))
    print(f"{60e-3 * float(person.basal_insulin_mU_min):.3f} U/h hold {float(person.setpoint_mg_dl):.0f} mg/dl")
    print(f"After 50 g glucose is {float(trace.fine_glucose_mg_dl.max()):.0f} mg/dl at most")
