"""What is told to be usual for the Hovorka patient does what it is there for."""

import numpy as np
import pytest

from glucoloop.build.designs import controller_of, identified_model
from glucoloop.meals import Meal, Scenario
from glucoloop.models.state_space import step_response
from glucoloop.simulation import linear_model, simulate
from glucoloop.situations.case import default_case
from glucoloop.situations.situation import default_situation

SITUATION = default_situation("hovorka-2004")


@pytest.fixture(scope="module")
def model():
    return identified_model(SITUATION, default_case("mpc", SITUATION), SITUATION.nominal).model


@pytest.mark.long
def test_the_identified_model_is_close_to_the_linear_one(model):
    """Glucose hardly regulates itself here: a pulse is felt for longer than the 24 hours that the model looks back."""
    samples = model.step_response.shape[0]
    truth = np.asarray(step_response(linear_model(SITUATION.nominal), samples))
    assert samples == 288
    np.testing.assert_allclose(model.step_response, truth, rtol=0.0, atol=0.12 * abs(truth[-1]))


@pytest.mark.long
@pytest.mark.parametrize(("controller", "below_mg_dl"), [("mpc", 265.0), ("pid", 265.0)])
def test_an_unannounced_meal_is_answered_without_low_glucose(model, controller, below_mg_dl):
    loop = controller_of(SITUATION, default_case(controller, SITUATION), model=model)
    trace = simulate(SITUATION.nominal, loop, scenario=Scenario([Meal(50.0, 50.0)], 1440.0))
    glucose = np.asarray(trace.fine_glucose_mg_dl)
    assert 120.0 < glucose.max() < below_mg_dl  # 291 mg/dl without a controller
    assert glucose.min() > 85.0
    assert np.mean((glucose >= 70.0) & (glucose <= 180.0)) > 0.85
