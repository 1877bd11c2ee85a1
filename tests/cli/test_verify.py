"""``glucoloop verify``."""

import json

import polars as pl
import pytest

from glucoloop.metrics.promises import CAPS, DOSE, OF_CONTROLLER, PROMISES
from glucoloop.studies.verification import NONSENSE_SAMPLES, Verification, study
from glucoloop.studies.verification.campaign import circumstances_of, run_campaign
from glucoloop.studies.verification.study import SAME_BITS

KEPT = {
    "controller": "pid",
    "guarded": False,
    "engine": "native",
    "not_native": None,
    "loops": 50,
    "samples": 14400,
    "broken": dict.fromkeys(PROMISES, 0),
    "repeated": 7,
    "not_repeated": [],
    "examples": [],
}
EFFECT = {
    "controller": "pid",
    "pairs": 50,
    "bare_pct": 4.0,
    "guarded_pct": 0.5,
    "better": 20,
    "worse": 1,
    "worst_pct": 1.7,
    "worst_person": 31,
}
HOLDS = [{"arm": KEPT}, {"arm": {**KEPT, "guarded": True}, "guarding": EFFECT}]
AGAIN = "glucoloop verify --seed 3 --controller pid --person 17"
BREACH = {
    "promise": DOSE,
    "person": 17,
    "samples": 4,
    "first_min": 35.0,
    "faults": ["nonsense, key=11, start_min=30, value=nan"],
    "repeat": AGAIN,
}
BROKEN = {"broken": {**KEPT["broken"], DOSE: 1}, "examples": [BREACH], "not_repeated": [8, 9]}
BREAKS = [{"arm": KEPT}, {"arm": {**KEPT, "guarded": True, **BROKEN}, "guarding": EFFECT}]
ASKED = ("verify", "--seed", 3, "--controller", "pid", "--loops", 100)


@pytest.fixture
def finds(monkeypatch):
    """Let the campaign find something; hands back what it was asked for."""
    asked = []

    def find(parts, *, interrupted=False):
        def run(given, progress, done):
            asked.append(given)
            for part in parts[done:]:
                progress(part["arm"]["loops"])
                yield part
            if interrupted:
                raise KeyboardInterrupt

        monkeypatch.setattr(study, "run_campaign", run)
        return asked

    return find


def test_kept_promises_leave_with_0(glucoloop, finds):
    asked = finds(HOLDS)
    answer = glucoloop(*ASKED)
    assert answer.code == 0
    assert [(given.loops, given.seed, given.controllers) for given in asked] == [(100, 3, ("pid",))]
    for promise in (*PROMISES, SAME_BITS):
        line = next(line for line in answer.out.splitlines() if promise in line)
        assert line.split()[-1] == "0"
    assert "100 loops, 28800 samples, " in answer.out
    assert "14 of them closed twice" in answer.out
    assert "\nEvery promise was kept.\n" in answer.out
    of_pid = next(line.split() for line in answer.out.splitlines() if "pid, guarded" in line)
    assert of_pid[-5:] == ["0.50", "20", "1", "+1.7", "31"]


def test_a_broken_promise_leaves_with_1_and_the_command_that_repeats_it(glucoloop, finds):
    finds(BREAKS)
    answer = glucoloop(*ASKED)
    assert answer.code == 1
    line = next(line for line in answer.out.splitlines() if AGAIN in line)
    assert line.startswith(f"pid, guarded, person 17: {DOSE}; broken at 4 samples, first at 35 min; ")
    assert "--fault 'nonsense, key=11, start_min=30, value=nan'" in line
    assert "person 8: other bits; glucoloop verify --seed 3 --controller pid --person 8" in answer.out
    assert f"\nBroken: {DOSE}; {SAME_BITS}.\n" in answer.out


def test_json_is_the_same(glucoloop, finds):
    finds(BREAKS)
    answer = glucoloop(*ASKED, "--json")
    assert answer.code == 1
    found = answer.json
    assert (found["loops"], found["samples"], found["seed"], found["interrupted"]) == (100, 28800, 3, False)
    assert {promise: count for promise, count in found["violations"].items() if count} == {DOSE: 1, SAME_BITS: 2}
    told = found["arms"][1]["examples"][0]
    assert (told["person"], told["faults"], told["repeat"]) == (17, BREACH["faults"], AGAIN)
    assert found["guarding"][0]["worse"] == 1


def test_an_interrupt_tells_what_was_done_and_leaves_with_130(glucoloop, finds):
    finds(HOLDS[:1], interrupted=True)
    answer = glucoloop(*ASKED)
    assert answer.code == 130
    assert "50 loops, 14400 samples" in answer.out
    assert answer.err.splitlines()[-1] == (
        "glucoloop: interrupted; of 100 loops 50 were checked to the end; their results follow."
    )
    found = glucoloop(*ASKED, "--json").json
    assert (found["loops"], found["interrupted"]) == (50, True)


def test_an_interrupted_campaign_goes_on_in_its_folder_and_ends_as_a_whole_one(glucoloop, finds, tmp_path):
    finds(BREAKS[:1], interrupted=True)
    answer = glucoloop(*ASKED, "--out", "a")
    assert answer.code == 130
    assert "1 of 2 parts are kept, the same command goes on" in answer.err
    asked = finds(BREAKS)
    again = glucoloop(*ASKED, "--out", "a")
    assert again.code == 1
    assert "1 of 2 parts of a are there already; going on." in again.err
    assert glucoloop(*ASKED, "--out", "b").code == 1
    of_both = [json.loads((tmp_path / folder / "summary.json").read_text()) for folder in "ab"]
    for found in of_both:
        del found["seconds"]
    assert of_both[0] == of_both[1]
    assert glucoloop(*ASKED, "--out", "a", "--json").json["violations"] == of_both[0]["violations"]
    assert len(asked) == 3  # a finished folder closes no loop


