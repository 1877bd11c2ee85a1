"""What a record says about a gain: right for white noise, honest for disturbances that last for hours."""

import dataclasses
import re

import numpy as np
import pytest

import glucoloop as gl
from glucoloop.identification import identify_record, random_binary_sequence
from glucoloop.identification.gain_interval import gain_interval
from glucoloop.identification.reliability import Reliability, doubts, reliability

SAMPLES = 300
PERSON = {"basal_insulin_mU_min": 25.6, "glucose_mg_dl": 81.1}
T_MIN = 5.0 * np.arange(SAMPLES + 1)
RESPONSE = 1.0 - np.exp(-T_MIN / 60.0)


def record(seed, disturbance, gain=0.0, amplitude=8.0):
    """Insulin deviations of a person with one lag of 60 min, and the readings."""
    rng = np.random.default_rng(seed)
    insulin = np.repeat(rng.uniform(-amplitude, amplitude, SAMPLES // 12), 12)
    moved = np.append(0.0, np.convolve(insulin, gain * np.diff(RESPONSE))[:SAMPLES])
    return insulin, 81.1 + moved + disturbance(rng)


def white(rng):
    return rng.normal(0.0, 2.0, SAMPLES + 1)


def wandering(rng):
    return np.cumsum(rng.normal(0.0, 1.0, SAMPLES + 1))


def interval_of(insulin, readings, **keywords):
    keywords = {"sample_time_min": 5.0, "gain_scale": 81.1 / 25.6, "starts_at_rest": True} | keywords
    return gain_interval(insulin, readings, np.zeros((readings.size, 0)), **keywords)


@pytest.mark.long
@pytest.mark.parametrize("disturbance", [white, wandering])
@pytest.mark.parametrize("gain", [0.0, -3.0])
def test_interval_holds_the_true_gain_in_about_95_of_100_records(disturbance, gain):
    ends = np.array([interval_of(*record(seed, disturbance, gain)) for seed in range(100)])
    assert np.sum((ends[:, 0] <= gain) & (gain <= ends[:, 1])) >= 90


@pytest.mark.long
def test_interval_holds_the_gain_of_small_changes_of_a_person_who_responds_less_far_from_rest():
    covered = 0
    for seed in range(40):
        insulin, readings = record(seed, lambda rng: 0.0, gain=-3.0)
        moved = readings - 81.1
        bent = moved + 0.3 * moved**2 / np.abs(moved).max()
        low, high = interval_of(insulin, 81.1 + bent + white(np.random.default_rng(1000 + seed)))
        covered += low <= -3.0 <= high
    assert covered >= 36


def test_a_gain_that_is_there_is_not_confused_with_0():
    for seed in range(5):
        low, high = interval_of(*record(seed, white, gain=-3.0))
        assert -4.0 < low
        assert high < -2.0


def test_an_interval_is_in_the_units_of_its_record():
    insulin, readings = record(3, white, gain=-3.0)
    low, high = interval_of(insulin, readings)
    assert interval_of(10.0 * insulin, readings, gain_scale=8.11 / 25.6) == pytest.approx((low / 10.0, high / 10.0))
    assert interval_of(insulin, readings + 50.0) == pytest.approx((low, high), rel=1e-6)


def test_exact_readings_leave_little_open():
    """One lag is no sum of pairs of lags, which is what the interval allows for."""
    low, high = interval_of(*record(0, lambda rng: 0.0, gain=-2.0))
    assert -2.2 < low < -2.0 < high < -1.8


def test_a_record_without_a_reading_to_spare_says_nothing():
    low, high = interval_of(np.array([1.0, -1.0]), np.array([81.0]))
    assert -low == high > 50.0


def test_what_insulin_explains_is_the_variance_that_it_makes():
    rng = np.random.default_rng(0)
    insulin = np.repeat(rng.uniform(-8.0, 8.0, SAMPLES // 12), 12)
    columns = np.column_stack([insulin, np.ones(SAMPLES)])
    readings = -3.0 * insulin + rng.normal(0.0, 10.0, SAMPLES)
    quality = reliability(columns, readings, (-4.0, -2.5))
    assert quality.explained_percent == pytest.approx(100 * 192 / 292, abs=12)  # variances of 3^2 8^2 / 3 and 10^2
    assert (quality.gain_from, quality.gain_to) == (-4.0, -2.5)
    assert reliability(columns, -3.0 * insulin, (-3.0, -3.0)).explained_percent == pytest.approx(100.0)
    assert reliability(columns, np.full(SAMPLES, 81.0), (0.0, 0.0)).explained_percent == 0.0


@pytest.mark.parametrize(
    ("gain", "interval", "explained", "sentence"),
    [
        (1.2, (1.1, 1.3), 50.0, r"The gain is \+1.2 mg/dl per mU/min, so more insulin would raise glucose"),
        (0.0, (0.0, 0.0), 50.0, "more insulin would raise glucose"),
        (
            -2.0,
            (-3.9, 0.1),
            50.0,
            r"The gain is -2 mg/dl per mU/min, and .* from -3.9 to 0.1 \(95 % .*, so it cannot be distinguished from 0",
        ),
        (-2.0, (-4.1, -1.0), 50.0, r"from -4.1 to -1 \(95 % .*, so it may be more than twice that"),
        (-40.0, (-41.0, -39.0), 50.0, "25.6 mU/min more would lower glucose from 81.1 mg/dl to below 0"),
        (-2.0, (-2.5, -1.5), -3.0, "no better than by the mean of the others"),
    ],
)
def test_each_doubt_is_told(gain, interval, explained, sentence):
    quality = Reliability(gain_from=interval[0], gain_to=interval[1], explained_percent=explained)
    (told,) = doubts(gain, quality, **PERSON)
    assert re.search(sentence, told)


def test_insulin_that_moves_glucose_far_is_a_doubt():
    sound = Reliability(gain_from=-2.5, gain_to=-1.5, explained_percent=50.0, moved_percent=19.0)
    assert doubts(-2.0, sound, **PERSON) == ()
    (told,) = doubts(-2.0, dataclasses.replace(sound, moved_percent=38.0), **PERSON)
    assert "moved glucose by up to 38 % of 81.1 mg/dl" in told


@pytest.mark.parametrize(("steps_percent", "doubtful"), [(20.0, False), (50.0, True)])
def test_steps_of_insulin_that_a_person_answers_out_of_proportion_are_refused(steps_percent, doubtful):
    """Below 81 mg/dl the brain takes less in Hovorka's model, above 162 the kidneys excrete."""
    patient = gl.patient("hovorka-2004")
    basal = float(patient.basal_insulin_mU_min)
    insulin = basal + np.asarray(random_binary_sequence(576, 0.01 * steps_percent * basal, 1, hold_samples=6))
    identification = identify_record(
        gl.excite(patient, insulin, gl.white_noise(1.45), 1), "least-squares", basal_insulin_mU_min=basal
    )
    assert any("moved glucose" in doubt for doubt in identification.doubts()) == doubtful


def test_a_model_of_which_nothing_is_known_is_judged_by_its_gain():
    assert doubts(-2.7, None, **PERSON) == ()
    assert len(doubts(2.7, None, **PERSON)) == 1
