"""The summary of a run that a clinician reads first, and the time without insulin."""

import numpy as np
import pytest

from glucoloop.control import Status
from glucoloop.metrics import clinical_summary, summarise


def told(trace):
    return clinical_summary(trace, summarise(trace))


def of_a_high_run(make_trace):
    """Ten hours of which eight are above 250 mg/dl, without insulin for nine, and at the limit for nine."""
    glucose = np.full(601, 300.0)
    glucose[:120] = 100.0
    insulin = np.zeros(120)
    insulin[:12] = 20.0
    status = np.where(np.arange(120) < 12, int(Status.OK), int(Status.SATURATED))
    return make_trace(glucose, insulin, status=status)


@pytest.mark.long
def test_a_run_that_is_high_all_day_is_not_praised(make_trace):
    summary = told(of_a_high_run(make_trace))
    assert summary.insulin_off_h == summary.longest_insulin_off_h == 9.0
    assert summary.beyond_limits_pct == 90.0
    assert list(summary.sentences()) == [
        "Glucose was from 70 to 180 mg/dl for 20.0 % of the 10 h.",
        "Glucose was above 180 mg/dl for 80.0 % of the time (8 h), and above 250 mg/dl for 80.0 % of the time (8 h).",
        "Glucose was never below 70 mg/dl.",
        "The lowest glucose was 100.0 mg/dl, the highest 300.0 mg/dl, the mean 260.1 mg/dl.",
        "The pump delivered 1.20 U of insulin, and none at all for 9 h.",
        "The controller wanted a dose beyond its limits for most of the time, at 90.0 % of the samples.",
    ]


def test_the_summary_is_plain_values_too(make_trace):
    plain = told(of_a_high_run(make_trace)).as_dict()
    assert plain["time_above_250_pct"] == pytest.approx(100.0 * 481 / 601)
    assert plain["sentences"][0].startswith("Glucose was from 70 to 180 mg/dl")


def test_a_run_in_range_is_told_in_as_few_words(make_trace):
    assert list(told(make_trace(np.full(601, 100.0))).sentences()) == [
        "Glucose was from 70 to 180 mg/dl for 100 % of the 10 h.",
        "Glucose was never above 180 mg/dl.",
        "Glucose was never below 70 mg/dl.",
        "The lowest glucose was 100.0 mg/dl, the highest 100.0 mg/dl, the mean 100.0 mg/dl.",
        "The pump delivered 12.00 U of insulin.",
    ]


@pytest.mark.parametrize("least", [35.0, -20.0])
def test_a_glucose_beyond_the_model_is_no_lowest_value(make_trace, least):
    glucose = np.full(601, 100.0)
    glucose[300] = least
    summary = told(make_trace(glucose))
    assert summary.lowest_mg_dl is None
    text = " ".join(summary.sentences())
    assert "Glucose fell below 40.0 mg/dl, where the patient's model is not valid" in text
    assert f"{least:.1f}" not in text
    assert ("the mean" in text) == (least > 0.0)


def test_glucose_that_is_not_finite_is_told(make_trace):
    text = " ".join(told(make_trace(np.full(601, np.nan))).sentences())
    assert text.startswith("Glucose did not stay a finite number")
    assert "never" not in text


def test_a_bolus_interrupts_the_time_without_insulin(make_trace):
    insulin, bolus = np.zeros(120), np.zeros(120)
    insulin[100:] = 20.0
    bolus[60] = 1000.0
    metrics = summarise(make_trace(np.full(601, 100.0), insulin, bolus_mU=bolus))
    assert float(metrics.insulin_off_min) == 495.0
    assert float(metrics.longest_insulin_off_min) == 300.0
