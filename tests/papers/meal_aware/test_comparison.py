"""Claims: which number stands for a claim, and when it holds."""

import numpy as np
import pytest

from glucoloop.bounds import OptimalDoses, distance_to_bound
from glucoloop.papers.meal_aware.claims import CLAIMS
from glucoloop.papers.meal_aware.comparison import distances, runs_told, spread, verdicts
from glucoloop.papers.meal_aware.mismatches import GROUPS, MISMATCHES
from glucoloop.papers.meal_aware.situations import CHOICES, CONTROLLERS, OURS
from glucoloop.tuning.oscillation import Oscillation


def _by_id(study):
    return {verdict.claim.id: verdict for verdict in verdicts(study)}


def _quiet(crossings, turns):
    return Oscillation(crossings=np.asarray(crossings), turns=np.asarray(turns), oscillates=np.asarray(False))


def test_every_claim_is_about_a_situation_that_is_run():
    assert {claim.situation for claim in CLAIMS} == set(CHOICES)
    assert len({claim.id for claim in CLAIMS}) == len(CLAIMS)
    rows = {row.name: row.group for row in MISMATCHES}
    for claim in CLAIMS:
        assert bool(claim.rows) == (claim.situation in GROUPS)
        assert {rows[name] for name in claim.rows} <= {claim.situation}


def test_medians_and_percentiles_decide(study_of, written):
    found = _by_id(study_of({"noise": written([5.0, 5.9, 9.0])}))
    assert found["noise.undershoot"].ours == pytest.approx(5.9)
    assert found["noise.undershoot"].holds
    assert found["noise.undershoot-95"].ours == pytest.approx(9.0 - 0.1 * 3.1)
    assert not found["noise.undershoot-95"].holds


def test_a_claim_holds_at_its_very_bound_and_not_beyond(study_of, written):
    at, beyond = (_by_id(study_of({"announced": written([dip])})) for dip in (0.999, 1.001))
    assert at["announced.deviation"].holds
    assert not beyond["announced.deviation"].holds


def test_insulin_is_held_against_mpc_se_on_the_same_runs(study_of, written):
    ours = written([5.0, 5.0, 5.0], variation=500.0)
    for theirs, holds in ((501.0, True), (499.0, False)):
        study = study_of({"noise": ours}, {"mpc-se": written([5.0, 5.0, 5.0], variation=theirs)})
        verdict = _by_id(study)["noise.variation"]
        assert (verdict.bound, verdict.ours, verdict.holds) == (theirs, 500.0, holds)


def test_one_seed_too_low_is_too_many(study_of, written):
    low = _by_id(study_of({"dead-time-15": written([3.0, 3.0, 21.2]), "people": written([3.0, 3.0, 21.2])}))
    assert low["dead-time-15.lowest"].ours == pytest.approx(59.9)
    assert not low["dead-time-15.lowest"].holds
    assert low["people.below-60"].ours == 1.0
    assert not low["people.below-60"].holds
    assert _by_id(study_of({"dead-time-15": written([3.0, 3.0, 21.0])}))["dead-time-15.lowest"].holds


def test_time_near_the_setpoint_counts_minutes(study_of, written):
    # 20 exp(-(t/40)^2) is beyond 15 for |t| < 40 sqrt(ln 4/3) = 21.45: 43 of 601 minutes
    study = study_of({"people": written([20.0, 20.0, 20.0])})
    found = _by_id(study)["people.near"]
    assert found.ours == pytest.approx(100.0 * (601 - 43) / 601)
    assert not found.holds


def test_oscillation_is_judged_without_noise_and_in_the_last_minutes(study_of, written):
    swing = 6.0 * np.sin(2.0 * np.pi * np.arange(201) / 80.0)  # beyond 5 on both sides, two and a half times
    calm = 4.9 * np.sin(2.0 * np.pi * np.arange(201) / 80.0)
    found = _by_id(study_of({"dead-time-10": written([9.0], late=swing, quiet=_quiet(2, 8))}))
    assert found["dead-time-10.swings"].ours == 4.0
    assert not found["dead-time-10.swings"].holds
    assert found["dead-time-10.crossings"].holds
    assert not found["dead-time-10.turns"].holds
    assert (found["dead-time-10.turns"].runs, found["dead-time-10.swings"].runs) == (
        "one run, as of seed 1",
        "seeds 1 to 3",
    )
    assert _by_id(study_of({"dead-time-10": written([9.0], late=calm, quiet=_quiet(3, 7))}))[
        "dead-time-10.swings"
    ].holds


