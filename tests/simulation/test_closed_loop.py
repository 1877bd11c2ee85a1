import jax
import numpy as np
import pytest

from glucoloop.control import MPCTuning, design_linear_mpc
from glucoloop.meals import Meal, Scenario
from glucoloop.sensors import white_noise
from glucoloop.simulation import simulate

SHORT = Scenario([Meal(50.0, 50.0)], 200.0)


@pytest.fixture(scope="module")
def loop(patient_81, identified_81):
    """The noisy loop over 200 min, by its key."""
    controller = design_linear_mpc(identified_81.model, MPCTuning(2, 10, 3.0, 1.0))
    return lambda key: simulate(patient_81, controller, white_noise(), scenario=SHORT, key=key)


@pytest.mark.long
def test_a_key_gives_one_trace(loop):
    first, again = loop(3), loop(jax.random.key(3))
    jax.tree.map(np.testing.assert_array_equal, first, again)


@pytest.mark.long
def test_another_key_gives_another_trace(loop):
    first, other = loop(3), loop(4)
    assert np.all(np.asarray(first.reading_mg_dl) != np.asarray(other.reading_mg_dl))
    assert np.abs(np.asarray(first.glucose_mg_dl - other.glucose_mg_dl)).max() > 0.1


@pytest.mark.long
def test_many_keys_together_are_each_alone(loop):
    keys = jax.random.split(jax.random.key(1), 4)
    together = jax.vmap(loop)(keys)
    for i, key in enumerate(keys):
        np.testing.assert_allclose(together.insulin_mU_min[i], loop(key).insulin_mU_min, rtol=1e-10, atol=1e-10)
        np.testing.assert_allclose(together.fine_glucose_mg_dl[i], loop(key).fine_glucose_mg_dl, rtol=1e-10)


def test_the_trace_is_what_happened(loop, patient_81):
    trace = loop(0)
    np.testing.assert_array_equal(trace.t_min, 5.0 * np.arange(40))
    np.testing.assert_array_equal(trace.fine_t_min, np.arange(201.0))
    np.testing.assert_array_equal(trace.glucose_mg_dl, trace.states[:-1, 2])
    np.testing.assert_allclose(trace.fine_glucose_mg_dl[:-1:5], trace.glucose_mg_dl, rtol=1e-12)
    np.testing.assert_allclose(trace.fine_glucose_mg_dl[-1], trace.states[-1, 2], rtol=1e-12)
    noise = np.asarray(trace.reading_mg_dl - trace.glucose_mg_dl)
    assert 0.5 < noise.std() < 2.0
    assert np.abs(noise).max() <= 5.0
    np.testing.assert_array_equal(np.flatnonzero(trace.carbs_g), [10])
    assert float(trace.carbs_g[10]) == 50.0
    assert np.all(np.asarray(trace.reading_valid))
    assert float(trace.basal_insulin_mU_min) == float(patient_81.basal_insulin_mU_min)
    assert float(trace.setpoint_mg_dl) == 81.1


@pytest.mark.long
def test_at_rest_without_a_meal_nothing_happens(patient_81, identified_81):
    trace = simulate(patient_81, design_linear_mpc(identified_81.model), scenario=Scenario([], 900.0))
    np.testing.assert_allclose(trace.fine_glucose_mg_dl, 81.1, rtol=1e-11)
    np.testing.assert_allclose(trace.insulin_mU_min, patient_81.basal_insulin_mU_min, rtol=1e-10)


def test_a_patient_starts_at_rest_where_he_is_asked_to(patient_81, identified_81):
    scenario = Scenario([], 900.0, initial_glucose_mg_dl=120.0)
    trace = simulate(patient_81, design_linear_mpc(identified_81.model), scenario=scenario)
    assert float(trace.glucose_mg_dl[0]) == pytest.approx(120.0, rel=1e-12)
    start = patient_81.steady_state(patient_81.insulin_for(120.0))
    np.testing.assert_allclose(trace.states[0], start, rtol=1e-13)
    assert float(trace.setpoint_mg_dl) == 81.1
    assert float(trace.glucose_mg_dl[-1]) == pytest.approx(81.1, abs=0.05)


def test_another_setpoint_is_reached_without_offset(patient_81, identified_81):
    scenario = Scenario([], 900.0, setpoint_mg_dl=100.0)
    trace = simulate(patient_81, design_linear_mpc(identified_81.model), scenario=scenario)
    assert float(trace.glucose_mg_dl[0]) == pytest.approx(81.1, rel=1e-12)
    assert float(trace.setpoint_mg_dl) == 100.0
    assert float(trace.glucose_mg_dl[-1]) == pytest.approx(100.0, abs=0.05)
    assert float(trace.insulin_mU_min[-1]) == pytest.approx(float(patient_81.insulin_for(100.0)), abs=0.05)


def test_a_start_that_no_infusion_holds_is_refused(patient_81, identified_81):
    scenario = Scenario([], 200.0, initial_glucose_mg_dl=250.0)
    with pytest.raises(ValueError, match="no insulin infusion holds glucose at 250 mg/dl"):
        simulate(patient_81, design_linear_mpc(identified_81.model), scenario=scenario)


@pytest.mark.parametrize(("horizon", "nearest"), [(602.0, 600.0), (598.0, 600.0), (1.0, 5.0)])
def test_a_horizon_that_is_not_a_whole_number_of_samples_is_refused(patient_81, script, horizon, nearest):
    with pytest.raises(ValueError, match=rf"{horizon:g} min is not a whole number .* {nearest:g} min would be"):
        simulate(patient_81, script(20.0), scenario=Scenario([], horizon))
