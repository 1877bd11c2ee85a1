"""Therapies in a trial: native code carries out each, and people who eat against low glucose spend less time there."""

import numpy as np
import pytest

from glucoloop.cohorts.engine import prepare, run_people
from glucoloop.cohorts.trial import Trial
from glucoloop.situations.situation import configured

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
