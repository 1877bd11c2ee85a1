"""The first-order fit recovers what it is given, and says when it cannot."""

import control
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import optimize

from glucoloop.identification import FirstOrderModel, fit_first_order

TIMES = 5.0 * np.arange(60)


def first_order(gain, tau, delay, step=1.0):
    since = np.maximum(TIMES - delay, 0.0)
    return gain * step * (1 - np.exp(-since / tau))


gains = st.one_of(st.floats(-10, -0.1), st.floats(0.1, 10))


@settings(deadline=None, max_examples=40)
@given(gains, st.floats(4, 200), st.floats(0, 30), st.sampled_from([11.165, -2.0]))
def test_gain_and_time_constant_are_recovered_for_a_known_delay(gain, tau, delay, step):
    fit = fit_first_order(TIMES, first_order(gain, tau, delay, step), step, delay)
    assert (fit.gain, fit.tau_min, fit.delay_min) == pytest.approx((gain, tau, delay), rel=1e-6)
    assert fit.residual_rms_mg_dl < 1e-6
    np.testing.assert_allclose(fit.response(TIMES, step), first_order(gain, tau, delay, step), atol=1e-6)


@pytest.mark.long
@settings(deadline=None, max_examples=30)
@given(gains, st.floats(10, 150), st.floats(1, 40))
def test_an_unknown_delay_is_recovered_too(gain, tau, delay):
    fit = fit_first_order(TIMES, first_order(gain, tau, delay), 1.0, None)
    assert (fit.gain, fit.tau_min) == pytest.approx((gain, tau), rel=1e-4)
    assert fit.delay_min == pytest.approx(delay, abs=1e-3)


def test_the_response_is_that_of_python_control():
    model = FirstOrderModel(gain=-3.0, tau_min=55.0, delay_min=10.0, residual_rms_mg_dl=0.0)
    _, expected = control.step_response(control.tf([-3.0], [55.0, 1.0]), TIMES)
    np.testing.assert_allclose(model.response(TIMES + 10.0, 2.0), 2.0 * expected, atol=1e-9)
    np.testing.assert_array_equal(model.response([0.0, 9.9], 2.0), 0.0)


def test_of_a_higher_order_response_no_neighbouring_fit_is_better():
    _, y = control.step_response(control.tf([-3.0], [2000.0, 140.0, 1.0]), TIMES)
    fit = fit_first_order(TIMES, y, 1.0, 5.0)

    def cost(x):
        return np.sum((first_order(x[0], x[1], 5.0) - y) ** 2)

    other = optimize.minimize(cost, [-2.0, 100.0], method="Nelder-Mead", options={"xatol": 1e-9, "fatol": 1e-14})
    assert (fit.gain, fit.tau_min) == pytest.approx(other.x, rel=1e-5)
    assert fit.residual_rms_mg_dl == pytest.approx(np.sqrt(other.fun / TIMES.size), rel=1e-8)
    free = fit_first_order(TIMES, y, 1.0, None)
    assert free.residual_rms_mg_dl < fit.residual_rms_mg_dl
    assert free.delay_min > 5.0


def test_noise_averages_out_with_more_readings():
    rng = np.random.default_rng(0)
    noisy = first_order(-3.0, 55.0, 5.0, 11.165) + rng.normal(0, 1.2, (60, TIMES.size))
    often = np.array([fit_first_order(TIMES, y, 11.165).tau_min for y in noisy])
    seldom = np.array([fit_first_order(TIMES[::4], y[::4], 11.165).tau_min for y in noisy])
    assert abs(often.mean() - 55.0) < 4 * often.std() / np.sqrt(60)
    assert seldom.std() / often.std() == pytest.approx(2.0, rel=0.35)


@pytest.mark.parametrize(
    ("t", "y", "step", "delay", "sentence"),
    [
        (TIMES, np.ones(5), 1.0, 5.0, "do not pair up"),
        (TIMES.reshape(2, -1), np.ones((2, 30)), 1.0, 5.0, "do not pair up"),
        (TIMES, np.full(60, np.nan), 1.0, 5.0, "not finite"),
        (TIMES[::-1], np.ones(60), 1.0, 5.0, "not increasing at row 1"),
        (TIMES, np.ones(60), 0.0, 5.0, "step of 0.0 mU/min moves nothing"),
        (TIMES, np.ones(60), np.inf, 5.0, "step of inf mU/min"),
        (TIMES, np.ones(60), 1.0, -1.0, "delay of -1.0 min is not a finite number of at least 0"),
        (TIMES, np.ones(60), 1.0, np.nan, "delay of nan min"),
        (TIMES, np.ones(60), 1.0, 285.0, "Only 2 readings lie after the delay of 285 min, and a fit needs 3"),
        (TIMES[:4], np.ones(4), 1.0, None, "Only 3 readings lie after the delay of 0 min, and a fit needs 4"),
        (TIMES, np.zeros(60), 1.0, 5.0, "flat at 0 mg/dl"),
        (TIMES, np.where(TIMES > 5, 1.0, 0.0), 1.0, 5.0, "settles within .* sample more often"),
        (TIMES, TIMES, 1.0, 0.0, "does not level off within 295 min.*lengthen the record"),
    ],
)
def test_what_has_no_first_order_fit_is_refused(t, y, step, delay, sentence):
    with pytest.raises(ValueError, match=sentence):
        fit_first_order(t, y, step, delay)
