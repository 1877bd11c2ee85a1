"""The equations of a person known by the settings of therapy, against SciPy and the rules of therapy."""

import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate

from glucoloop.models.profiled import GutCompartments, profiled_model
from glucoloop.models.therapy_settings import DAILY_DOSE_U, DRIFT, LOG_GAIN, WEIGHT_KG, TherapySettingsModel
from glucoloop.therapy import Profile

GUT = GutCompartments(time_to_peak_min=36.0)
EQUATIONS = TherapySettingsModel(target_mg_dl=jnp.asarray(120.0), sensor_lag_min=jnp.asarray(10.0), sample_time_min=5.0)


@pytest.fixture(scope="module")
def model():
    return profiled_model(EQUATIONS, EQUATIONS.linearised(), GUT, WEIGHT_KG)


def trajectory(model, *, bolus_U=0.0, carbs_g=0.0, minutes=300):
    """Glucose each 5 min of a person at rest after a bolus and a meal."""
    x, content, glucose = model.nominal.state, jnp.asarray([1000.0 * carbs_g, 0.0]), []
    step = model.step_of(5.0)
    for sample in range(minutes // 5):
        bolus_mU_min = 1000.0 * bolus_U / 5.0 if sample == 0 else 0.0
        flux = model.meal_gain * GUT.appearance_mg_min(content, 5.0)
        x, content = model.advance(x, model.basal_mU_min + bolus_mU_min, flux, step), GUT.after(content, 5.0)
        glucose.append(float(model.glucose_mg_dl(x)))
    return np.array(glucose)


def test_the_nominal_person_has_the_numbers_of_the_rules(model):
    assert float(model.own_correction_mg_dl_U) == pytest.approx(1800.0 / DAILY_DOSE_U, rel=0.01)
    assert float(model.own_carb_ratio_g_U) == pytest.approx(500.0 / DAILY_DOSE_U, rel=0.01)


@pytest.mark.parametrize(("basal", "ratio", "factor"), [(7.0, 22.0, 80.0), (12.0, 14.0, 51.0), (28.0, 5.0, 16.0)])
def test_a_unit_lowers_glucose_by_the_factor_and_covers_a_ratio(model, basal, ratio, factor):
    """The dose and the meal are those of the titration in the nominal person, scaled to this one."""
    person = model.with_profile(
        Profile(basal_mU_min=basal, setpoint_mg_dl=120.0, carb_ratio_g_U=ratio, correction_mg_dl_U=factor)
    )
    bolus_U = 0.06 * 12.1527777778 / float(person.insulin_gain)
    assert (120.0 - trajectory(person, bolus_U=bolus_U).min()) / bolus_U == pytest.approx(factor, rel=0.01)
    carbs_g = 50.0 / float(person.meal_gain)
    after = trajectory(person, bolus_U=carbs_g / ratio, carbs_g=carbs_g)
    assert after[-1] == pytest.approx(120.0, abs=1.0)
    # of what a meal raises glucose by without insulin, a tenth is the part that is in proportion to glucose
    small = trajectory(person, bolus_U=0.5 * carbs_g / ratio, carbs_g=0.5 * carbs_g)
    rise = trajectory(person, carbs_g=0.5 * carbs_g).max() - 120.0
    assert small[-1] == pytest.approx(120.0, abs=0.1 * rise)


def test_the_steps_follow_the_equations(model):
    """A bolus and a rise far from the operating point, with a drift and a gain, by SciPy's integrator."""
    x = np.array([30.0, 20.0, 14.0, 0.2, 0.4, 160.0, 150.0])
    found, step = jnp.asarray(x), model.step_of(5.0)
    for _ in range(24):
        found = model.advance(found, jnp.asarray(20.0), jnp.asarray(100.0), step)
    lags, (q_1, q_2, q_3) = (55.0, 55.0, 60.0), (0, 1, 2)
    u = 12.1527777778 + 20.0 - float(model.basal_mU_min)

    def slope(_, x):
        effect = 0.2 - 0.0855 * np.exp(0.4) * (x[q_3] - 12.1527777778)
        glucose = 0.5 * effect * (1.0 + x[5] / 120.0) - 0.002 * (x[5] - 120.0) + 100.0 / 107.0
        insulin = [(u - x[q_1]) / lags[0], (x[q_1] - x[q_2]) / lags[1], (x[q_2] - x[q_3]) / lags[2]]
        return [*insulin, 0.0, 0.0, glucose, (x[5] - x[6]) / 10.0]

    wanted = scipy.integrate.solve_ivp(slope, (0.0, 120.0), x, rtol=1e-10, atol=1e-10).y[:, -1]
    np.testing.assert_allclose(found, wanted, rtol=2e-3)


def test_drift_and_gain_are_no_states_of_insulin_or_of_meals(model):
    assert model.fed_states() == (5, 6)
    rates = np.asarray(EQUATIONS.derivative(EQUATIONS.state, EQUATIONS.insulin_mU_min))
    np.testing.assert_allclose(rates, 0.0, atol=1e-12)
    assert (DRIFT, LOG_GAIN) == (3, 4)
