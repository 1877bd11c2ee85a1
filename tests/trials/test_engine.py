"""The people of a trial: the same whoever else is asked for, and each of them the loop of a single run."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from glucoloop.build.designs import controller_of
from glucoloop.build.random_keys import keys_of_people
from glucoloop.build.surroundings import pump_of, sensor_of
from glucoloop.meals import Meal, Scenario
from glucoloop.meals.plan import draw_meals
from glucoloop.metrics import summarise
from glucoloop.metrics.metric import default_results
from glucoloop.patients.population import virtual_people
from glucoloop.simulation import Exponential, simulate
from glucoloop.situations.situation import configured
from glucoloop.trials import people
from glucoloop.trials.engine import prepare, run_people
from glucoloop.trials.statistics import glucose_edges, insulin_edges
from glucoloop.trials.trial import Trial

METRIC_NAMES = [result.name for result in default_results()]

NUMBERS = np.array([4, 11, 2, 4, 530, 300, 17, 902, 0])
"""With 120 mg/dl as setpoint no basal rate exists for the persons 11, 530 and 902."""
ROUNDING = 2.0**-24


@pytest.fixture(scope="module")
def trial():
    return configured(
        Trial,
        {
            "people": 1000,
            "duration_min": 100.0,
            "meals": ["40g@20min"],
            "meal_size_spread_pct": 50.0,
            "meal_time_spread_min": 15.0,
            "sensor": ["white-noise, variance=1.45", "dead-time, minutes=5"],
            "setpoint_mg_dl": 120.0,
            "controller": ["mpc-se", "basal"],
        },
    )


@pytest.fixture(scope="module")
def prepared(trial):
    return prepare(trial)


@pytest.fixture(scope="module")
def small_blocks():
    """Blocks of a few people, so that there are several."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(people._SIZES, "native", 4)
        yield


@pytest.fixture(scope="module")
def result(prepared, small_blocks):
    return run_people(prepared, "mpc-se", NUMBERS, traces=True, threads=1)


def assert_same(found, expected, places=slice(None)):
    np.testing.assert_array_equal(found.person, expected.person[places])
    np.testing.assert_array_equal(found.feasible, expected.feasible[places])
    np.testing.assert_array_equal(found.basal_insulin_mU_min, expected.basal_insulin_mU_min[places])
    for name in ("drawn", "metrics"):
        ours, theirs = getattr(found, name), getattr(expected, name)
        assert list(ours) == list(theirs)
        for key in ours:
            np.testing.assert_array_equal(ours[key], theirs[key][places], err_msg=key)
    if found.glucose_mg_dl is not None:
        np.testing.assert_array_equal(found.glucose_mg_dl, expected.glucose_mg_dl[:, places])
        np.testing.assert_array_equal(found.insulin_mU_min, expected.insulin_mU_min[:, places])


@pytest.mark.long
def test_everybody_is_the_same_to_the_bit_whoever_else_is_asked_for(prepared, result):
    order = np.random.default_rng(0).permutation(NUMBERS.size)
    for places in (order, order[:3], order[:1]):
        assert_same(run_people(prepared, "mpc-se", NUMBERS[places], traces=True, threads=1), result, places)


@pytest.mark.long
def test_threads_make_no_difference(prepared, result):
    again = run_people(prepared, "mpc-se", NUMBERS, traces=True, threads=3)
    assert_same(again, result)
    np.testing.assert_array_equal(again.glucose_counts, result.glucose_counts)
    np.testing.assert_array_equal(again.insulin_counts, result.insulin_counts)


@pytest.mark.long
def test_counts_of_parts_add_up(prepared, result):
    parts = [run_people(prepared, "mpc-se", part, threads=1) for part in (NUMBERS[:3], NUMBERS[3:])]
    for name in ("glucose_counts", "insulin_counts"):
        np.testing.assert_array_equal(sum(getattr(part, name) for part in parts), getattr(result, name))


@pytest.mark.long
def test_who_cannot_rest_is_named_and_not_counted(result):
    np.testing.assert_array_equal(result.feasible, ~np.isin(NUMBERS, [11, 530, 902]))
    np.testing.assert_array_equal(np.isfinite(result.basal_insulin_mU_min), result.feasible)
    feasible = int(result.feasible.sum())
    np.testing.assert_array_equal(result.glucose_counts.sum(axis=1), feasible)
    np.testing.assert_array_equal(result.insulin_counts.sum(axis=1), feasible)
    for name, values in result.metrics.items():
        if values.dtype.kind == "f" and "insulin" not in name:
            np.testing.assert_array_equal(np.isfinite(values), result.feasible, err_msg=name)
    for name in ("settled_2pct", "settled_5pct", "glucose_satisfied", "constraints_satisfied"):
        assert not result.metrics[name][~result.feasible].any()
    assert np.isnan(result.glucose_mg_dl[:, ~result.feasible]).all()


