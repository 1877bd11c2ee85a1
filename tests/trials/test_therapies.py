"""Therapies in a trial: native code carries out each, and people who eat against low glucose spend less time there."""

import numpy as np
import pytest

from glucoloop.situations.situation import configured
from glucoloop.trials.engine import prepare, run_people
from glucoloop.trials.trial import Trial

PEOPLE = np.arange(6)
THERAPIES = {
    "hybrid": {"controller": ["pid-ifb", "loop-like", "loop-like, dosing=temporary-basal, label=rates"]},
    "pens": {"controller": ["basal-bolus"], "pump": "pen, insulin=detemir, injections=2"},
}


def asked(**more):
    return configured(
        Trial,
        patient="hovorka-2004",
        population="boiroux2017",
        people=PEOPLE.size,
        announce_meals=True,
        duration_min=1200.0,
        sensor=["dexcom-g6"],
        **more,
    )


@pytest.mark.long
@pytest.mark.parametrize("therapy", THERAPIES)
def test_native_code_carries_it_out(therapy):
    prepared = prepare(asked(**THERAPIES[therapy], rescue="carbs"))
    assert {case.loop.engine for case in prepared.cases.values()} == {"native"}
    for label in prepared.cases:
        found = run_people(prepared, label, PEOPLE, threads=1)
        assert np.all(np.isfinite(found.metrics["time_70_180_pct"]))


@pytest.mark.long
def test_eating_shortens_the_time_of_low_glucose():
    more = {"controller": ["basal-bolus, carb_ratio=8, label=bold"], "metrics": ["rescues"]}
    without, rescued = (
        run_people(prepare(asked(**more, **rescue)), "bold", PEOPLE, threads=1).metrics
        for rescue in ({}, {"rescue": "carbs_g=20, by=glucose"})
    )
    low = without["time_below_70_pct"] > 0.0
    assert low.sum() >= 2
    assert np.all(without["rescue_carbs_g"] == 0.0)
    assert np.all(rescued["rescue_carbs_g"][low] >= 20.0)
    np.testing.assert_array_equal(rescued["rescue_carbs_g"], 20.0 * rescued["rescues"])
    assert np.all(rescued["time_below_70_pct"][low] < without["time_below_70_pct"][low])


@pytest.mark.long
@pytest.mark.parametrize("sensor", ["dexcom-g6", "white-noise, variance=1.45"])
def test_the_defaults_of_profile_mpc_are_kind_whatever_the_sensor(sensor):
    """An error of the sensor that is taken for meals brings nearly everybody below 70 mg/dl."""
    people = np.arange(32)
    trial = configured(
        Trial,
        patient="hovorka-2004",
        people=people.size,
        announce_meals=True,
        profile_by="titration",
        sensor=[sensor],
        seed=11,
        controller=["profile-mpc", "basal-bolus"],
    )
    prepared = prepare(trial)
    found, usual = (run_people(prepared, label, people).metrics for label in ("profile-mpc", "basal-bolus"))
    assert np.mean(found["time_below_70_pct"]) < 1.5
    assert np.sum(found["time_below_54_pct"] > 0.0) <= np.sum(usual["time_below_54_pct"] > 0.0) + 1
    assert np.mean(found["time_70_180_pct"]) > 70.0
