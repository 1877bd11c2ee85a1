"""PID: the textbook form until something limits the rate; then it does not wind up, and forgets no rise."""

import jax
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from glucoloop.control import PIDTuning, Status, design_pid, internal_model_tuning
from glucoloop.pumps import dose_limits
from observing import observing

WIDE = dose_limits(max_change_mU_min=1e5, max_mU_min=1e6)
TUNING = PIDTuning(0.8, 90.0, 4.0)

step = jax.jit(lambda controller, state, observation: controller.step(state, observation))
observe = observing(setpoint=100.0)


def follow(controller, readings, start, setpoints=None):
    """Doses over a row of readings; None is a missing one."""
    setpoints = np.full(len(readings), 100.0) if setpoints is None else setpoints
    state, delivered, doses, decision = None, start, [], None
    for y, r in zip(readings, setpoints, strict=True):
        seen = observe(np.nan if y is None else y, delivered, r, valid=y is not None)
        state = controller.init(seen) if state is None else state
        state, decision = step(controller, state, seen)
        delivered = float(decision.insulin_mU_min)
        doses.append(delivered)
    return np.array(doses), Status(int(decision.status))


def position_form(tuning, readings, setpoints, start):
    """Textbook form with a running sum, bumpless from the first sample."""
    y, e = np.asarray(readings), np.asarray(readings) - np.asarray(setpoints)
    slope = np.diff(y, prepend=y[0]) / 5.0
    terms = e - e[0] + np.cumsum(e) * 5.0 / tuning.integral_time_min + tuning.derivative_time_min * slope
    return start + tuning.gain_mU_min_per_mg_dl * terms


@pytest.mark.parametrize("tuning", [TUNING, PIDTuning(0.5, np.inf, 0.0), PIDTuning(2.0, 30.0, 0.0)])
@settings(max_examples=15)
@given(st.lists(st.tuples(st.floats(40.0, 300.0), st.floats(70.0, 140.0)), min_size=12, max_size=12))
def test_unsaturated_it_is_the_position_form(tuning, samples):
    readings, setpoints = np.array(samples).T
    doses, _ = follow(design_pid(tuning, WIDE), readings, 5e4, setpoints)
    np.testing.assert_allclose(doses, position_form(tuning, readings, setpoints, 5e4), rtol=1e-12)


def test_at_the_limit_it_does_not_wind_up():
    readings = np.r_[np.full(150, 60.0), 100.0, 110.0]
    doses, _ = follow(design_pid(TUNING), readings, 25.0)
    assert np.all(doses[50:150] == 0.0)
    wound = position_form(TUNING, readings, np.full(152, 100.0), 25.0)
    assert wound[-1] < -100.0  # hours away from giving insulin again
    # Nearly nothing is wanted at the limit, so the rise of 40 mg/dl counts whole, as fast as the pump can.
    np.testing.assert_allclose(doses[150:], [16.7, 33.4])


def test_noise_at_the_least_rate_brings_no_insulin_back_while_glucose_is_low():
    """Made up to the minimum rate at each fall of a reading, the integral would climb with the noise."""
    noisy = 65.0 + 6.0 * np.random.default_rng(0).standard_normal(300)
    for readings in (np.full(300, 65.0), noisy):
        doses, _ = follow(design_pid(PIDTuning(0.3, 120.0, 20.0)), readings, 10.0)
        assert doses[60:].mean() < 2.0  # 17 to 19 where the integral starts again at the minimum rate


def delivered_at_most(controller, readings, most, start):
    """Wanted and delivered rates where something after the controller gives at most a rate."""
    state, delivered, doses = controller.init(observe(readings[0], start)), start, []
    for y, limit in zip(readings, most, strict=True):
        state, decision = step(controller, state, observe(y, delivered))
        delivered = min(float(decision.insulin_mU_min), limit)
        doses.append(delivered)
    return np.array(doses)


def test_a_rise_that_a_guard_cut_is_not_forgotten_when_glucose_stays_high():
    """Every other dose is cut; the velocity form lost each rise and kept each fall."""
    readings = 200.0 + 10.0 * (np.arange(200) % 2)
    cut = np.where(np.arange(200) % 2 == 1, 7.0, 1e6)
    doses = delivered_at_most(design_pid(PIDTuning(0.1, 400.0)), readings, cut, 7.0)
    assert np.all(np.diff(doses[0::2]) >= 0.0)
    assert doses[-2] > 7.0 + 0.9 * 100 * 110.0 * 0.1 * 5.0 / 400.0  # the integral of the samples after uncut ones


def test_a_cut_that_lasts_winds_nothing_up():
    readings = np.r_[np.full(200, 200.0), np.full(60, 95.0)]
    doses = delivered_at_most(design_pid(PIDTuning(0.1, 400.0)), readings, np.full(260, 8.0), 7.0)
    np.testing.assert_allclose(doses[10:200], 8.0)
    assert np.all(doses[200:] < 1.0)  # the proportional part is gone at once, and with it most of the rate


def test_a_pump_that_rounds_holds_no_integral_up():
    controller, state, delivered = design_pid(PIDTuning(0.1, 400.0)), None, 7.0
    for _ in range(60):
        seen = observe(110.0, delivered)
        state = controller.init(seen) if state is None else state
        state, decision = step(controller, state, seen)
        delivered = 0.5 * np.floor(float(decision.insulin_mU_min) / 0.5)
    assert delivered == 0.5 * np.floor((7.0 + 60 * 0.1 * 5.0 / 400.0 * 10.0) / 0.5 + 1e-9)