@pytest.mark.parametrize(
    "result",
    [
        "{}",
        '{"arm": 3}',
        json.dumps(HOLDS[1]),
        json.dumps({"arm": {**KEPT, "loops": 40}}),
        json.dumps({"arm": {**KEPT, "broken": {DOSE: "many"}}}),
    ],
)
def test_loops_of_something_else_are_refused(glucoloop, finds, refused, tmp_path, result):
    finds(HOLDS[:1], interrupted=True)
    glucoloop(*ASKED, "--out", "a")
    pl.DataFrame({"result": [result], "seconds": [1.0]}).write_parquet(tmp_path / "a/loops.parquet")
    assert "loops.parquet is damaged: " in refused(*ASKED, "--out", "a")


@pytest.mark.long
def test_the_rest_of_a_campaign_is_that_of_the_whole(monkeypatch):
    monkeypatch.setattr("glucoloop.studies.verification.campaign._horizon_min", lambda name: 100.0)
    config = Verification(loops=20, controllers=("basal", "pid"))
    whole = list(run_campaign(config, lambda loops: None))
    for done in (1, 2, 3):
        counted = []
        assert list(run_campaign(config, counted.append, done)) == whole[done:]
        assert sum(counted) == sum(part["arm"]["loops"] for part in whole[done:])


def test_loops_that_native_code_cannot_take_are_told(glucoloop, finds):
    finds([{"arm": {**KEPT, "engine": "xla", "not_native": "a sort"}}])
    out = " ".join(glucoloop(*ASKED).out.split())
    assert "pid: native code cannot take this loop, which has a sort; JAX ran it" in out


def test_one_person_is_told_with_what_he_meets(glucoloop, finds):
    finds(HOLDS)
    answer = glucoloop("verify", "--seed", 3, "--controller", "pid", "--person", 17)
    person = circumstances_of("pid", 3, 17)
    first = next(line for line in answer.out.splitlines() if line.startswith("pid: lognormal, basal rate "))
    assert all(f"--fault {fault!r}" in first for fault in person["faults"])
    assert all(f"{carbs:.1f}g@{t:.1f}min" in first for t, carbs in person["meals"])


@pytest.mark.long
def test_a_campaign_runs(glucoloop, monkeypatch):
    monkeypatch.setattr("glucoloop.studies.verification.campaign._horizon_min", lambda name: 100.0)
    answer = glucoloop("verify", "--loops", 30, "--controller", "basal")
    assert answer.code == 0
    assert "30 loops, 600 samples, " in answer.out


@pytest.mark.parametrize("broken", [{}, {CAPS: (7, 9)}])
def test_nonsense_is_told_with_the_command_that_repeats_it(glucoloop, monkeypatch, broken):
    told = {promise: broken.get(promise, ()) for promise in OF_CONTROLLER}
    arm = {"controller": "pid", "loops": 50, "samples": 50 * NONSENSE_SAMPLES, "examples": told}
    arm |= {"sample_time_min": 5.0, "precision": "float64"}
    arm["broken"] = {promise: len(loops) for promise, loops in told.items()}
    monkeypatch.setattr(study, "run_nonsense", lambda given, progress, done: iter([{"arm": arm}][done:]))
    asked = ("verify", "--nonsense", 4800, "--seed", 3, "--controller", "pid")
    answer = glucoloop(*asked)
    assert answer.code == (1 if broken else 0)
    assert "4800 samples of guarded controllers with nonsense as inputs, " in answer.out
    assert (f"\nBroken: {CAPS}.\n" if broken else "\nEvery promise was kept.\n") in answer.out
    again = "glucoloop verify --nonsense 1 --sample-time 5 --precision float64 --seed 3 --controller pid --person 9"
    assert (f"pid, guarded, loop 9: {CAPS}; {again}" in answer.out) == bool(broken)
    assert glucoloop(*asked, "--json").json["violations"][CAPS] == len(broken.get(CAPS, ()))


@pytest.mark.parametrize(
    ("given", "told"),
    [
        (("--loops", 0), "--loops is 0; give a whole number from 1 to 1000000000."),
        (("--loops", "many"), "--loops is 'many'; give a whole number from 1 to 1000000000."),
        (("--seed", -1), "--seed is -1; give a whole number from 0 to 4294967295."),
        (("--controller", "pid", "--controller", "pid"), "a controller is named twice in pid, pid; leave one out."),
        (("--person", 1, "--loops", 5), "--loops and --person exclude one another; leave one out."),
        (("--nonsense", 10, "--loops", 5), "--loops and --nonsense exclude one another; leave one out."),
        (("--nonsense", 0), "--nonsense is 0; give a whole number from 1 to 100000000000."),
    ],
)
def test_what_cannot_be_tried_is_refused_in_a_sentence(refused, given, told):
    assert refused("verify", *given) == told


def test_an_unknown_controller_is_answered_with_the_known_ones(refused):
    assert refused("verify", "--controller", "mcp").startswith("unknown controller 'mcp'; ")
