"""The record of all metrics, on a run written down by hand and against NumPy."""

import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from glucoloop.control.protocol import Status
from glucoloop.metrics import summarise
from glucoloop.metrics.metric import default_results
from glucoloop.pumps.limits import DoseLimits


@pytest.fixture
def by_hand(make_trace):
    """600 min at 80 mg/dl but for half an hour at 110, ten minutes at 65 and one at 58."""
    glucose = np.full(601, 80.0)
    glucose[100:130], glucose[200:210], glucose[300] = 110.0, 65.0, 58.0
    insulin = np.full(120, 20.0)
    insulin[20:23], insulin[40] = (30.0, 45.0, 35.0), 0.0
    status = np.zeros(120, int)
    status[20:23], status[30], status[31] = Status.SATURATED, Status.NOT_CONVERGED, Status.NON_FINITE
    valid = np.ones(120, bool)
    valid[50:54] = False
    reading = glucose[:-1:5].copy()
    reading[54] = np.nan
    return make_trace(glucose, insulin, status=status, reading_valid=valid, reading_mg_dl=reading)


def test_a_run_comes_to_what_can_be_counted(by_hand):
    found = summarise(by_hand).as_dict()
    expected = {
        "undershoot_mg_dl": 22.0,
        "minimum_mg_dl": 58.0,
        "minimum_t_min": 300.0,
        "overshoot_mg_dl": 30.0,
        "peak_mg_dl": 110.0,
        "peak_t_min": 100.0,
        "settling_2pct_min": 251.0,
        "settled_2pct": True,
        "settling_5pct_min": 251.0,
        "settled_5pct": True,
        "sse": 6 * 30.0**2 + 2 * 15.0**2 + 22.0**2,
        "time_below_54_pct": 0.0,
        "time_below_60_pct": 100 / 601,
        "time_below_70_pct": 1100 / 601,
        "time_70_180_pct": 59000 / 601,
        "time_above_180_pct": 0.0,
        "time_above_250_pct": 0.0,
        "gri": 2.4 * 1100 / 601,
        "insulin_total_mU": 5.0 * (116 * 20.0 + 110.0),
        "insulin_total_variation_mU_min": 10 + 15 + 10 + 15 + 20 + 20,
        "largest_change_mU_min": 20.0,
        "rate_satisfied": False,
        "magnitude_satisfied": True,
        "glucose_satisfied": False,
        "constraints_satisfied": False,
        "samples_saturated": 3,
        "samples_missing": 5,
        "samples_not_converged": 1,
        "samples_non_finite": 1,
    }
    assert {name: found[name] for name in expected} == pytest.approx(expected)
    glucose = np.asarray(by_hand.fine_glucose_mg_dl)
    assert found["mean_mg_dl"] == pytest.approx(glucose.mean())
    assert found["cv_pct"] == pytest.approx(100 * glucose.std(ddof=1) / glucose.mean())
    assert found["gmi_pct"] == pytest.approx(3.31 + 0.02392 * glucose.mean())


def test_the_bounds_of_the_constraints_may_be_set(by_hand):
    found = summarise(by_hand, DoseLimits(max_change_mU_min=20.0), lowest_glucose_mg_dl=54.0)
    assert found.constraints_satisfied


@pytest.mark.parametrize(("meal_sample", "expected"), [(10, 551.0), (0, 601.0), (None, 601.0)])
def test_what_never_settles_takes_the_horizon_and_one(make_trace, meal_sample, expected):
    found = summarise(make_trace(np.full(601, 100.0), meal_sample=meal_sample))
    assert found.settling_2pct_min == found.settling_5pct_min == expected
    assert not found.settled_2pct
    assert not found.settled_5pct


def test_a_run_at_rest_has_settled_at_once(make_trace):
    found = summarise(make_trace(np.full(601, 80.0)))
    assert found.settling_2pct_min == found.undershoot_mg_dl == found.sse == found.cv_pct == 0.0
    assert found.constraints_satisfied


