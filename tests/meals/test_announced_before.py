"""Meals that are announced some time before eating: the same meals, heard of earlier, in every loop."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from glucoloop.build.designs import controller_of
from glucoloop.build.surroundings import surroundings_of
from glucoloop.meals import Meal, Scenario
from glucoloop.simulation import simulate
from glucoloop.simulation.closed_loop import on_the_grid, sample_grid
from glucoloop.simulation.stepper import scenario_stepper, simulate_stepped
from glucoloop.situations.run import Run
from glucoloop.situations.situation import configured
from glucoloop.trials.engine import alone, prepare, run_people
from glucoloop.trials.trial import Trial

PEOPLE = np.arange(6)
HABITS = st.lists(st.sampled_from(["skipped", "unannounced", "announced-late, spread=10", "weekend"]), max_size=2)


@settings(max_examples=30, deadline=None)
@given(st.floats(0.1, 180.0), HABITS, st.integers(0, 99), st.sampled_from([0.0, 30.0]))
def test_the_same_meals_are_announced_earlier_and_nothing_else_changes(before_min, habits, seed, error_pct):
    keys = {"announce_meals": True, "habits": habits, "seed": seed, "carb_error_pct": error_pct, "days": 2}
    usual = configured(Trial, keys).drawn_days(PEOPLE)
    early = configured(Trial, keys, announce_before_min=before_min).drawn_days(PEOPLE)
    np.testing.assert_allclose(usual.announced_min - early.announced_min, before_min)
    for name in ("t_min", "carbs_g", "eating_min", "announced_g"):
        np.testing.assert_array_equal(getattr(early, name), getattr(usual, name))


@settings(max_examples=30, deadline=None)
@given(st.lists(st.tuples(st.floats(0.0, 599.0), st.floats(1.0, 90.0)), max_size=5), st.integers(0, 30))
def test_announcements_come_whole_samples_earlier_and_from_before_the_start_at_it(meals, samples):
    told = {"meals": [Meal(carbs_g, t_min) for t_min, carbs_g in meals], "horizon_min": 600.0, "announced": True}
    usual, early = Scenario(**told), Scenario(**told, announced_before_min=5.0 * samples)
    assert usual.announced_in_min is None
    assert early.announced_in_min == (5.0 * samples or None)
    grid = sample_grid(600.0, 5.0)
    at_once, ahead = (on_the_grid(scenario, grid) for scenario in (usual, early))
    np.testing.assert_array_equal(ahead.carbs_g, at_once.carbs_g)
    np.testing.assert_allclose(ahead.announced_g[0], at_once.announced_g[: samples + 1].sum())
    np.testing.assert_allclose(ahead.announced_g[1 : 120 - samples], at_once.announced_g[samples + 1 :], rtol=1e-14)


def test_a_meal_of_its_own_time_keeps_it():
    scenario = Scenario([Meal(30.0, 60.0, announced_min=40.0)], 120.0, announced=True, announced_before_min=15.0)
    assert on_the_grid(scenario, sample_grid(120.0, 5.0)).announced_g[8] == 30.0


@pytest.mark.parametrize("root", [Run, Trial])
def test_a_time_without_announcements_is_refused(root):
    with pytest.raises(ValueError, match="announce the meals"):
        configured(root, announce_before_min=15.0)


@pytest.mark.parametrize("minutes", [-1.0, 200.0, np.nan])
def test_times_out_of_bounds_are_refused(minutes):
    with pytest.raises(ValueError, match=r"announced.*before|announce"):
        Scenario(announced=True, announced_before_min=minutes)
    with pytest.raises(ValueError, match="announce"):
        configured(Run, announce_meals=True, announce_before_min=minutes)


KEYS = {"patient": "hovorka-2004", "announce_meals": True, "controller": ["basal-bolus"]}
MEALS = {"meals": ["45g@62min", "60g@5h"], "duration_min": 600.0}


@pytest.mark.long
def test_native_code_a_single_run_and_a_stepper_go_through_the_same_numbers():
    trial = configured(Trial, KEYS, **MEALS, population="boiroux2017", people=6, announce_before_min=17.0)
    prepared = prepare(trial)
    [label] = prepared.cases
    assert prepared.cases[label].loop.engine == "native"
    found = run_people(prepared, label, PEOPLE, traces=True, threads=1)
    single = alone(prepared, label, 2)
    assert single.bolus_mU is not None
    infused = single.insulin_mU_min + single.bolus_mU / 5.0
    np.testing.assert_allclose(infused, found.insulin_mU_min[:, 2], rtol=1e-6)  # traces of people are single precision
    # a meal at 62 min is told of 17 min before, at 45 min; that of 5 h at 283 min
    np.testing.assert_array_equal(np.flatnonzero(single.announced_carbs_g), [9, 56])
    np.testing.assert_array_equal(np.flatnonzero(single.bolus_mU)[0], 9)

    run = configured(Run, KEYS, **MEALS, announce_before_min=17.0)
    controller, surroundings, scenario = controller_of(run, run.case), surroundings_of(run), run.as_scenario()
    at_once = simulate(run.nominal, controller, surroundings.sensor, surroundings.pump, scenario)
    stepper = scenario_stepper(
        run.nominal, surroundings.sensor, surroundings.pump, scenario, sample_time_min=5.0, key=0
    )
    states = [controller.init(stepper.observation())]

    def decide(_, seen):
        assert float(seen.announced_in_min) == 17.0
        state, decision = controller.step(states.pop(), seen)
        states.append(state)
        return decision

    stepped = simulate_stepped(stepper, scenario, decide, gives_boluses=True)
    np.testing.assert_allclose(stepped.glucose_mg_dl, at_once.glucose_mg_dl, rtol=1e-9)


@pytest.mark.long
def test_a_bolus_before_eating_keeps_the_peak_lower():
    run = configured(Run, KEYS, **MEALS)
    controller, surroundings = controller_of(run, run.case), surroundings_of(run)
    peaks = []
    for before_min in (0.0, 15.0, 30.0):
        scenario = Scenario(
            [Meal(45.0, 62.0), Meal(60.0, 300.0)], 600.0, announced=True, announced_before_min=before_min
        )
        trace = simulate(run.nominal, controller, surroundings.sensor, surroundings.pump, scenario)
        peaks.append(float(np.max(trace.fine_glucose_mg_dl)))
    assert peaks[0] - 5.0 > peaks[1] > peaks[2] + 5.0
