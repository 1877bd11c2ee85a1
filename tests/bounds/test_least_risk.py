"""Doses of minimum risk: against a global search, against the other bound, and against the simulation."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import differential_evolution

import glucoloop as gl
from given_doses import GivenDoses
from glucoloop._pytree import pytree
from glucoloop.bounds import IN_ADVANCE, least_risk_doses, optimal_doses
from glucoloop.bounds.trajectory import trajectory_of
from glucoloop.metrics import summarise
from glucoloop.pumps.limits import dose_limits
from glucoloop.pumps.protocol import Delivery
from glucoloop.refusal import Refusal

DAY = gl.Scenario([gl.Meal(60.0, 422.0), gl.Meal(90.0, 720.0, eating_min=10.0)], 1200.0)


@pytree
class AnyDose:
    """A pump without limits."""

    def init(self, insulin_mU_min, key):
        return ()

    def deliver(self, state, command_mU_min, key):
        return state, Delivery(insulin_mU_min=command_mU_min, reported_mU_min=command_mU_min)


def in_range_pct(glucose):
    return 100.0 * np.mean((glucose >= 70.0) & (glucose <= 180.0))


def risk(glucose):
    """The glycemia risk index, as Klonoff et al. print it."""
    low, very_low = 100.0 * np.mean(glucose < 70.0), 100.0 * np.mean(glucose < 54.0)
    high, very_high = 100.0 * np.mean(glucose > 180.0), 100.0 * np.mean(glucose > 250.0)
    return min(100.0, 3.0 * very_low + 2.4 * (low - very_low) + 1.6 * very_high + 0.8 * (high - very_high))


@pytest.fixture(scope="module")
def known_at_start():
    return least_risk_doses(gl.patient("hovorka-2004"), DAY)


@pytest.mark.long
def test_simulation_does_what_the_plan_says(known_at_start):
    doses = jnp.asarray(known_at_start.insulin_mU_min)
    trace = gl.simulate(gl.patient("hovorka-2004"), GivenDoses(doses=doses), pump=AnyDose(), scenario=DAY)
    np.testing.assert_allclose(trace.fine_glucose_mg_dl, known_at_start.glucose_mg_dl, atol=1e-9)
    assert float(summarise(trace).gri) == pytest.approx(known_at_start.gri, abs=1e-9)


@pytest.mark.long
def test_nothing_is_done_before_a_meal_is_known(known_at_start):
    rest = gl.patient("hovorka-2004").basal_insulin_mU_min
    np.testing.assert_allclose(known_at_start.insulin_mU_min[known_at_start.t_min < 422.0], rest, rtol=1e-6)
    assert known_at_start.insulin_mU_min[85] > 5.0 * rest
    assert (known_at_start.insulin_mU_min >= 0.0).all()


@pytest.mark.long
@pytest.mark.parametrize("known_after_min", [30.0, 0.0])
def test_what_is_known_earlier_is_worth_something(known_at_start, known_after_min):
    patient = gl.patient("hovorka-2004")
    late = least_risk_doses(patient, DAY, known_after_min=known_after_min)
    advance = least_risk_doses(patient, DAY, known_after_min=IN_ADVANCE, start_mU_min=late.insulin_mU_min)
    assert advance.gri < late.gri - 1.0
    assert in_range_pct(advance.glucose_mg_dl) > in_range_pct(late.glucose_mg_dl) + 1.0
    if known_after_min:
        assert known_at_start.gri < late.gri - 1.0


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "carbs_g", "known_after_min"),
    [("hovorka-2004", 150.0, IN_ADVANCE), ("hovorka-2004", 100.0, 0.0), ("mcgill-2020", 300.0, IN_ADVANCE)],
)
def test_a_search_of_all_few_doses_finds_nothing_better(name, carbs_g, known_after_min):
    """Four doses of 90 min each, by differential evolution of the index itself."""
    patient, scenario = gl.patient(name), gl.Scenario([gl.Meal(carbs_g, 90.0)], 360.0)
    found = least_risk_doses(patient, scenario, known_after_min=known_after_min, sample_time_min=90.0)
    course = trajectory_of(patient, scenario, 90.0, [scenario.meals])
    given = np.ones(0 if known_after_min == IN_ADVANCE else 1)

    def index(doses):
        rates = course.resting_mU_min * np.concatenate([given, doses])
        return risk(course.glucose_mg_dl(rates[:, None])[:, 0])

    doses = found.insulin_mU_min[given.size :] / course.resting_mU_min
    assert index(doses) == pytest.approx(found.gri)
    best = differential_evolution(index, [(0.0, 20.0)] * doses.size, rng=1, maxiter=40, popsize=8, tol=1e-8)
    assert found.gri <= best.fun + 1.0  # the 360 points count 0.2 each if they are high


@pytest.mark.long
@pytest.mark.parametrize(("known_after_min", "initial"), [(0.0, None), (20.0, None), (0.0, 190.0)])
def test_it_is_not_worse_than_the_bound_of_a_pump_without_its_limits(known_after_min, initial):
    """`optimal_doses` minimises the largest deviation by another method; both carry the same patient."""
    patient, scenario = gl.patient(), gl.Scenario([gl.Meal(50.0, 20.0)], 240.0, initial_glucose_mg_dl=initial)
    wide = dose_limits(max_change_mU_min=1e4, min_mU_min=0.0, max_mU_min=1e4)
    plan = optimal_doses(patient, scenario, wide, known_after_min=known_after_min)
    found = least_risk_doses(patient, scenario, known_after_min=known_after_min)
    before = plan.fine_t_min <= (0.0 if initial else 20.0 + known_after_min)
    np.testing.assert_allclose(found.glucose_mg_dl[before], plan.glucose_mg_dl[before], atol=1e-3)
    assert found.gri <= risk(plan.glucose_mg_dl) + 1e-9
    assert (found.gri == 0.0) == (initial is None)


@pytest.mark.long
def test_what_it_starts_from_is_never_better():
    patient, scenario = gl.patient("hovorka-2004"), gl.Scenario([gl.Meal(100.0, 30.0)], 300.0)
    good = least_risk_doses(patient, scenario, known_after_min=IN_ADVANCE)
    for start in (good.insulin_mU_min, np.zeros(60), np.full(60, 3.0 * good.insulin_mU_min.mean())):
        course = trajectory_of(patient, scenario, 5.0, [scenario.meals])
        given = risk(course.glucose_mg_dl(start[:, None])[:, 0])
        for known_after_min in (0.0, IN_ADVANCE):
            again = least_risk_doses(patient, scenario, known_after_min=known_after_min, start_mU_min=start)
            assert again.gri <= given + 1e-9


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({"start_mU_min": np.zeros(3)}, "doses to start from have the shape"),
        ({"start_mU_min": np.full(120, -1.0)}, "a dose to start from is negative"),
        ({"start_mU_min": np.full(120, np.nan)}, "a dose to start from is negative or no number"),
        ({"known_after_min": np.nan}, "meals that are known after nan min are not possible"),
        ({"sample_time_min": -5.0}, "sample"),
        ({"scenario": gl.Scenario(warm_up_min=60.0)}, "without a warm-up"),
    ],
)
def test_what_is_not_possible_is_refused(keys, said):
    with pytest.raises(Refusal) as refused:
        least_risk_doses(gl.patient(), **keys)
    assert said in str(refused.value)
