"""Experiments on a patient without a controller: what is infused, what is read, and the models that come of it."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate
import scipy.optimize

from glucoloop._pytree import pytree
from glucoloop.identification import best_pole, design_csrs, laguerre_functions
from glucoloop.models.step_response import StepResponseModel
from glucoloop.sensors import IdealSensor, Reading, dead_time, white_noise
from glucoloop.simulation import excite, fit_step, identify, validate_on

BASAL = 25.6060573442


@pytest.fixture(scope="module")
def found(patient_81):
    return identify(patient_81)


# ------------------------------------------------------------------------------------------- excitation


def test_the_patient_answers_as_his_balances_say(patient_81, sorensen_by_hand):
    rates = np.tile([30.0, 5.0, 60.0, 60.0, 0.0, 25.0, 10.0, 15.0], 9)
    record = excite(patient_81, rates)
    x, expected = np.asarray(patient_81.steady_state(patient_81.basal_insulin_mU_min)), [81.1]
    for rate in rates:
        x = scipy.integrate.solve_ivp(
            lambda _, x, u=rate: sorensen_by_hand(x, u, 0.0), (0.0, 5.0), x, method="LSODA", rtol=1e-10, atol=1e-10
        ).y[:, -1]
        expected.append(x[2])
    np.testing.assert_allclose(record.glucose_mg_dl, expected, atol=1e-4)
    np.testing.assert_array_equal(record.insulin_mU_min, rates)
    assert np.ptp(expected) > 1.0


def test_at_the_basal_rate_nothing_happens(patient_81):
    record = excite(patient_81, np.full(72, float(patient_81.basal_insulin_mU_min)))
    np.testing.assert_allclose(record.glucose_mg_dl, 81.1, rtol=1e-11)


@pytest.mark.long
def test_the_sensor_and_the_key_decide_what_is_read(patient_81):
    rates = np.full(72, float(patient_81.basal_insulin_mU_min))
    first, again, other = (excite(patient_81, rates, white_noise(2.0), key).glucose_mg_dl for key in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert np.all(first != other)
    for readings in (first, other):
        assert np.var(readings - 81.1) == pytest.approx(2.0, rel=0.5)
        assert abs(np.mean(readings - 81.1)) < 0.5


@pytree
class Deaf:
    """Has nothing to say at glucose below 81 mg/dl."""

    def init(self, glucose_mg_dl, key):
        del glucose_mg_dl, key
        return ()

    def read(self, state, glucose_mg_dl, key):
        del key
        return state, Reading(glucose_mg_dl=glucose_mg_dl, valid=glucose_mg_dl >= 81.0)


def test_what_the_sensor_does_not_stand_by_is_missing(patient_81):
    rates = np.full(72, 30.0)
    truth, heard = (np.asarray(excite(patient_81, rates, sensor).glucose_mg_dl) for sensor in (IdealSensor(), Deaf()))
    low = truth < 81.0
    assert 60 < low.sum() < 73
    np.testing.assert_array_equal(np.isnan(heard), low)
    np.testing.assert_allclose(heard[~low], truth[~low], rtol=1e-12)


@pytest.mark.parametrize("rate", [-1.0, np.nan, np.inf])
def test_a_rate_that_cannot_be_delivered_is_refused(patient_81, rate):
    with pytest.raises(ValueError, match=rf"infusion of {rate:g} mU/min cannot be delivered; give finite rates of 0"):
        excite(patient_81, [20.0, rate])


# ------------------------------------------------------------------------------------------- first order


def test_the_model_of_a_lasting_step(patient_81):
    model = fit_step(patient_81)
    assert model.gain == pytest.approx(-3.450035, rel=1e-5)
    assert model.tau_min == pytest.approx(89.1459, rel=1e-5)
    assert model.delay_min == 5.0
    # SciPy on the patient's answer to half the nominal rate
    answer = np.asarray(excite(patient_81, np.full(120, BASAL + 11.165)).glucose_mg_dl) - 81.1
    since = np.maximum(5.0 * np.arange(121) - 5.0, 0.0)
    (gain, tau), _ = scipy.optimize.curve_fit(
        lambda _, K, tau: 11.165 * K * (1 - np.exp(-since / tau)), since, answer, [-3.0, 60.0]
    )
    assert (model.gain, model.tau_min) == pytest.approx((gain, tau), rel=1e-5)


def test_the_time_constant_of_a_small_step_is_the_papers(patient_81):
    model = fit_step(patient_81, step_mU_min=0.01, horizon_min=180.0, delay_min=None)
    assert model.tau_min == pytest.approx(53.8, abs=0.06)  # the paper: about 55
    assert 5.0 < model.delay_min < 20.0


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ({"step_mU_min": -30.0}, "infusion of -4.39394 mU/min cannot be delivered"),
        ({"step_mU_min": 0.0}, r"a step of 0 mU/min moves glucose by .* hardly more than rounding"),
        ({"delay_min": 350.0}, "Only 2 readings lie after the delay of 350 min"),
        ({"delay_min": -5.0}, "delay of -5.0 min is not a finite number of at least 0"),
    ],
)
def test_a_step_that_tells_nothing_is_refused(patient_81, arguments, sentence):
    with pytest.raises(ValueError, match=sentence):
        fit_step(patient_81, **{"horizon_min": 360.0, **arguments})


# ------------------------------------------------------------------------------------------- identification


def test_the_identified_numbers(found):
    assert float(found.impulse_response.sum()) == pytest.approx(-2.6036501, rel=1e-6)
    np.testing.assert_allclose(found.laguerre_coefficients, [-0.37481091, -0.40937979], rtol=1e-6)
    assert found.basal_insulin_mU_min == pytest.approx(BASAL, rel=1e-10)


@pytest.mark.long
@pytest.mark.parametrize(("point", "pole", "left"), [("setpoint-81", 0.82, 1.43), ("nominal-22", 0.84, 1.47)])
def test_the_papers_pole_and_what_is_left_after_the_memory(point, pole, left, found, patient_22):
    one = found if point == "setpoint-81" else identify(patient_22)
    assert float(best_pole(one.impulse_response, 2).pole) == pytest.approx(pole)
    endless = np.asarray(one.laguerre_coefficients) @ np.asarray(laguerre_functions(0.84, 2, 2000))
    assert 100.0 * (1.0 - endless[:36].sum() / endless.sum()) == pytest.approx(left, abs=0.01)  # the paper: 1.5 %


def test_the_response_is_the_difference_of_the_answers_to_both_pulses(patient_81, found):
    record = excite(patient_81, BASAL + np.asarray(design_csrs(36, 22.33)))
    y = np.asarray(record.glucose_mg_dl)
    np.testing.assert_allclose(found.impulse_response, (y[1:37] - y[37:73]) / (2 * 22.33), atol=1e-9)


def test_a_dead_time_is_identified_with_the_rest(patient_81, found):
    """The raw response moves by it, and what comes before is what the last pulse had left."""
    late = identify(patient_81, dead_time(2))
    np.testing.assert_allclose(late.impulse_response[2:], found.impulse_response[:-2], atol=1e-12)
    assert np.abs(late.impulse_response[:2]).max() < 0.1 * np.abs(found.impulse_response).max()


def test_without_smoothing_the_model_is_the_estimate(patient_81, found):
    raw = identify(patient_81, laguerre_functions=None)
    np.testing.assert_allclose(raw.model.step_response, np.cumsum(found.impulse_response), atol=1e-12)


def test_noise_is_that_of_the_key(patient_81, found):
    first, again, other = (
        identify(patient_81, white_noise(), key).impulse_response for key in (1, jax.random.key(1), 2)
    )
    np.testing.assert_array_equal(first, again)
    for noisy in (first, other):
        # each coefficient is a difference of two readings over twice the amplitude
        assert np.std(noisy - found.impulse_response) == pytest.approx(np.sqrt(2 * 1.45) / (2 * 22.33), rel=0.4)


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ({"amplitude_mU_min": 26.0}, "pulses of 26 mU/min would take away more.*give an amplitude of at most 25.61"),
        ({"amplitude_mU_min": np.nan}, "pulses of nan mU/min would take away more"),
        ({"amplitude_mU_min": 0.0}, "amplitude is 0.0 mU/min: it must be a finite number above 0"),
        ({"amplitude_mU_min": -5.0}, "amplitude is -5.0 mU/min"),
        ({"memory": 0}, "memory is 0: it must be a whole number of at least 1"),
        ({"samples": 71}, "record of 71 samples is too short: 2 pulses that are 36 samples apart need at least 72"),
        ({"laguerre_pole": 1.0}, "pole of 1.0 is not strictly between 0 and 1"),
        ({"laguerre_functions": 37}, "37 Laguerre functions are more than the 36"),
        ({"sensor": Deaf()}, "glucose readings are not finite at sample 1: use record_from_samples"),
    ],
)
def test_what_cannot_be_identified_is_refused(patient_81, arguments, sentence):
    with pytest.raises(ValueError, match=sentence):
        identify(patient_81, **arguments)


# ------------------------------------------------------------------------------------------- validation


def test_validation_sets_the_patient_beside_the_model(patient_81, found):
    record, validation = validate_on(patient_81, found.model, samples=72, seed=3)
    deviation = np.asarray(record.insulin_mU_min) - BASAL
    np.testing.assert_allclose(np.abs(deviation), 0.1 * BASAL, rtol=1e-9)
    h = np.asarray(found.model.impulse_response)
    predicted = [sum(h[i] * deviation[k - 1 - i] for i in range(min(k, 36))) for k in range(73)]
    residual = np.asarray(record.glucose_mg_dl) - 81.1 - predicted
    assert float(validation.sum_absolute_residual_mg_dl) == pytest.approx(np.abs(residual).sum(), rel=1e-9)
    assert 0.0 < np.abs(residual).max() < 1.0
    doubled = StepResponseModel.from_impulse_response(2.0 * h, 5.0)
    _, worse = validate_on(patient_81, doubled, samples=72, seed=3)
    assert float(worse.sum_absolute_residual_mg_dl) > 3.0 * float(validation.sum_absolute_residual_mg_dl)


def test_a_sequence_of_ones_own_amplitude(patient_81, found):
    record, _ = validate_on(patient_81, found.model, samples=72, amplitude_mU_min=1.5)
    np.testing.assert_allclose(jnp.unique(record.insulin_mU_min), [BASAL - 1.5, BASAL + 1.5], rtol=1e-9)
    with pytest.raises(ValueError, match=r"infusion of -0\.393943 mU/min cannot be delivered"):
        validate_on(patient_81, found.model, samples=72, amplitude_mU_min=26.0)


@pytest.mark.parametrize("minutes", [0.0, -5.0, np.nan])
def test_a_sample_time_that_is_not_possible_is_refused(patient_81, minutes):
    for experiment in (identify, fit_step, lambda person, **time: excite(person, [25.0], **time)):
        with pytest.raises(ValueError, match=r"[Ss]ample time .*(not possible|above 0)"):
            experiment(patient_81, sample_time_min=minutes)
