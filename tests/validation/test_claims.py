"""Claims: which number stands for a claim, and when it holds."""

import numpy as np
import pytest

from glucoloop.tuning.oscillation import CROSSINGS_PER_MEAL, TURNS_PER_MEAL
from meal_aware.claims import CLAIMS, MAX_ADDED, OVER_RUNS, spread
from meal_aware.measures import LATE_MIN, SWING_MG_DL
from meal_aware.situations import ALL_SITUATIONS, CONTROLLERS, GROUPS, MISMATCHES, OURS, Extent

BY_ID = {claim.id: claim for claim in CLAIMS}


def number(row):
    return row.numbers[OURS]


def holds(row):
    return row.holds(OURS)


def test_every_claim_is_about_a_situation_that_is_run(written, at_samples):
    assert {claim.situation for claim in CLAIMS} == {getattr(row, "group", row.name) for row in ALL_SITUATIONS}
    assert len(BY_ID) == len(CLAIMS)
    rows = {row.name: row.group for row in MISMATCHES}
    for claim in CLAIMS:
        assert bool(claim.rows) == (claim.situation in GROUPS)
        assert {rows[name] for name in claim.rows} <= {claim.situation}
        assert claim.over_runs in {*OVER_RUNS, MAX_ADDED}
        assert claim.kind in ("at-most", "at-least")
        assert claim.measure in (at_samples([1.0]) if claim.rows else written([1.0])).numbers
        assert not isinstance(claim.bound, str) or claim.bound in CONTROLLERS


def test_groups_are_claimed_of_as_a_whole():
    """A claim about the worst of a group is about every situation of the group that it can be about."""
    of_group = {
        name: tuple(row.name for row in MISMATCHES if row.group == name) for name in ("late", "stomachs", "guarded")
    }
    assert BY_ID["late.lowest"].rows == of_group["late"]
    assert BY_ID["stomachs.undershoot-95"].rows == of_group["stomachs"]
    assert BY_ID["guarded.worse"].rows == of_group["guarded"]
    still = tuple(row.name for row in MISMATCHES if row.group == "setpoints" and row.variance == 0.0)
    assert BY_ID["setpoints.swing"].rows == still


def test_the_bounds_of_oscillation_are_those_that_are_computed():
    assert BY_ID["dead-time-10.crossings"].bound == CROSSINGS_PER_MEAL - 1
    assert BY_ID["dead-time-10.turns"].bound == TURNS_PER_MEAL - 1
    assert f"±{SWING_MG_DL:g} mg/dl in the last {LATE_MIN:g} min" in BY_ID["dead-time-10.swings"].what


def test_medians_and_percentiles_decide(found_of, written):
    found = found_of({"noise": written([1.5, 2.4, 5.0])})
    assert number(found["noise.undershoot"]) == pytest.approx(2.4)
    assert holds(found["noise.undershoot"])
    assert number(found["noise.undershoot-95"]) == pytest.approx(5.0 - 0.1 * 2.6)
    assert not holds(found["noise.undershoot-95"])


def test_a_claim_holds_at_its_very_bound_and_not_beyond(found_of, written):
    at, beyond = (found_of({"announced": written([dip])}) for dip in (0.999, 1.001))
    assert holds(at["announced.deviation"])
    assert not holds(beyond["announced.deviation"])


def test_insulin_is_held_against_mpc_se_on_the_same_runs(found_of, written):
    ours = written([5.0, 5.0, 5.0], variation=500.0)
    for theirs, kept in ((501.0, True), (499.0, False)):
        found = found_of({"noise": ours}, {"mpc-se": written([5.0, 5.0, 5.0], variation=theirs)})["noise.variation"]
        assert (found.bound, number(found), holds(found)) == (theirs, 500.0, kept)


def test_one_seed_too_low_is_too_many(found_of, written):
    low = found_of({"dead-time-15": written([3.0, 3.0, 21.2]), "people": written([3.0, 3.0, 21.2])})
    assert number(low["dead-time-15.lowest"]) == pytest.approx(59.9)
    assert not holds(low["dead-time-15.lowest"])
    assert number(low["people.below-60"]) == 1.0
    assert not holds(low["people.below-60"])
    assert holds(found_of({"dead-time-15": written([3.0, 3.0, 21.0])})["dead-time-15.lowest"])