# ---------------------------------------------------------------------------------------------- missing readings


def test_without_a_reading_no_move_is_made_and_the_next_one_spans_the_gap():
    tuning = PIDTuning(0.8, np.inf)
    doses, _ = follow(design_pid(tuning, WIDE), [110.0, None, None, 125.0], 25.0)
    np.testing.assert_allclose(doses, [25.0, 25.0, 25.0, 25.0 + 0.8 * 15.0])
    _, status = follow(design_pid(tuning), [110.0, None], 25.0)
    assert status is Status.READING_MISSING


def test_a_setpoint_that_changes_during_a_gap_is_not_forgotten():
    tuning = PIDTuning(0.8, np.inf)
    doses, _ = follow(design_pid(tuning, WIDE), [110.0, None, 110.0], 25.0, [100.0, 90.0, 90.0])
    np.testing.assert_allclose(doses, [25.0, 25.0, 33.0])


def test_the_first_reading_may_be_missing():
    doses, status = follow(design_pid(PIDTuning(0.8, np.inf), WIDE), [None, None, 100.0, 105.0], 25.0)
    np.testing.assert_allclose(doses, [25.0, 25.0, 25.0, 29.0])
    assert status is Status.OK


# ---------------------------------------------------------------------------------------------- tuning


@pytest.mark.parametrize(
    ("gain", "tau", "delay", "closed"), [(-3.45, 89.1, 5.0, 30.0), (-2.0, 50.0, 0.0, 20.0), (-4.0, 60.0, 20.0, 45.0)]
)
def test_the_internal_model_tuning_is_the_published_one(gain, tau, delay, closed):
    """Rivera, Morari and Skogestad (1986): K K_c = (2 tau + d) / (2 lambda + d), T_I = tau + d/2, T_D = tau d / ..."""
    tuning = internal_model_tuning(gain, tau, delay, closed)
    assert -gain * tuning.gain_mU_min_per_mg_dl == pytest.approx((2 * tau + delay) / (2 * closed + delay))
    assert tuning.integral_time_min == pytest.approx(tau + delay / 2)
    assert tuning.derivative_time_min == pytest.approx(tau * delay / (2 * tau + delay))


def test_on_a_first_order_plant_the_closed_loop_has_the_time_constant_asked_for():
    """In the limit of a short sample: what is left of a step of the setpoint is exp(-t / closed_loop)."""
    T, gain, tau, closed = 0.05, -3.0, 50.0, 20.0
    controller = design_pid(internal_model_tuning(gain, tau, 0.0, closed), WIDE, sample_time_min=T)
    a = np.exp(-T / tau)

    @jax.jit
    def run(state):
        def sample(carry, _):
            state, y, u = carry
            state, decision = controller.step(state, observe(100.0 + y, u, 90.0))
            y = a * y + gain * (1.0 - a) * (decision.insulin_mU_min - 1000.0)
            return (state, y, decision.insulin_mU_min), y

        return jax.lax.scan(sample, (state, 0.0, 1000.0), None, length=1600)[1]

    # It initialises before the setpoint changes, so that the proportional part answers too.
    glucose = np.asarray(run(controller.init(observe(100.0, 1000.0, 100.0))))
    left = 1.0 + glucose / 10.0
    np.testing.assert_allclose(left, np.exp(-T * np.arange(1, 1601) / closed), atol=2.0 * T / closed)


# ---------------------------------------------------------------------------------------------- refusals


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ((0.0, 90.0, 0.0), r"gain of 0 mU/min per mg/dl is not possible; give a finite value above 0"),
        ((-1.0, 90.0, 0.0), "gain of -1"),
        ((np.inf, 90.0, 0.0), "gain of inf"),
        ((np.nan, 90.0, 0.0), "gain of nan"),
        ((1.0, 0.0, 0.0), "integral time of 0 min is not possible; give a value above 0"),
        ((1.0, np.nan, 0.0), "integral time of nan min"),
        ((1.0, 90.0, -1.0), "derivative time of -1 min is not possible; give a finite value of 0 or more"),
        ((1.0, 90.0, np.inf), "derivative time of inf min"),
        ((1.0, 90.0, np.nan), "derivative time of nan min"),
    ],
)
def test_a_tuning_out_of_bounds_is_refused(arguments, sentence):
    with pytest.raises(ValueError, match=sentence):
        PIDTuning(*arguments)


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ((3.0, 80.0, 5.0, 30.0), "gain of 3 mg/dl per mU/min is not possible; insulin lowers glucose.*below 0"),
        ((0.0, 80.0, 5.0, 30.0), "gain of 0 mg/dl"),
        ((np.nan, 80.0, 5.0, 30.0), "gain of nan mg/dl"),
        ((-3.0, 0.0, 5.0, 30.0), "lag of 0, a dead time of 5 and a closed loop of 30 min are not possible together"),
        ((-3.0, 80.0, -5.0, 30.0), "dead time of -5"),
        ((-3.0, 80.0, 5.0, 0.0), "closed loop of 0"),
        ((-3.0, np.nan, 5.0, 30.0), "lag of nan"),
    ],
)
def test_a_model_that_cannot_be_tuned_for_is_refused(arguments, sentence):
    with pytest.raises(ValueError, match=sentence):
        internal_model_tuning(*arguments)


@pytest.mark.parametrize("sample_time", [0.0, -5.0, np.nan, np.inf])
def test_a_sample_time_that_is_not_possible_is_refused(sample_time):
    with pytest.raises(ValueError, match=rf"sample time of {sample_time:g} min is not possible"):
        design_pid(TUNING, sample_time_min=sample_time)
