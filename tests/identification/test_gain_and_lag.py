import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import curve_fit
from scipy.signal import lsim

from glucoloop.identification.gain_and_lag import GAIN_SPREAD, LAG_SPREAD, identify_gain_and_lag
from glucoloop.models.nonlinear import LAG_MIN

SAMPLES = 96
T = 5.0 * np.arange(SAMPLES + 1)
# the known person: two lags of 55 and 20 min and a gain of -3.2 mg/dl per mU/min
STEP = -3.2 * (1.0 - (55.0 * np.exp(-T / 55.0) - 20.0 * np.exp(-T / 20.0)) / 35.0)
RESPONSE = np.diff(STEP)
PULSES = np.zeros(SAMPLES)
PULSES[:6], PULSES[48:54] = 6.0, -6.0


def answer(gain, lag, insulin=PULSES):
    """The same model, its lag passed by SciPy's transfer function on a grid of 15 s."""
    fine = np.repeat(insulin, 20)
    t = np.arange(fine.size + 1) / 4.0
    _, given, _ = lsim(([LAG_MIN, 1.0], [LAG_MIN * lag, 1.0]), np.append(fine, 0.0), t, interp=False)
    mean = given[:-1].reshape(-1, 20).mean(axis=1)
    return gain * np.append(0.0, np.convolve(mean, RESPONSE)[:SAMPLES])


@pytest.mark.long
@pytest.mark.parametrize(("gain", "lag"), [(1.0, 1.0), (0.55, 0.8), (1.7, 1.3)])
def test_finds_what_scipy_finds_in_a_record_without_noise(gain, lag):
    glucose = answer(gain, lag)
    found = identify_gain_and_lag(PULSES, glucose, RESPONSE, noise_variance=1e-6)
    (a, b), _ = curve_fit(lambda _, a, b: answer(a, b), T, glucose, p0=(1.0, 1.0))
    np.testing.assert_allclose((found.gain, found.lag), (a, b), rtol=5e-3)
    np.testing.assert_allclose((a, b), (gain, lag), rtol=1e-3)
    assert found.residual_rms_mg_dl < 0.02


@pytest.mark.long
def test_errors_are_as_large_as_they_are_said_to_be():
    random = np.random.default_rng(1)
    people = 60
    truth = np.exp(random.normal(0.0, 1.0, (2, people)) * np.array([[GAIN_SPREAD], [LAG_SPREAD]]))
    glucose = np.stack([answer(a, b) for a, b in truth.T], axis=1)
    noisy = glucose + random.normal(0.0, np.sqrt(1.45), glucose.shape)
    insulin = np.repeat(PULSES[:, None], people, axis=1)
    found = identify_gain_and_lag(insulin, noisy, RESPONSE)
    for value, error, true in ((found.gain, found.gain_error, truth[0]), (found.lag, found.lag_error, truth[1])):
        score = (np.asarray(value) - true) / np.asarray(error)
        assert 0.75 < score.std() < 1.25
        assert abs(score.mean()) < 0.3
    assert np.sqrt(np.mean(np.log(np.asarray(found.gain) / truth[0]) ** 2)) < 0.5 * GAIN_SPREAD
    alone = identify_gain_and_lag(PULSES, noisy[:, 7], RESPONSE)
    np.testing.assert_allclose(alone.gain, found.gain[7], rtol=1e-6)
    np.testing.assert_allclose(alone.lag_error, found.lag_error[7], rtol=1e-6)


def test_the_prior_speaks_where_the_record_is_silent():
    found = identify_gain_and_lag(np.zeros(SAMPLES), np.zeros(SAMPLES + 1), RESPONSE)
    np.testing.assert_allclose((found.gain, found.lag), 1.0)
    np.testing.assert_allclose((found.gain_error, found.lag_error), (GAIN_SPREAD, LAG_SPREAD))


def test_readings_that_are_missing_count_for_nothing():
    glucose = answer(1.4, 0.9)
    glucose[10:20] = np.nan
    found = identify_gain_and_lag(PULSES, glucose, RESPONSE, noise_variance=1e-6)
    np.testing.assert_allclose((found.gain, found.lag), (1.4, 0.9), rtol=5e-3)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"insulin_deviation_mU_min": PULSES[:-1]}, "do not go with readings"),
        ({"impulse_response": np.zeros(0)}, "is not one of a person"),
        ({"insulin_deviation_mU_min": PULSES * np.nan}, "The insulin rates are not finite at sample 0"),
        ({"noise_variance": 0.0}, "The noise variance is 0.0"),
        ({"gain_spread": -1.0}, "The spread of the gain is -1.0"),
        ({"lag_spread": np.inf}, "The spread of the lag is inf"),
        ({"sample_time_min": 0.0}, "The sample time is 0.0"),
    ],
)
def test_refusals(change, sentence):
    given = {
        "insulin_deviation_mU_min": PULSES,
        "glucose_deviation_mg_dl": jnp.zeros(SAMPLES + 1),
        "impulse_response": RESPONSE,
        **change,
    }
    with pytest.raises(ValueError, match=sentence):
        identify_gain_and_lag(**given)
