"""The best doses: against a linear program, against what else could be done, and against the simulation."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import linprog

import glucoloop as gl
from given_doses import GivenDoses
from glucoloop.bounds import IN_ADVANCE, optimal_doses
from glucoloop.bounds.trajectory import trajectory_of
from glucoloop.pumps.limits import PARKER_1999_LIMITS

BASAL = 25.60605734419632


@pytest.mark.long
@pytest.mark.parametrize(("known_after_min", "least", "most"), [(0.0, 0.14, 0.17), (10.0, 0.58, 0.64)])
def test_the_paper_s_meal_could_be_held_so_close(best, known_after_min, least, most):
    plan = best(known_after_min)
    assert plan.converged
    assert least < plan.bound < most
    assert plan.bound <= plan.deviation_mg_dl <= plan.bound + 0.001
    assert plan.within(PARKER_1999_LIMITS)
    before = plan.t_min < 20.0 + known_after_min
    np.testing.assert_allclose(plan.insulin_mU_min[before], BASAL, rtol=1e-12)


@pytest.mark.long
def test_simulation_does_what_the_plan_says(best, scenario):
    plan = best(10.0)
    trace = gl.simulate(gl.patient(), GivenDoses(doses=jnp.asarray(plan.insulin_mU_min)), scenario=scenario)
    np.testing.assert_allclose(trace.insulin_mU_min, plan.insulin_mU_min, atol=1e-9)
    np.testing.assert_allclose(trace.fine_glucose_mg_dl, plan.glucose_mg_dl, atol=1e-9)
    assert plan.undershoot_mg_dl == pytest.approx(81.1 - float(trace.fine_glucose_mg_dl.min()), abs=1e-9)
    assert plan.peak_mg_dl == pytest.approx(float(trace.fine_glucose_mg_dl.max()), abs=1e-9)


@pytest.mark.long
@pytest.mark.parametrize("known_after_min", [0.0, 10.0])
def test_no_allowed_change_of_the_doses_comes_closer(best, scenario, known_after_min):
    plan = best(known_after_min)
    people = 300
    rng = np.random.default_rng(1)
    n = plan.t_min.size
    # single doses, smooth bumps and all at once, of many sizes
    centre, spread = rng.uniform(0.0, n, people), 10.0 ** rng.uniform(-1.0, 1.3, people)
    bumps = np.exp(-(((np.arange(n)[:, None] - centre) / spread) ** 2))
    changes = np.where(rng.random(people) < 0.7, bumps, rng.normal(size=(n, people)))
    changes *= 10.0 ** rng.uniform(-3.0, 1.0, people) * rng.choice([-1.0, 1.0], people)
    changes[plan.t_min < 20.0 + known_after_min] = 0.0
    doses, before = plan.insulin_mU_min[:, None] + changes, np.full(people, BASAL)
    for row in doses:
        row[:] = before = np.asarray(PARKER_1999_LIMITS.clip(row, before))
    course = trajectory_of(gl.patient(), scenario, 5.0, [scenario.meals] * people)
    deviation = np.abs(course.glucose_mg_dl(doses) - 81.1).max(axis=0)
    assert deviation.min() > plan.bound - 1e-3
    assert np.mean(deviation > 1.01 * plan.deviation_mg_dl) > 0.4  # so that they did change something


@pytest.mark.long
def test_small_meal_agrees_with_a_linear_program():
    # Half a gram is little enough for the linear patient, with a model of its own for insulin.
    patient, scenario, first, n = gl.patient(), gl.Scenario([gl.Meal(0.5, 20.0)], 200.0), 6, 40
    plan = optimal_doses(patient, scenario, known_after_min=10.0)
    course = trajectory_of(patient, scenario, 5.0, [scenario.meals])
    meal = course.glucose_mg_dl(np.full((n, 1), BASAL))[:, 0] - 81.1
    model = gl.linear_model(patient, sample_time_min=1.0)
    x, impulse = np.zeros(model.Phi.shape[0]), [0.0]
    for minute in range(200):
        x = np.asarray(model.Phi) @ x + np.asarray(model.Gamma) * (minute < 5)
        impulse.append(float(np.asarray(model.C) @ x))
    response = np.zeros((201, n))
    for dose in range(first, n):
        response[5 * dose :, dose] = impulse[: 201 - 5 * dose]
    most = np.diff(np.eye(n), axis=0)
    A = np.block([[response, -np.ones((201, 1))], [-response, -np.ones((201, 1))]])
    A = np.vstack([A, np.hstack([most, np.zeros((n - 1, 1))]), np.hstack([-most, np.zeros((n - 1, 1))])])
    limits = np.full(2 * (n - 1), 16.7)
    bounds = [(0.0, 0.0)] * first + [(-BASAL, 66.9 - BASAL)] * (n - first) + [(0.0, None)]
    cost = np.append(np.zeros(n), 1.0)
    least = linprog(cost, A, np.concatenate([-meal, meal, limits]), bounds=bounds, method="highs").fun
    assert plan.bound == pytest.approx(least, rel=0.015)
    assert np.abs(meal).max() > 1.4 * least


@pytest.mark.long
def test_another_start_comes_to_the_same(best, scenario):
    start = np.random.default_rng(3).uniform(0.0, 66.9, 40)
    plan = optimal_doses(gl.patient(), scenario, known_after_min=10.0, start_mU_min=start)
    assert plan.bound == pytest.approx(best(10.0).bound, abs=1e-3)
    assert np.abs(plan.insulin_mU_min - best(10.0).insulin_mU_min).max() < 3.0


@pytest.mark.long
def test_who_knows_more_does_no_worse(best):
    bounds = [best(known).bound for known in (IN_ADVANCE, 0.0, 10.0)]
    assert bounds[0] <= bounds[1] + 1e-3 <= bounds[2]
    assert not np.allclose(best(IN_ADVANCE).insulin_mU_min[:3], BASAL, atol=1e-6)


@pytest.mark.long
@pytest.mark.parametrize("objective", ["undershoot", "peak", "sse"])
def test_other_objectives(best, scenario, objective):
    plan, middle = optimal_doses(gl.patient(), scenario, known_after_min=10.0, objective=objective), best(10.0)
    samples = slice(0, -1, 5)

    def sse(of):
        return float(((of.glucose_mg_dl[samples] - 81.1) ** 2).sum())

    assert plan.converged
    assert plan.within(PARKER_1999_LIMITS)
    if objective == "undershoot":
        assert plan.undershoot_mg_dl < 0.01
    elif objective == "peak":
        assert plan.peak_mg_dl <= middle.peak_mg_dl + 2e-3
        assert plan.undershoot_mg_dl < middle.undershoot_mg_dl
    else:
        assert sse(plan) == pytest.approx(plan.bound, rel=1e-3)
        assert sse(plan) < sse(middle)


@pytest.mark.long
def test_second_meal_changes_nothing_before_it_is_known(best):
    meals = [gl.Meal(50.0, 20.0), gl.Meal(30.0, 110.0)]
    both = optimal_doses(gl.patient(), gl.Scenario(meals, 200.0), known_after_min=10.0)
    one = best(10.0)
    before = both.t_min < 120.0
    np.testing.assert_allclose(both.insulin_mU_min[before], one.insulin_mU_min[before], rtol=1e-12)
    later, alone = both.insulin_mU_min[~before], one.insulin_mU_min[~before]
    most = later.max()  # the pump's limit, where another meal asks for no more
    assert np.all((later > alone) | (alone == most))
    assert np.any(later > alone)


def test_what_is_known_too_late_changes_no_dose(scenario):
    plan = optimal_doses(gl.patient(), scenario, known_after_min=1000.0)
    np.testing.assert_allclose(plan.insulin_mU_min, BASAL, rtol=1e-12)
    assert plan.bound == plan.deviation_mg_dl == pytest.approx(68.9, abs=0.1)


def test_who_eats_nothing_keeps_his_basal_rate():
    plan = optimal_doses(gl.patient(), gl.Scenario((), 200.0))
    np.testing.assert_allclose(plan.insulin_mU_min, BASAL, rtol=1e-12)
    assert plan.bound < 1e-9
    assert plan.converged


def test_too_little_time_is_told_as_not_converged(monkeypatch, scenario):
    from glucoloop.bounds import prox_linear

    monkeypatch.setattr(prox_linear.minimise, "__kwdefaults__", {"most_iterations": 2})
    assert not optimal_doses(gl.patient(), scenario, known_after_min=10.0).converged


@pytest.mark.parametrize(
    ("settings", "told"),
    [
        ({"objective": "glory"}, "unknown objective 'glory'; the known ones are: deviation, undershoot, peak, sse"),
        ({"undershoot_weight": 0.0}, "a weight of 0 is not possible"),
        ({"known_after_min": float("nan")}, "give a finite number of minutes"),
        ({"known_after_min": float("inf")}, "give a finite number of minutes"),
        ({"sample_time_min": 0.2}, "a plan of 1000 doses is too long"),
        ({"sample_time_min": 7.0}, "not a whole number of samples"),
    ],
)
def test_what_cannot_be_is_refused(scenario, settings, told):
    with pytest.raises(ValueError, match=told):
        optimal_doses(gl.patient(), scenario, **settings)