def test_what_is_not_a_number_holds_nothing(study_of, written):
    loops = written([1.0])
    loops.numbers["undershoot_mg_dl"][:] = np.nan
    assert not _by_id(study_of({"noise-free": loops}))["noise-free.undershoot"].holds
    assert not _by_id(study_of({"dead-time-10": written([1.0])}))["dead-time-10.turns"].holds  # never tried


def test_the_worst_of_several_situations_decides(study_of, at_samples):
    names = [row.name for row in MISMATCHES if row.group == "stomachs"]
    study = study_of({}, rows={name: at_samples([3.0, 4.0]) for name in names[:-1]} | {names[-1]: at_samples([9.1])})
    verdict = _by_id(study)["stomachs.undershoot-95"]
    assert verdict.ours == pytest.approx(9.1)
    assert not verdict.holds
    assert verdict.runs == "3 runs of seed 1; 10 situations"


def test_a_fault_is_compared_with_the_same_people_without_it(study_of, at_samples):
    """Glucose is below 60 mg/dl at some of 121 samples."""
    faulty = {row.name: at_samples([0.0, 0.0, 30.0], samples=3) for row in MISMATCHES if row.group == "guarded"}
    same = _by_id(study_of({}, rows=faulty))["guarded.worse"]
    assert same.ours == 0.0
    assert same.holds
    less = faulty | {"guarded, no fault": at_samples([0.0, 0.0, 30.0], samples=1)}
    worse = _by_id(study_of({}, rows=less))["guarded.worse"]
    assert worse.ours == pytest.approx(100.0 * 2 / 121)
    assert not worse.holds


def test_a_situation_that_was_not_run_has_no_verdict(study_of, at_samples):
    found = _by_id(study_of({}, rows={"fasting, white": at_samples([2.0, 2.2, 2.4])}))
    assert set(found) == {"fasting.noise", "fasting.noise-95", "fasting.variation"}


def test_runs_are_told(study_of, written):
    study = study_of({"noise-free": written([1.0]), "noise": written([1.0]), "people": written([1.0])}, seed=7)
    assert runs_told(study, "noise-free") == "one run"
    assert runs_told(study, "noise") == "seeds 7 to 9"
    assert runs_told(study, "people") == "people 0 to 2 of seed 7"


def test_distance_is_that_to_the_bound_of_each_run(study_of, written):
    loops = written([4.0, 6.0, 7.0])
    study = study_of({"noise": loops})
    nothing = np.zeros(1)
    bound = OptimalDoses(
        t_min=nothing,
        insulin_mU_min=nothing,
        fine_t_min=loops.t_min,
        glucose_mg_dl=np.full(601, 81.1),
        setpoint_mg_dl=81.1,
        basal_insulin_mU_min=25.6,
        known_after_min=0.0,
        objective="deviation",
        bound=0.15,
        deviation_mg_dl=0.15,
        undershoot_mg_dl=0.15,
        peak_mg_dl=81.25,
        settling_min=0.0,
        settled=True,
        converged=True,
        iterations=1,
        optimality=0.0,
    )
    study = type(study)(**{**vars(study), "bounds": {"noise": bound}})
    each = [distance_to_bound(run, bound).distance_mg_dl for run in loops.glucose_mg_dl.T]
    found = distances(study, "noise")
    assert set(found) == set(CONTROLLERS)
    assert found[OURS]["median"] == pytest.approx(np.median(each))
    assert found[OURS]["p95"] == pytest.approx(np.percentile(each, 95.0))
    assert spread(loops)["deviation_mg_dl"]["p5"] == pytest.approx(4.2)
