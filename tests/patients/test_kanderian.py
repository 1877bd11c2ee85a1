"""The ten people of Kanderian et al. (2009): basal rates as printed, and the exact solution by quadrature."""

import dataclasses

import numpy as np
import pytest
import scipy.linalg

import glucoloop as gl
from glucoloop.meals import Meal, Scenario
from glucoloop.patients import patient, population, virtual_people
from glucoloop.patients.kanderian import KanderianPatient, people
from glucoloop.patients.population import own_meals
from glucoloop.simulation import Adaptive
from glucoloop.simulation.integrators import default_integrator

TEN = population("kanderian2009", patient="kanderian-2009")
BASAL_U_H = {
    108: (1.504, 0.937, 0.755, 2.614, 0.551, 0.392, 1.059, 1.060, 1.101, 0.601),
    120: (1.321, 0.494, 0.638, 2.352, 0.301, 0.344, 0.923, 0.954, 0.860, 0.528),
    140: (1.086, None, 0.488, 2.015, None, 0.282, 0.747, 0.818, 0.550, 0.433),
}
"""Rate that holds a glucose, of each person: ``(EGP / G - GEZI) / S_I C_I`` by hand."""
LIMITS = gl.dose_limits(max_mU_min=150.0, max_change_mU_min=100.0)
DAY = Scenario([Meal(72.0, 60.0), Meal(131.0, 360.0), Meal(51.0, 720.0)], 1440.0)


def person(name, glucose_mg_dl=120.0):
    values = {parameter: each[people().names.index(name)] for parameter, each in people().values.items()}
    return KanderianPatient.resting_at(glucose_mg_dl, **values)


@pytest.mark.parametrize("glucose", BASAL_U_H)
def test_basal_rates_are_as_by_hand_to_the_printed_digits(glucose):
    people = virtual_people(TEN, 0, np.arange(10), setpoint_mg_dl=glucose)
    for rate, printed in zip(60e-3 * people.basal_insulin_mU_min, BASAL_U_H[glucose], strict=True):
        assert np.isnan(rate) if printed is None else rate == pytest.approx(printed, abs=5e-4)
    assert people.feasible.tolist() == [printed is not None for printed in BASAL_U_H[glucose]]


@pytest.mark.parametrize(("name", "highest"), [("2", "136.99"), ("5", "138.57")])
def test_who_cannot_rest_at_140_is_refused_with_what_can_be_held(name, highest):
    """Without insulin glucose rests at EGP / GEZI."""
    with pytest.raises(
        ValueError, match=rf"no insulin infusion holds glucose at 140 mg/dl; .* at most {highest} mg/dl"
    ):
        person(name, 140.0)


def exact(who, trace, meals):
    """Glucose at each sample: insulin by the matrix exponential, and the bilinear term by its integrating factor."""
    c = {name: float(value) for name, value in who.parameters.items()}
    # insulin under the skin, in plasma, its effect, the integral of the effect, and the infusion
    A = np.zeros((5, 5))
    A[0, 0], A[0, 4] = -1.0 / c["tau_1"], 1000.0 / (c["C_I"] * c["tau_1"])
    A[1, :2] = 1.0 / c["tau_2"], -1.0 / c["tau_2"]
    A[2, 1:3] = c["p_2"] * c["S_I"], -c["p_2"]
    A[3, 2] = 1.0
    nodes, weights = np.polynomial.legendre.leggauss(24)
    step = 5.0
    s = step * (nodes + 1.0) / 2.0
    at_nodes, at_end = [scipy.linalg.expm(A * node) for node in s], scipy.linalg.expm(A * step)

    def appearance(t_min):
        since = [t_min - meal.t_min for meal in meals]
        tau = c["tau_m"]
        return sum(
            1e3 * meal.carbs_g * z * np.exp(-z / tau) / tau**2 for meal, z in zip(meals, since, strict=True) if z >= 0
        )

    z = np.append(np.asarray(who.steady_state(who.basal_insulin_mU_min))[:3], [0.0, 0.0])
    glucose = [120.0]
    for k, rate in enumerate(np.asarray(trace.insulin_mU_min)):
        z[3], z[4] = 0.0, rate
        lost = [c["GEZI"] * node + (E @ z)[3] for node, E in zip(s, at_nodes, strict=True)]
        end = at_end @ z
        all_lost = c["GEZI"] * step + end[3]
        made = [c["EGP"] + appearance(step * k + node) / c["V_G"] for node in s]
        gained = (
            sum(w * np.exp(gone - all_lost) * m for w, gone, m in zip(weights, lost, made, strict=True)) * step / 2.0
        )
        glucose.append(np.exp(-all_lost) * glucose[-1] + gained)
        z = end
    return np.array(glucose)


