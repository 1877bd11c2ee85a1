"""Metrics folded into the loop are those of the whole trace."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from glucoloop.control import Decision, MPCTuning, Status, design_linear_mpc
from glucoloop.meals import Meal, Scenario
from glucoloop.metrics import RunningMetrics, summarise
from glucoloop.metrics.running import first_meal_min
from glucoloop.pumps import Delivery
from glucoloop.pumps.limits import PARKER_1999_LIMITS, DoseLimits
from glucoloop.sensors import Reading, white_noise
from glucoloop.simulation import simulate
from glucoloop.simulation.loop import Sampled

SAMPLES, PEOPLE = 24, 3
INSIDE = (1.0, 2.0, 3.0, 4.0, 5.0)


def folded(trace, limits=PARKER_1999_LIMITS, lowest=60.0, precision="float64"):
    """What the fold makes of the samples of a trace."""
    accumulator = RunningMetrics(
        setpoint_mg_dl=trace.setpoint_mg_dl, limits=limits, lowest_glucose_mg_dl=lowest, inside_min=INSIDE
    )
    tally = _tallied(accumulator, trace)
    return accumulator.finish(
        tally,
        samples=trace.t_min.shape[0],
        sample_time_min=5.0,
        meal_t_min=np.asarray(first_meal_min(trace)),
        precision=precision,
    )


@jax.jit
def _tallied(accumulator, trace):
    fine = trace.fine_glucose_mg_dl
    happened = Sampled(
        x=trace.states[:-1],
        glucose_mg_dl=trace.glucose_mg_dl,
        reading=Reading(glucose_mg_dl=trace.reading_mg_dl, valid=trace.reading_valid),
        decision=Decision(insulin_mU_min=trace.command_mU_min, status=trace.status),
        delivery=Delivery(insulin_mU_min=trace.insulin_mU_min, reported_mU_min=trace.reported_mU_min),
        infused_mU_min=trace.insulin_mU_min + (0.0 if trace.bolus_mU is None else trace.bolus_mU / 5.0),
        lowest_valid_mg_dl=jnp.broadcast_to(trace.lowest_valid_mg_dl, trace.glucose_mg_dl.shape),
        inside_mg_dl=fine[1:].reshape(trace.t_min.shape[0], len(INSIDE), *fine.shape[1:]),
    )
    start = accumulator.init(fine[0], trace.basal_insulin_mU_min)
    return jax.lax.scan(lambda tally, e: (accumulator.step(tally, *e), None), start, (happened, trace.t_min))[0]


@pytest.fixture(scope="module")
def assert_same(by_arrays):
    """Compare the metrics of a trace with those of another computation; returns them."""

    def compare(trace, limits=PARKER_1999_LIMITS, lowest=60.0):
        expected = by_arrays(trace, limits, lowest)
        found = folded(trace, limits=limits, lowest=lowest)
        for metrics in (found, summarise(trace, limits, lowest_glucose_mg_dl=lowest)):
            assert list(metrics.names) == list(expected)
            for name, b in expected.items():
                a = np.asarray(getattr(metrics, name))
                assert a.shape == b.shape, name
                assert np.issubdtype(a.dtype, np.floating) == np.issubdtype(b.dtype, np.floating), name
                assert (a.dtype == bool) == (b.dtype == bool), name
                # a variance that is nothing but rounding is told apart by nobody
                np.testing.assert_allclose(a, b, rtol=1e-10, atol=1e-6 if name == "cv_pct" else 1e-9, err_msg=name)
        return found

    return compare


def made(make_trace, rng, **fields):
    """A run of some people up and down about the setpoint."""
    walk = 80.0 + np.cumsum(rng.normal(0.0, 4.0, (5 * SAMPLES + 1, PEOPLE)), axis=0)
    insulin = np.clip(20.0 + np.cumsum(rng.normal(0.0, 8.0, (SAMPLES, PEOPLE)), axis=0), 0.0, 70.0)
    values = {
        "status": rng.integers(0, len(Status), (SAMPLES, PEOPLE)),
        "reading_valid": rng.uniform(size=(SAMPLES, PEOPLE)) > 0.1,
        "reading_mg_dl": np.where(rng.uniform(size=(SAMPLES, PEOPLE)) > 0.9, np.nan, 80.0),
    }
    glucose = fields.pop("glucose", np.clip(walk, 20.0, 600.0))
    return make_trace(
        glucose, fields.pop("insulin", insulin), meal_sample=fields.pop("meal_sample", 5), **values | fields
    )


@pytest.mark.parametrize("seed", range(6))
def test_whatever_happened(assert_same, make_trace, seed):
    assert_same(made(make_trace, np.random.default_rng(seed)))


def test_boluses_count_in_the_total_and_are_no_change_of_the_rate(assert_same, make_trace):
    rng = np.random.default_rng(3)
    bolus = np.where(rng.uniform(size=(SAMPLES, PEOPLE)) > 0.8, 1000.0, 0.0)
    without = made(make_trace, np.random.default_rng(3))
    found = assert_same(dataclasses.replace(without, bolus_mU=jnp.asarray(bolus)))
    before = folded(without)
    np.testing.assert_allclose(found.insulin_total_mU - before.insulin_total_mU, bolus.sum(axis=0), rtol=1e-9)
    for name in ("insulin_total_variation_mU_min", "largest_change_mU_min", "rate_satisfied", "magnitude_satisfied"):
        np.testing.assert_array_equal(getattr(found, name), getattr(before, name))


def test_bounds_of_ones_own(assert_same, make_trace):
    trace = made(make_trace, np.random.default_rng(7))
    assert_same(trace, limits=DoseLimits(max_change_mU_min=40.0, min_mU_min=0.0, max_mU_min=70.0), lowest=20.0)


@settings(max_examples=40)
@given(st.integers(0, 2**32 - 1), st.sampled_from([40.0, 54.0, 60.0, 70.0, 78.4, 80.0, 81.6, 84.0, 180.0, 250.0]))
def test_on_the_edges_of_ranges_and_bands(assert_same, make_trace, seed, level):
    """Glucose that jumps between a level and just above and below it, and the setpoint."""
    rng = np.random.default_rng(seed)
    jumps = rng.choice([level, np.nextafter(level, 0.0), np.nextafter(level, 1e9), 80.0], (5 * SAMPLES + 1, PEOPLE))
    settled = rng.integers(0, 5 * SAMPLES + 1, PEOPLE)
    glucose = np.where(np.arange(5 * SAMPLES + 1)[:, None] >= settled, 80.0, jumps)
    assert_same(made(make_trace, rng, glucose=glucose))


def test_never_away_and_never_back(assert_same, make_trace):
    glucose = np.full((5 * SAMPLES + 1, PEOPLE), 80.0)
    glucose[10:, 1] = 95.0
    glucose[-1, 2] = 95.0
    found = assert_same(made(make_trace, np.random.default_rng(0), glucose=glucose))
    assert found.settled_2pct.tolist() == [True, False, False]
    assert found.settling_2pct_min.tolist() == [0.0, 121.0 - 25.0, 121.0 - 25.0]


@pytest.mark.parametrize("meal_sample", [0, 23, None])
def test_settling_counts_from_the_meal(assert_same, make_trace, meal_sample):
    assert_same(made(make_trace, np.random.default_rng(1), meal_sample=meal_sample))


@pytest.mark.parametrize("wrong", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("where", [0, 35, 37, 120])
def test_glucose_that_is_no_number_has_no_metrics(assert_same, make_trace, wrong, where):
    rng = np.random.default_rng(2)
    glucose = 80.0 + rng.normal(0.0, 10.0, (5 * SAMPLES + 1, PEOPLE))
    glucose[where:, 1] = wrong
    found = assert_same(made(make_trace, rng, glucose=glucose))
    assert np.isnan(found.minimum_mg_dl).tolist() == [False, True, False]


def test_insulin_that_is_no_number_has_no_metrics(assert_same, make_trace):
    rng = np.random.default_rng(3)
    insulin = rng.uniform(0.0, 60.0, (SAMPLES, PEOPLE))
    insulin[7, 1] = np.nan
    found = assert_same(made(make_trace, rng, insulin=insulin))
    assert np.isnan(found.insulin_total_mU).tolist() == [False, True, False]


@pytest.fixture(scope="module")
def real(patient_81, identified_81):
    """A noisy loop whose doses reach the pump's limits; three people who are one."""
    controller = design_linear_mpc(identified_81.model, MPCTuning(2, 8, 1.0, 0.0))
    scenario = Scenario([Meal(60.0, 3.0), Meal(80.0, 50.0)], 5.0 * SAMPLES)
    trace = simulate(patient_81, controller, white_noise(), scenario=scenario, key=1)
    of_all = {"t_min", "fine_t_min", "carbs_g"}
    own = {name: a for name, a in vars(trace).items() if name not in of_all}
    return dataclasses.replace(trace, **jax.tree.map(lambda a: jnp.stack([a] * PEOPLE, -1), own))


@pytest.mark.long
def test_a_noisy_run_at_the_limits(assert_same, real):
    found = assert_same(real)
    assert found.samples_saturated.min() > 5
    assert found.rate_satisfied.all()


@pytest.mark.long
def test_in_single_precision_what_is_rounded_keeps_its_limits(real):
    single = jax.tree.map(lambda a: a.astype(np.float32) if jnp.issubdtype(a.dtype, jnp.floating) else a, real)
    found, expected = folded(single, precision="float32"), summarise(real)
    for name, value in expected.by_name().items():
        a, b = np.asarray(getattr(found, name), float), np.asarray(value, float)
        np.testing.assert_allclose(a, b, rtol=1e-4, atol=1e-3, err_msg=name)