def test_the_two_bands_are_told_apart(make_trace):
    glucose = np.full(601, 80.0)
    glucose[100:300], glucose[300:] = 83.0, 80.5
    found = summarise(make_trace(glucose))
    assert (found.settling_2pct_min, found.settling_5pct_min) == (250.0, 0.0)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_run_that_left_the_numbers_has_no_numbers(make_trace, bad):
    glucose = np.full(601, 80.0)
    glucose[400:] = bad
    found = summarise(make_trace(glucose)).as_dict()
    rest_on_insulin = {"insulin_total_mU", "insulin_total_variation_mU_min", "largest_change_mU_min"}
    rest_on_insulin |= {"insulin_off_min", "longest_insulin_off_min"}
    for name, value in found.items():
        if isinstance(value, float):
            assert name in rest_on_insulin, name
    assert not any(found[name] for name in ("settled_2pct", "settled_5pct", "glucose_satisfied"))
    assert not found["constraints_satisfied"]
    assert found["samples_missing"] == 40
    json.dumps(found, allow_nan=False)


def test_insulin_that_is_not_finite_satisfies_nothing(make_trace):
    insulin = np.full(120, 20.0)
    insulin[7] = np.nan
    found = summarise(make_trace(np.full(601, 80.0), insulin))
    assert np.isnan(found.insulin_total_mU)
    assert np.isnan(found.largest_change_mU_min)
    assert not (found.rate_satisfied | found.magnitude_satisfied | found.constraints_satisfied)
    assert found.undershoot_mg_dl == 0.0


@pytest.mark.long
def test_many_people_are_summarised_as_one_by_one(make_trace):
    rng = np.random.default_rng(2)
    glucose, insulin = rng.normal(100.0, 40.0, (61, 2, 3)), rng.uniform(0.0, 40.0, (12, 2, 3))
    together = summarise(make_trace(glucose, insulin, meal_sample=2))
    for person in np.ndindex(2, 3):
        alone = summarise(make_trace(glucose[:, *person], insulin[:, *person], meal_sample=2))
        of_many = jax.tree.map(lambda values, person=person: values[person], together)
        assert of_many.as_dict() == pytest.approx(alone.as_dict())


@pytest.mark.long
def test_runs_stacked_on_a_leading_axis_can_be_mapped(make_trace):
    runs = [make_trace(np.random.default_rng(i).normal(90.0, 20.0, 61), meal_sample=i) for i in range(3)]
    mapped = jax.vmap(summarise)(jax.tree.map(lambda *values: jnp.stack(values), *runs))
    for i, run in enumerate(runs):
        one = jax.tree.map(lambda values, i=i: values[i], mapped)
        assert one.as_dict() == pytest.approx(summarise(run).as_dict())


def test_only_one_person_can_be_told_in_plain_numbers(make_trace):
    found = summarise(make_trace(np.full((61, 2), 80.0), meal_sample=2))
    with pytest.raises(ValueError, match=r"people of shape \(2,\), not of one"):
        found.as_dict()


def test_plain_numbers_are_complete_and_survive_json(by_hand):
    found = summarise(by_hand).as_dict()
    assert list(found) == [result.name for result in default_results()]
    assert json.loads(json.dumps(found)) == found
    assert {type(value) for value in found.values()} == {float, int, bool}


@settings(deadline=None, max_examples=50)
@given(
    hnp.arrays(float, 61, elements=st.floats(10.0, 500.0)),
    hnp.arrays(float, 12, elements=st.floats(0.0, 66.9)),
    st.floats(70.0, 120.0),
)
def test_what_holds_for_every_run(make_trace, glucose, insulin, setpoint):
    found = summarise(make_trace(glucose, insulin, setpoint=setpoint, meal_sample=2)).as_dict()
    assert found["undershoot_mg_dl"] == setpoint - glucose.min()
    assert found["overshoot_mg_dl"] == glucose.max() - setpoint
    assert found["time_below_54_pct"] <= found["time_below_60_pct"] <= found["time_below_70_pct"]
    assert found["time_above_250_pct"] <= found["time_above_180_pct"]
    in_all = found["time_below_70_pct"] + found["time_70_180_pct"] + found["time_above_180_pct"]
    assert in_all == pytest.approx(100.0)
    assert found["minimum_mg_dl"] <= found["mean_mg_dl"] * (1 + 1e-12)
    assert found["mean_mg_dl"] <= found["peak_mg_dl"] * (1 + 1e-12)
    assert 0.0 <= found["settling_5pct_min"] <= found["settling_2pct_min"] <= 51.0
    assert found["settled_2pct"] <= found["settled_5pct"]
    assert found["largest_change_mU_min"] <= found["insulin_total_variation_mU_min"] * (1 + 1e-12)
    assert found["glucose_satisfied"] == (glucose.min() >= 60.0) == (found["time_below_60_pct"] == 0.0)
    assert found["magnitude_satisfied"]
