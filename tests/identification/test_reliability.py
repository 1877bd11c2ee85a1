"""What a record says about a gain: right for white noise, honest for disturbances that last for hours."""

import re

import numpy as np
import pytest

from glucoloop.identification.reliability import Reliability, doubts, reliability

SAMPLES = 300
PERSON = {"basal_insulin_mU_min": 25.6, "glucose_mg_dl": 81.1}


def pairs(seed, disturbance, gain=0.0, amplitude=8.0):
    """Regressors of a person who answers at once, and his readings."""
    rng = np.random.default_rng(seed)
    insulin = np.repeat(rng.uniform(-amplitude, amplitude, SAMPLES // 12), 12)
    return np.column_stack([insulin, np.ones(SAMPLES)]), 81.1 + gain * insulin + disturbance(rng)


def white(rng):
    return rng.normal(0.0, 10.0, SAMPLES)


def wandering(rng):
    return np.cumsum(rng.normal(0.0, 3.0, SAMPLES))


def judged(columns, readings):
    gain = float(np.linalg.lstsq(columns, readings)[0][0])
    return gain, reliability(columns, readings, np.array([1.0, 0.0]))


def test_margin_is_that_of_least_squares_under_white_noise():
    # 2.262 standard errors, which are known in closed form here
    ratio = []
    for seed in range(100):
        columns, readings = pairs(seed, white)
        exact = 2.262 * 10.0 * np.sqrt(np.linalg.inv(columns.T @ columns)[0, 0])
        ratio.append(judged(columns, readings)[1].gain_margin / exact)
    assert np.median(ratio) == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize("disturbance", [white, wandering])
@pytest.mark.parametrize("gain", [0.0, -3.0])
def test_interval_holds_the_true_gain_in_about_95_of_100_records(disturbance, gain):
    found = [judged(*pairs(seed, disturbance, gain)) for seed in range(200)]
    held = sum(abs(estimate - gain) <= quality.gain_margin for estimate, quality in found)
    assert held >= 0.9 * len(found)


def test_a_gain_that_is_not_there_is_seldom_found():
    passed = sum(
        not doubts(gain, quality, **PERSON) for gain, quality in (judged(*pairs(s, wandering)) for s in range(200))
    )
    assert passed <= 0.05 * 200


def test_a_gain_that_is_there_is_found():
    for seed in range(20):
        gain, quality = judged(*pairs(seed, white, gain=-3.0))
        assert doubts(gain, quality, **PERSON) == ()
        # a variance of 3^2 8^2 / 3 is explained, and 10^2 is not
        assert quality.explained_percent == pytest.approx(100 * 192 / 292, abs=12)


def test_an_exact_answer_is_explained_and_certain():
    gain, quality = judged(*pairs(0, lambda rng: 0.0, gain=-2.0))
    assert gain == pytest.approx(-2.0)
    assert quality.gain_margin == pytest.approx(0.0, abs=1e-9)
    assert quality.explained_percent == pytest.approx(100.0)


def test_readings_that_do_not_move_explain_nothing():
    columns, _ = pairs(0, white)
    assert reliability(columns, np.full(SAMPLES, 81.0), np.array([1.0, 0.0])).explained_percent == 0.0


@pytest.mark.parametrize(
    ("gain", "margin", "explained", "sentence"),
    [
        (1.2, 0.1, 50.0, r"The gain is \+1.2 mg/dl per mU/min, so more insulin would raise glucose"),
        (0.0, 0.0, 50.0, "more insulin would raise glucose"),
        (
            -2.0,
            2.5,
            50.0,
            r"The gain is -2 mg/dl per mU/min, give or take 2.5 \(95 % .*, so it cannot be distinguished from 0",
        ),
        (-40.0, 1.0, 50.0, "25.6 mU/min more would lower glucose from 81.1 mg/dl to below 0"),
        (-2.0, 0.5, -3.0, "no better than by the mean of the others"),
    ],
)
def test_each_doubt_is_told(gain, margin, explained, sentence):
    (told,) = doubts(gain, Reliability(gain_margin=margin, explained_percent=explained), **PERSON)
    assert re.search(sentence, told)


def test_a_model_of_which_nothing_is_known_is_judged_by_its_gain():
    assert doubts(-2.7, None, **PERSON) == ()
    assert len(doubts(2.7, None, **PERSON)) == 1