def controlled(who, integrator):
    controller = gl.design_pid(gl.PIDTuning(0.15, 400.0, 20.0), LIMITS)
    return gl.simulate(who, controller, pump=gl.LimitedPump(limits=LIMITS), scenario=DAY, integrator=integrator)


@pytest.mark.long
@pytest.mark.parametrize("name", ["1", "2", "9"])
def test_exact_solution_is_that_of_the_reference_and_of_the_usual_integrator(name):
    who = person(name)
    for integrator, within in ((Adaptive(1e-12), 1e-8), (default_integrator(who), 1e-4)):
        trace = controlled(who, integrator)
        truth = exact(who, trace, DAY.meals)
        assert np.ptp(truth) > 50.0
        np.testing.assert_allclose(
            np.asarray(trace.glucose_mg_dl), truth[: trace.glucose_mg_dl.size], rtol=0, atol=within
        )


def test_a_meal_is_absorbed_whole_and_fastest_at_the_persons_own_time():
    gut = person("2").meal_model
    assert float(gut.bioavailability) == 1.0
    # the mean of 107, 84, 231 and 12 min, weighted by 8, 140, 18 and 20 g
    assert float(gut.time_to_maximum_min) == pytest.approx((8 * 107 + 140 * 84 + 18 * 231 + 20 * 12) / 186)


def test_the_nominal_patient_is_person_1():
    nominal = patient("kanderian-2009")
    assert 60e-3 * float(nominal.basal_insulin_mU_min) == pytest.approx(1.321, abs=5e-4)
    alone = virtual_people(TEN.alone("1"), 7, [0, 5])
    np.testing.assert_allclose(alone.basal_insulin_mU_min, nominal.basal_insulin_mU_min, rtol=1e-12)


def test_own_days_are_those_of_the_table():
    eaten = own_meals(TEN, 0, [0, 1])
    assert eaten.carbs_g.T.tolist() == [[72.0, 131.0, 51.0, 70.0], [8.0, 140.0, 18.0, 0.0]]
    assert eaten.t_min[:, 0].tolist() == [420.0, 720.0, 1080.0, 1320.0]
    assert eaten.t_min[3, 1] == 1080.0  # no meal, at the time of the last one


def test_glucose_is_seen_at_two_sites():
    who = person("1")
    x = np.array([1.0, 2.0, 0.01, 150.0, 130.0])
    assert [float(who.seen_mg_dl(x, site)) for site in who.sites] == [150.0, 130.0]
    with pytest.raises(
        ValueError, match="glucose cannot be measured at 'arm'; the known sites are: plasma, interstitial"
    ):
        who.seen_mg_dl(x, "arm")


@pytest.mark.parametrize("value", [0.0, -253.0])
def test_a_constant_that_is_not_positive_is_refused(value):
    table = dataclasses.replace(people().only(0), values={"V_G": (value,)})
    with pytest.raises(ValueError, match=rf"person '1': V_G is {value:g} but must stay above 0; give another value"):
        gl.patients.Population("one", (), "", "kanderian-2009", table)
