"""What the body holds is what came in less what went out, over a closed loop."""

import numpy as np
import pytest

from glucoloop.control import design_linear_mpc
from glucoloop.meals import Meal, Scenario
from glucoloop.patients import OPERATING_POINTS, patient
from glucoloop.simulation import Adaptive, simulate

LOWER_MG_DL = {"setpoint-81": 0.0, "nominal-22": 0.0, "fasting-81": 91.89 - 81.0}


@pytest.mark.long
@pytest.mark.parametrize("point", OPERATING_POINTS)
def test_glucose_and_insulin_are_conserved(point, identified_81, ledger, conserved):
    scenario = Scenario([Meal(75.0, 22.2), Meal(8.0, 210.0)], 400.0)
    controller = design_linear_mpc(identified_81.model)
    trace = simulate(
        ledger(patient(operating_point=point), LOWER_MG_DL[point]),
        controller,
        scenario=scenario,
        integrator=Adaptive(1e-9),
    )
    assert np.ptp(np.asarray(trace.insulin_mU_min)) > 20.0
    glucose_mg, insulin_mU = conserved(np.asarray(trace.states))
    assert np.ptp(glucose_mg) > 2000.0
    assert np.ptp(insulin_mU) > 100.0
