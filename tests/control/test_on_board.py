"""Insulin and carbohydrate on board, as curves and as columns of a trace."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad

import glucoloop as gl
from glucoloop.control.loop_like import on_board, on_board_curves, rate_of_absorption
from glucoloop.situations.run import Run
from glucoloop.situations.situation import configured
from glucoloop.studies.closed_loop import close_the_loop
from glucoloop.therapy import action_per_min
from glucoloop.trials.engine import alone, prepare, run_people
from glucoloop.trials.trial import Trial

MEAL_AND_BOLUS = {
    "patient": "hovorka-2004",
    "controller": ["basal-bolus"],
    "announce_meals": True,
    "meals": ["60g@1h"],
    "duration_min": 480.0,
}


@pytest.mark.parametrize("sample_time_min", [5.0, 7.5])
def test_what_is_left_is_what_has_not_acted(sample_time_min):
    insulin, carbs = on_board_curves(sample_time_min)
    t_min = sample_time_min * np.arange(insulin.size)
    assert (insulin[t_min <= 10.0] == 1.0).all()
    assert insulin[-1] == carbs[-1] == 0.0
    for at in (1, 9, 30):
        acted, _ = quad(lambda t: float(action_per_min(t, 360.0, 75.0)), 0.0, max(t_min[at] - 10.0, 0.0))
        absorbed, _ = quad(lambda x: float(rate_of_absorption(jnp.asarray(x))), 0.0, max(t_min[at] - 10.0, 0.0) / 180.0)
        assert (insulin[at], carbs[at]) == pytest.approx((1.0 - acted, 1.0 - absorbed), abs=1e-6)


def test_amounts_add_up_and_an_own_amount_counts_from_the_next_sample_on():
    curve = np.array([1.0, 0.5, 0.25, 0.0])
    given = np.array([[0.0, 4.0], [2.0, 0.0], [0.0, 0.0], [8.0, 0.0], [0.0, 0.0]])
    assert on_board(given[:, 0], curve).tolist() == [0.0, 0.0, 1.0, 0.5, 4.0]
    assert on_board(given, curve)[:, 1].tolist() == [0.0, 2.0, 1.0, 0.0, 0.0]


@pytest.fixture(scope="module")
def trace():
    run = configured(Run, MEAL_AND_BOLUS)
    return close_the_loop(run, run.case).trace


def test_a_bolus_and_a_meal_are_on_board_from_the_next_sample_on(trace):
    table = trace.to_polars()
    insulin, carbs = table["insulin_on_board_U"].to_numpy(), table["carbs_on_board_g"].to_numpy()
    at = int(np.flatnonzero(trace.carbs_g)[0])
    bolus_U = float(trace.bolus_mU[at]) / 1000.0
    assert insulin[: at + 1] == pytest.approx(0.0, abs=1e-9)  # the basal rate counts nothing
    assert carbs[: at + 1].max() == 0.0
    assert insulin[at + 1 : at + 3] == pytest.approx(bolus_U)
    assert carbs[at + 1 : at + 3] == pytest.approx(60.0)
    assert (np.diff(insulin[at + 2 : at + 70]) < 0.0).all()
    assert carbs[at + 38] == 0.0 < carbs[at + 37]  # 190 min later


def test_a_warm_up_counts(trace):
    for samples in (14, 20):
        cut = trace.after(samples)
        assert cut.insulin_on_board_U == pytest.approx(trace.insulin_on_board_U[samples:])
        assert cut.carbs_on_board_g == pytest.approx(trace.carbs_on_board_g[samples:])


def test_the_metric_is_that_of_the_column(trace):
    metrics = gl.summarise(trace, metrics=["insulin-on-board"]).as_dict()
    on_board_U = trace.insulin_on_board_U
    assert metrics["mean_insulin_on_board_U"] == pytest.approx(on_board_U.mean())
    assert metrics["largest_insulin_on_board_U"] == pytest.approx(on_board_U.max())
    assert on_board_U.max() > 2.0
    metrics = gl.summarise(trace, metrics=["carbs-on-board"]).as_dict()
    assert metrics["mean_carbs_on_board_g"] == pytest.approx(trace.carbs_on_board_g.mean())
    assert metrics["largest_carbs_on_board_g"] == pytest.approx(60.0)


@pytest.mark.long
@pytest.mark.parametrize("spread_pct", [0.0, 30.0])
def test_carbohydrate_on_board_of_a_trial_is_that_of_the_traces(spread_pct):
    """Meals that are the same for all and meals of their own, with what is eaten against low glucose."""
    settings = {"controller": ["basal-bolus"], "patient": "hovorka-2004", "meals": ["60g@1h", "30g@3h"]}
    more = {"days": 1, "meal_size_spread_pct": spread_pct, "rescue": "carbs", "profile_error": "basal_pct=200"}
    trial = configured(Trial, {**settings, **more, "metrics": ["carbs-on-board", "rescues"], "people": 4})
    prepared = prepare(trial)
    assert {case.loop.engine for case in prepared.cases.values()} == {"native"}
    metrics = run_people(prepared, "basal-bolus", np.arange(4), threads=1).metrics
    assert metrics["rescue_carbs_g"].max() > 0.0
    for person in range(4):
        on_board_g = alone(prepared, "basal-bolus", person).carbs_on_board_g
        assert metrics["mean_carbs_on_board_g"][person] == pytest.approx(on_board_g.mean(), rel=1e-5)
        assert metrics["largest_carbs_on_board_g"][person] == pytest.approx(on_board_g.max(), rel=1e-5)


@pytest.mark.long
def test_the_metric_of_a_trial_in_native_code_is_that_of_a_constant_rate():
    """Half of the basal rate too much, so that on board is that many doses by the curve."""
    settings = {"controller": ["basal-bolus"], "patient": "hovorka-2004", "meals": [], "days": 1, "warm_up_min": 60.0}
    more = {"profile_error": "basal_pct=150", "metrics": ["insulin-on-board"], "people": 4}
    prepared = prepare(configured(Trial, {**settings, **more, "sample_time_min": 5.0}))
    assert {case.loop.engine for case in prepared.cases.values()} == {"native"}
    metrics = run_people(prepared, "basal-bolus", np.arange(4), threads=1).metrics
    rate_mU_min = metrics["insulin_total_mU"] / 1440.0
    assert np.ptp(rate_mU_min) > 0.1
    curve, _ = on_board_curves(5.0)
    by_sample = np.cumsum(np.append(0.0, curve[1:]))[np.minimum(np.arange(288), curve.size - 1)]
    on_board_U = np.outer(by_sample, 5.0 * rate_mU_min * 0.5 / 1.5) / 1000.0
    np.testing.assert_allclose(metrics["largest_insulin_on_board_U"], on_board_U.max(axis=0), rtol=1e-6)
    np.testing.assert_allclose(metrics["mean_insulin_on_board_U"], on_board_U.mean(axis=0), rtol=1e-6)


def test_insulin_into_a_vein_has_no_such_curve(patient_81):
    trace = gl.simulate(patient_81, gl.design_open_loop(20.0), scenario=gl.Scenario([gl.Meal(50.0, 10.0)], 60.0))
    assert "insulin_on_board_U" not in trace.to_polars().columns
    assert trace.to_polars()["carbs_on_board_g"][3] == 50.0
