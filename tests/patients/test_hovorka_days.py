"""A day of the Hovorka patient with meals and boluses, against SciPy."""

import itertools

import numpy as np
import pytest
import scipy.integrate
import scipy.optimize

from glucoloop.meals import Meal, Scenario
from glucoloop.patients.hovorka import (
    STATE_NAMES,
)
from glucoloop.simulation import Adaptive, Exponential, simulate
from hovorka_by_hand import EVERYBODY, TO_HAND, by_hand, person

DAY = Scenario([Meal(45.0, 407.3, 15.0), Meal(70.0, 733.1, 25.0), Meal(60.0, 1080.7, 20.0)], 1440.0)


def day_of_doses(patient):
    """Basal, a bolus over a sample for each meal, the last one much too large, and an hour without insulin."""
    rates = np.full(288, float(patient.basal_insulin_mU_min))
    for t, bolus in ((405, 0.8), (730, 1.5), (1080, 9.0)):
        rates[t // 5] += bolus * 1000.0 / 5.0
    rates[240:252] = 0.0
    return rates


@pytest.fixture(scope="module", params=EVERYBODY, ids=["nominal", "another", "nominal of 2010", "another of 2010"])
def day(request, script, open_pump):
    """A person, and the day by the adaptive integrator."""
    patient = person(request.param)
    doses = day_of_doses(patient)

    def live(integrator):
        return simulate(patient, script(doses), pump=open_pump, scenario=DAY, integrator=integrator)

    return request.param, patient, doses, live, live(Adaptive(1e-11))


def gut_by_hand(p, D, eaten_mg_min):
    """Rates of change of the two compartments in mmol, and the appearance in mg/min."""
    D1, D2 = D
    rates = p["A_G"] * eaten_mg_min / 180.16 - D1 / p["t_maxG"], D1 / p["t_maxG"] - D2 / p["t_maxG"]
    return np.array(rates), D2 / p["t_maxG"] * 180.16


@pytest.mark.long
def test_a_day_is_that_of_the_transcription_by_scipy(day):
    """Eleven states: those of the person and the two compartments of the gut."""
    constants, patient, doses, _, trace = day
    changes = [meal.t_min + after for meal in DAY.meals for after in (0.0, meal.eating_min)]
    x = np.append(np.asarray(patient.steady_state(patient.basal_insulin_mU_min))[TO_HAND], [0.0, 0.0])
    glucose = [120.0]
    for start, end in itertools.pairwise(np.unique(np.r_[changes, np.arange(0.0, 1445.0, 5.0)])):
        u = doses[int(start // 5.0)]
        eaten = sum(
            1000.0 * meal.carbs_g / meal.eating_min
            for meal in DAY.meals
            if meal.t_min <= start < meal.t_min + meal.eating_min - 1e-9
        )

        def rates(t, x, u=u, eaten=eaten):
            of_gut, appearing = gut_by_hand(constants, x[9:], eaten)
            return np.append(by_hand(constants, x[:9], u, appearing), of_gut)

        x = scipy.integrate.solve_ivp(rates, (start, end), x, method="DOP853", rtol=1e-10, atol=1e-10).y[:, -1]
        if end % 5.0 == 0.0:
            glucose.append(x[6] / (constants["V_G"] * constants["weight_kg"]) * 18.016)
    ours = np.append(trace.glucose_mg_dl, patient.glucose_mg_dl(trace.states[-1]))
    np.testing.assert_allclose(ours, glucose, rtol=0.0, atol=1e-6)
    np.testing.assert_allclose(np.asarray(trace.states[-1])[TO_HAND], x[:9], rtol=1e-7)
    assert constants["renal_threshold"] * 18.1 < max(glucose)
    if "uptake_half" not in constants:
        assert min(glucose) < 4.5 * 18.0  # both thresholds are crossed
        assert np.max(trace.states[:, STATE_NAMES.index("x3")]) > 1.0  # and production stops


@pytest.mark.long
@pytest.mark.parametrize(("substeps", "tolerance"), [(1, 0.05), (6, 1e-3)])
def test_the_exponential_integrator_is_as_exact_as_told(day, substeps, tolerance):
    """Glucose that crosses a threshold within a step limits the order to the second."""
    *_, live, reference = day
    trace = live(Exponential(substeps=substeps))
    np.testing.assert_allclose(trace.fine_glucose_mg_dl, reference.fine_glucose_mg_dl, rtol=0.0, atol=tolerance)
    np.testing.assert_allclose(trace.states[:, 3:], reference.states[:, 3:], rtol=1e-8, atol=1e-12)