def test_counts_are_histograms_of_the_traces(result):
    for counts, traces, edges in (
        (result.glucose_counts, result.glucose_mg_dl, glucose_edges()),
        (result.insulin_counts, result.insulin_mU_min, insulin_edges(66.9)),
    ):
        for row, values in zip(counts, traces[:, result.feasible], strict=True):
            # A trace is rounded to float32: what lies on an edge there may have been counted on either side of it.
            fewest, most = (
                np.cumsum(np.histogram(values * np.float64(1.0 + by), edges)[0]) for by in (ROUNDING, -ROUNDING)
            )
            assert (fewest <= np.cumsum(row)).all()
            assert (np.cumsum(row) <= most).all()


def test_a_result_has_every_metric_of_everybody(result, trial):
    assert list(result.metrics) == METRIC_NAMES
    assert result.glucose_mg_dl.shape == (trial.samples + 1, NUMBERS.size)
    assert result.insulin_mU_min.shape == (trial.samples, NUMBERS.size)
    assert result.glucose_mg_dl.dtype == result.insulin_mU_min.dtype == np.float32
    assert list(result.drawn) == [v.parameter for v in trial.population.variations]
    assert {values.dtype.kind for values in result.metrics.values()} == {"f", "b", "i"}


def test_traces_are_kept_if_they_are_asked_for(prepared, result):
    without = run_people(prepared, "mpc-se", NUMBERS, threads=1)
    assert without.glucose_mg_dl is None
    assert without.insulin_mU_min is None
    assert_same(without, result)


@pytest.mark.long
def test_each_person_is_a_run_of_his_own(trial, prepared, result):
    """His constants, meal, noise and basal rate in the ordinary loop give his metrics and traces."""
    people = virtual_people(trial.population, trial.seed, NUMBERS, setpoint_mg_dl=120.0)
    meals = draw_meals(trial.plan, trial.seed, NUMBERS)
    keys = keys_of_people(trial.seed, NUMBERS)
    controller = prepared.cases["mpc-se"].controller
    for i in (0, 6):
        one = jax.tree.map(lambda a, i=i: jnp.asarray(a)[i] if jnp.ndim(a) else jnp.asarray(a, float), people.patient)
        trace = simulate(
            one,
            controller.with_basal(one.basal_insulin_mU_min),
            sensor_of(trial),
            pump_of(trial),
            Scenario([Meal(float(meals.carbs_g[0, i]), float(meals.t_min[0, i]))], 100.0, setpoint_mg_dl=120.0),
            keys[i],
            integrator=Exponential(substeps=4),
        )
        np.testing.assert_allclose(result.glucose_mg_dl[:-1, i], trace.glucose_mg_dl, rtol=0.0, atol=2e-3)
        np.testing.assert_allclose(result.insulin_mU_min[:, i], trace.insulin_mU_min, rtol=0.0, atol=2e-3)
        expected = summarise(trace)
        for name, values in result.metrics.items():
            value = float(getattr(expected, name))
            assert float(values[i]) == pytest.approx(value, rel=1e-4, abs=2e-3), name


def test_without_feedback_everybody_gets_his_basal_rate(prepared, result):
    found = run_people(prepared, "basal", NUMBERS, traces=True, threads=1)
    basal = found.basal_insulin_mU_min[found.feasible].astype(np.float32)
    np.testing.assert_allclose(
        found.insulin_mU_min[:, found.feasible], np.broadcast_to(basal, (20, basal.size)), rtol=1e-6
    )
    np.testing.assert_array_equal(found.basal_insulin_mU_min, result.basal_insulin_mU_min)
    assert np.all(found.metrics["samples_saturated"][found.feasible] == 0)


def test_what_was_prepared_last_is_kept(trial, prepared):
    assert prepare(dataclasses.replace(trial)) is prepared
    assert set(prepared.cases) == {"mpc-se", "basal"}
    assert prepared.trial.target_mg_dl == 120.0
    assert {case.loop.engine for case in prepared.cases.values()} == {"native"}


def test_controllers_are_designed_for_the_nominal_patient(trial, prepared, patient_81):
    again = controller_of(trial, trial.cases[0], patient_81)
    jax.tree.map(np.testing.assert_array_equal, again, prepared.cases["mpc-se"].controller)
    assert prepared.computed_settings == {"mpc-se": again.settled(), "basal": {}}
