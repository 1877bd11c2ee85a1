"""Stepping sample by sample, as a pump would, is the simulation."""

import jax
import jax.numpy as jnp
import numpy as np

from glucoloop.control import MPCTuning, Observation, design_linear_mpc
from glucoloop.meals import Meal, Scenario
from glucoloop.models.state_space import step_response
from glucoloop.pumps import LimitedPump
from glucoloop.simulation import Exponential, identify, linear_model, simulate
from glucoloop.simulation.plant import SampleGrid

SCENARIO = Scenario([Meal(50.0, 50.0), Meal(12.0, 141.3)], 300.0)


def test_stepping_in_real_time_is_the_simulation(patient_81, identified_81):
    controller, pump = design_linear_mpc(identified_81.model, MPCTuning(2, 8, 1.0, 0.0)), LimitedPump()
    trace = simulate(patient_81, controller, pump=pump, scenario=SCENARIO)

    grid = SampleGrid(sample_time_min=5.0, samples=60)
    plant, exogenous = Exponential().prepare(patient_81, SCENARIO.absorbed_by(patient_81), grid)
    decide = jax.jit(lambda state, observation: controller.step(state, observation))
    key, deliver = jax.random.key(0), jax.jit(pump.deliver)
    advance = jax.jit(lambda x, u, meal: plant.advance(x, u, meal))

    x, delivered = patient_81.steady_state(patient_81.basal_insulin_mU_min), patient_81.basal_insulin_mU_min
    in_pump, state, glucose, insulin, fine = pump.init(delivered, key), None, [], [], []
    for k in range(grid.samples):
        observation = Observation(
            glucose_mg_dl=patient_81.glucose_mg_dl(x),
            valid=jnp.asarray(True),
            setpoint_mg_dl=patient_81.setpoint_mg_dl,
            delivered_mU_min=delivered,
            announced_carbs_g=jnp.asarray(0.0),
        )
        state = controller.init(observation) if state is None else state
        state, decision = decide(state, observation)
        in_pump, delivery = deliver(in_pump, decision.insulin_mU_min, key)
        delivered = delivery.reported_mU_min
        glucose.append(observation.glucose_mg_dl)
        insulin.append(delivered)
        x, inside = advance(x, delivered, jax.tree.map(lambda part, k=k: part[k], exogenous))
        fine.append(inside)
    np.testing.assert_allclose(glucose, trace.glucose_mg_dl, rtol=1e-12)
    np.testing.assert_allclose(insulin, trace.insulin_mU_min, rtol=1e-11, atol=1e-11)
    np.testing.assert_allclose(np.concatenate(fine), trace.fine_glucose_mg_dl[1:], rtol=1e-12)
    np.testing.assert_allclose(x, trace.states[-1], rtol=1e-11)


def test_the_packaged_identification_is_the_procedure_by_hand(patient_81, identified_81):
    np.testing.assert_allclose(identify(patient_81).model.step_response, identified_81.model.step_response, rtol=1e-6)


def test_identified_and_linearised_models_tell_of_the_same_patient(patient_81, identified_81):
    linear = step_response(linear_model(patient_81), 36)
    # smoothing, and pulses as large as the basal rate, cost up to a tenth of the gain
    np.testing.assert_allclose(identified_81.model.step_response, linear, atol=0.1 * abs(float(linear[-1])))