def test_time_near_the_setpoint_counts_minutes(found_of, written):
    # 20 exp(-(t/40)^2) is beyond 15 for |t| < 40 sqrt(ln 4/3) = 21.45: 43 of 601 minutes
    found = found_of({"people": written([20.0, 20.0, 20.0])})["people.near"]
    assert number(found) == pytest.approx(100.0 * (601 - 43) / 601)
    assert not holds(found)


def test_oscillation_is_judged_without_noise_and_in_the_last_minutes(found_of, written):
    swing = 6.0 * np.sin(2.0 * np.pi * np.arange(201) / 80.0)  # beyond 5 on both sides, two and a half times
    calm = 4.9 * np.sin(2.0 * np.pi * np.arange(201) / 80.0)
    found = found_of({"dead-time-10": written([9.0], late=swing, quiet=(2.0, 8.0))})
    assert number(found["dead-time-10.swings"]) == 4.0
    assert not holds(found["dead-time-10.swings"])
    assert holds(found["dead-time-10.crossings"])
    assert not holds(found["dead-time-10.turns"])
    extent = Extent(seed=1, seeds=3)
    assert BY_ID["dead-time-10.turns"].runs_in_words(extent) == "one run, as of seed 1"
    assert BY_ID["dead-time-10.swings"].runs_in_words(extent) == "seeds 1 to 3"
    assert holds(found_of({"dead-time-10": written([9.0], late=calm)})["dead-time-10.swings"])


def test_what_is_not_a_number_holds_nothing(found_of, written):
    runs = written([1.0])
    runs.numbers["undershoot_mg_dl"][:] = np.nan
    assert not holds(found_of({"noise-free": runs})["noise-free.undershoot"])
    assert not holds(found_of({"dead-time-10": written([1.0])})["dead-time-10.turns"])  # never tried
    lost = written([1.0], variation=np.nan)
    assert not holds(found_of({"noise": written([1.0])}, {"mpc-se": lost})["noise.variation"])


def test_the_worst_of_several_situations_decides(found_of, at_samples):
    names = [row.name for row in MISMATCHES if row.group == "stomachs"]
    rows = {name: at_samples([3.0, 4.0]) for name in names[:-1]} | {names[-1]: at_samples([9.1])}
    found = found_of(rows)["stomachs.undershoot-95"]
    assert number(found) == pytest.approx(9.1)
    assert not holds(found)
    assert found.claim.runs_in_words(Extent(seed=1, seeds=3)) == "3 runs of seed 1; 10 situations"
    low = {"people, late 10 min, correlated": [20.0, 27.1], "corners, late 10 min, correlated": [26.9]}
    lowest = found_of({name: at_samples(dips) for name, dips in low.items()})["late.lowest"]
    assert number(lowest) == pytest.approx(53.9)
    assert not holds(lowest)


def test_a_mean_off_the_setpoint_counts_to_either_side(found_of, at_samples):
    rows = {name: at_samples([0.0]) for name in ("fasting, no noise", "fasting, white")}
    rows["fasting, white"].numbers["late_offset_mg_dl"][:] = -0.31
    found = found_of(rows)["fasting.offset"]
    assert number(found) == 0.31
    assert not holds(found)


def test_a_fault_is_compared_with_the_same_people_without_it(found_of, at_samples):
    """Glucose is below 60 mg/dl at some of 121 samples."""
    faulty = {row.name: at_samples([0.0, 0.0, 30.0], samples=3) for row in MISMATCHES if row.group == "guarded"}
    same = found_of(faulty)["guarded.worse"]
    assert number(same) == 0.0
    assert holds(same)
    worse = found_of(faulty | {"guarded, no fault": at_samples([0.0, 0.0, 30.0], samples=1)})["guarded.worse"]
    assert number(worse) == pytest.approx(100.0 * 2 / 121)
    assert not holds(worse)


def test_a_situation_that_was_not_run_has_no_verdict(found_of, at_samples):
    found = found_of({"fasting, white": at_samples([2.0, 2.2, 2.4])})
    assert set(found) == {"fasting.noise", "fasting.noise-95", "fasting.variation"}


def test_percentiles_are_those_of_numpy(written):
    values = written([4.0, 6.0, 7.0]).numbers["deviation_mg_dl"]
    assert spread(values) == {"p5": pytest.approx(4.2), "median": pytest.approx(6.0), "p95": pytest.approx(6.9)}
