"""A patient of your own: Bergman's minimal model (J. Clin. Invest. 68(6), 1981), intravenous insulin.

glucoloop run --patient bergman:Minimal --controller pid --exercise "40%@2h/30min" --rhythm visentin-2015
"""

from typing import ClassVar

import jax.numpy as jnp

from glucoloop.plugin import OdePatient, OperatingPoint, Variation


class Minimal(OdePatient):
    """Bergman's minimal model, intravenous insulin, 70 kg."""  # units: mg/dl, min, mU/l; volumes in dl and in l

    nominal: ClassVar = {"p_1": 0.02, "p_2": 0.025, "p_3": 1.3e-5, "n": 0.09, "G_0": 150.0, "V_G": 120.0, "V_I": 12.0}
    near_rest, near_basal_mU_min = (90.0, 0.015, 25.0), 27.0
    operating_points = (OperatingPoint("at-90", "held at 90 mg/dl by 27.7 mU/min", glucose_mg_dl=90.0),)
    pulse_mU_min = 20.0  # from which a model is identified
    populations: ClassVar = {"varied": "three constants, lognormal with a coefficient of variation of 25 %"}
    takes_exercise, insulin_sensitivity = True, ("p_3",)  # the constants that a rhythm changes

    def derivative(self, t_min, x, inputs):
        c, (glucose, effect, insulin) = self.parameters, x  # of one person, or of many on the last axis
        uptake = c["p_1"] + effect + 2e-4 * inputs.exercise_pct
        glucose_rate = c["p_1"] * c["G_0"] - uptake * glucose + inputs.meal_mg_min / c["V_G"]
        insulin_rate = inputs.insulin_mU_min / c["V_I"] - c["n"] * insulin
        return jnp.stack([glucose_rate, c["p_3"] * insulin - c["p_2"] * effect, insulin_rate])

    def glucose_mg_dl(self, x):
        return x[0]

    @classmethod
    def variations(cls, population):
        return [Variation(parameter=name, distribution="lognormal", spread_pct=25.0) for name in ("p_1", "p_3", "n")]


if __name__ == "__main__":
    print(f"{float(Minimal.resting_at(90.0).basal_insulin_mU_min):.1f} mU/min hold 90 mg/dl")
