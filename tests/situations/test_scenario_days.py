"""Days gone wrong: each is the plain day but for its event, and insulin is accounted for to the last milliunit."""

import numpy as np
import pytest

from glucoloop.build.assemble import close_loop
from glucoloop.build.designs import controller_of
from glucoloop.build.titration import profile_of
from glucoloop.situations.run import Run
from glucoloop.situations.scenarios import SCENARIOS
from glucoloop.situations.situation import configured
from glucoloop.trials.engine import people_of, prepare, run_people
from glucoloop.trials.trial import Trial

PATIENT = "hovorka-2004"
PLAIN = {"meals": ("45g@7h", "70g@12h", "60g@18h"), "profile_error": None}
DAYS = [
    name
    for name, scenario in SCENARIOS.items()
    if name not in ("plain-day", "unkind-day", "week", "year", "custom") and scenario().days is None
]
SHORT = {"meals": ["60g@30min"], "duration_min": 240.0, "announce_meals": True, "patient": PATIENT}
OCCLUSION = "occlusion, start=1h, duration=1h"


def run_of(controller="basal-bolus", **keys):
    run = configured(Run, controller=controller, **keys)
    return close_loop(run, controller_of(run, run.case), run.as_scenario())


@pytest.mark.parametrize("name", DAYS)
def test_a_day_without_its_event_is_the_plain_day(name):
    none = {"events": [], "actions": [], "rhythm": [], **PLAIN}
    day = configured(Run, patient=PATIENT, scenario=name, **none)
    plain = configured(Run, patient=PATIENT, scenario="plain-day")
    keys = set(Run.settings()) - {"scenario"}
    assert {key: getattr(day, key) for key in keys} == {key: getattr(plain, key) for key in keys}


@pytest.mark.parametrize("name", DAYS)
def test_a_day_has_an_event(name):
    day, plain = SCENARIOS[name]().values(), SCENARIOS["plain-day"]().values()
    assert day != plain


def test_without_an_event_in_it_the_loop_is_the_same_to_the_bit():
    late = {"events": ["occlusion, start=235min"], "actions": ["bolus, time=235min", "no-bolus, time=235min"]}
    plain, later = run_of(**SHORT), run_of(**SHORT, **late)
    np.testing.assert_array_equal(plain.glucose_mg_dl, later.glucose_mg_dl)
    np.testing.assert_array_equal(plain.reported_bolus_mU, later.reported_bolus_mU)


def test_a_blocked_line_delivers_nothing_and_the_pump_counts_just_that_much_more():
    trace = run_of(**SHORT, events=[OCCLUSION], actions=["bolus, time=90min, above_mg_dl=0, units_U=1"])
    t = np.asarray(trace.t_min)
    blocked = (t >= 60.0) & (t < 120.0)
    given = 5.0 * np.asarray(trace.insulin_mU_min) + np.asarray(trace.bolus_mU)
    counted = 5.0 * np.asarray(trace.reported_mU_min) + np.asarray(trace.reported_bolus_mU)
    assert not given[blocked].any()
    assert (counted - given).sum() == pytest.approx(counted[blocked].sum(), rel=1e-12)
    assert counted[blocked].sum() == pytest.approx(60.0 * float(trace.basal_insulin_mU_min) + 1000.0, rel=1e-9)


def test_a_dropped_bolus_is_missing_and_the_basal_rate_goes_on():
    plain = run_of(**SHORT)
    dropped = run_of(**SHORT, actions=["no-bolus, time=15min, duration=45min"])
    assert float(plain.bolus_mU[6]) > 1000.0
    assert not np.asarray(dropped.bolus_mU)[:12].any()
    assert not np.asarray(dropped.reported_bolus_mU)[:12].any()
    np.testing.assert_array_equal(dropped.insulin_mU_min, plain.insulin_mU_min)
    assert float(dropped.glucose_mg_dl.max()) > float(plain.glucose_mg_dl.max()) + 20.0


def test_a_bolus_by_hand_is_that_of_the_correction_factor():
    keys = {**SHORT, "announce_meals": False}
    trace = run_of("basal", **keys, actions=["bolus, time=90min, above_mg_dl=150"])
    reading, run = float(trace.reading_mg_dl[18]), configured(Run, **keys)
    factor = float(profile_of(run).correction_factor())
    assert reading > 150.0
    assert float(trace.command_bolus_mU[18]) == pytest.approx(1000.0 * (reading - run.target_mg_dl) / factor)
    assert np.count_nonzero(trace.command_bolus_mU) == 1
    assert not np.asarray(run_of("basal", **keys, actions=["bolus, time=90min, above_mg_dl=400"]).bolus_mU).any()


def test_wrong_profiles_reach_controllers_and_nothing_else():
    right, wrong = (
        configured(Trial, patient=PATIENT, people=3, **keys)
        for keys in ({}, {"profile_error": "ratio_pct=50, basal_pct=200, spread_pct=15"})
    )
    everybody = np.arange(500)
    own, told = people_of(right, everybody), people_of(wrong, everybody)
    np.testing.assert_array_equal(own.basal_insulin_mU_min, told.basal_insulin_mU_min)
    np.testing.assert_allclose(told.profile.basal_mU_min, 2.0 * own.profile.basal_mU_min)
    errors = [
        np.log(np.asarray(getattr(told.profile, name)()) / np.asarray(getattr(own.profile, name)()) / 0.5)
        for name in ("carb_ratio", "correction_factor")
    ]
    for error in errors:
        assert error.mean() == pytest.approx(0.0, abs=4.0 * 0.15 / np.sqrt(500.0))
        assert error.std() == pytest.approx(0.15, rel=4.0 / np.sqrt(1000.0))
    assert abs(np.corrcoef(*errors)[0, 1]) < 4.0 / np.sqrt(500.0)
    # a person's error is the same whoever else is drawn
    np.testing.assert_array_equal(people_of(wrong, [7]).profile.carb_ratio_g_U, told.profile.carb_ratio_g_U[7:8])
    assert people_of(right, [0]).profile is not people_of(wrong, [0]).profile


@pytest.mark.long
@pytest.mark.parametrize("name", ["occlusion", "exercise-announced", "ratios-halved"])
def test_a_person_of_a_trial_has_the_day_of_a_run(name):
    trial = configured(
        Trial, patient=PATIENT, scenario=name, people=2, controller=[{"name": "basal-bolus", "guard": "usual"}]
    )
    prepared = prepare(trial)
    from glucoloop.trials.engine import alone

    label = trial.cases[0].label
    trace, people = alone(prepared, label, 1), run_people(prepared, label, [0, 1], traces=True)
    np.testing.assert_allclose(people.glucose_mg_dl[:-1, 1], trace.glucose_mg_dl, atol=0.1)  # steps of another length
