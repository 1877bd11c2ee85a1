"""Exercise and rhythms on the command line, with built-in families and with a patient of one's own."""

import json
import shlex
import shutil
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from glucoloop.situations.situation import configured
from glucoloop.trials.engine import alone, prepare, run_people
from glucoloop.trials.trial import Trial

EXAMPLE = Path(__file__).parents[2] / "examples" / "bergman.py"
BOUT = ("--exercise", "40%@2h/30min")
EVERY_DAY = ("--exercise", "40%@14h/45min", "--exercise-spread", "30%", "--exercise-time-spread", "1h")


@pytest.fixture
def own(tmp_path, monkeypatch):
    """The module of the example in the current folder, of which no entry point tells."""
    shutil.copy(EXAMPLE, tmp_path / "bergman.py")
    monkeypatch.syspath_prepend(tmp_path)
    return "bergman:Minimal"


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (BOUT, "the equations of parker-1999 have no exercise, so it would change nothing; leave it out, or take a"),
        (("--rhythm", "dawn"), "does not declare which of its constants are its glucose production"),
        (("--rhythm", "noon"), "unknown rhythm 'noon'; the known ones are: visentin-2015, dawn, sensitivity"),
        (
            ("--patient", "mcgill-2020", "--exercise", "40@2h"),
            "'40@2h' is not exercise; write its intensity in percent",
        ),
        (
            ("--patient", "mcgill-2020", "--exercise", "40%@20h/30min"),
            "the exercise at 1200 min begins after the end at",
        ),
        (
            ("--patient", "mcgill-2020", "--exercise", "140%@2h/30min"),
            "exercise of 140 % is not possible; give more than 0",
        ),
    ],
)
def test_what_is_not_possible_is_told(glucoloop, arguments, told):
    answer = glucoloop("run", "--controller", "pid", *arguments)
    assert answer.code == 2
    assert told in " ".join(answer.err.split())


def test_a_record_from_which_a_model_is_identified_has_neither(glucoloop):
    for option in (BOUT, ("--rhythm", "dawn")):
        assert glucoloop("identify", "--patient", "mcgill-2020", *option).code == 2


@pytest.mark.long
def test_a_run_tells_of_both_and_is_repeated(glucoloop):
    both = (*BOUT, "--rhythm", "dawn", "--rhythm", "visentin-2015, pattern=lhl")
    patient = ("--patient", "mcgill-2020", "--controller", "pid", "--duration", "600")
    told = glucoloop("run", *patient, *both, "--out", "a")
    assert told.code == 0
    assert "The rhythm begins with the run: the patient rests at the start" in told.out
    page = Path("a/figure.html").read_text()
    assert "Exercise: 40 % for 30 min at 120 min." in page
    assert "fall_min=120; visentin-2015, pattern=lhl, day_spread_pct=20" in page
    assert "explicit Runge-Kutta integrator" in page
    trace = pl.read_csv("a/trace.csv")
    assert trace.filter(pl.col("exercise_pct") > 0.0)["t_min"].to_list() == [120.0 + 5.0 * i for i in range(6)]
    assert glucoloop("run", "--config", "a/run.toml", "--out", "b").code == 0
    assert Path("a/trace.csv").read_bytes() == Path("b/trace.csv").read_bytes()
    adaptive = glucoloop("run", *patient, *both, "--integrator", "adaptive", "--out", "c")
    assert adaptive.code == 0
    glucose = [pl.read_csv(f"{folder}/trace.csv")["glucose_mg_dl"].to_numpy() for folder in "ac"]
    np.testing.assert_allclose(*glucose, rtol=0.0, atol=0.01)


@pytest.mark.long
def test_a_person_of_a_trial_is_the_loop_of_one():
    keys = {
        "patient": "mcgill-2020",
        "people": 8,
        "days": 2,
        "controller": ["pid"],
        "start": "02:00",
        "exercise": ["40%@10h/30min", "60%@20h/20min"],
        "exercise_spread_pct": 40.0,
        "exercise_time_spread_min": 100.0,
        "rhythm": ["visentin-2015", "dawn"],
    }
    trial = configured(Trial, keys)
    prepared = prepare(trial)
    found = run_people(prepared, trial.case.label, np.arange(8), traces=True)
    assert prepared.engines[trial.case.label] == {"engine": "native"}
    for person in (0, 5):
        trace = alone(prepared, trial.case.label, person)
        np.testing.assert_allclose(found.glucose_mg_dl[:-1, person], trace.glucose_mg_dl, rtol=0.0, atol=1e-4)
        assert len(trial.exercise_of(person)) == 4
    assert np.ptp(found.glucose_mg_dl[-1]) > 1.0
    fewer = run_people(prepared, trial.case.label, np.array([5, 1]), traces=True)
    np.testing.assert_array_equal(fewer.glucose_mg_dl, found.glucose_mg_dl[:, [5, 1]])


@pytest.mark.long
def test_the_page_of_a_trial_marks_exercise(glucoloop):
    one = ("--patient", "roy-parker-2007", "--controller", "pid", "--people", "4", *EVERY_DAY, "--out", "t")
    assert glucoloop("trial", *one).code == 0
    page = Path("t/report.html").read_text()
    assert "40 % for 45 min" in page
    assert "40%@840min/45min; varied by 30 % and 60 min" in page


COMMANDS = {
    "run": f"--controller mpc {shlex.join(BOUT)} --rhythm visentin-2015",
    "compare": f"--controller pid --controller mpc {shlex.join(BOUT)}",
    "trial": f"--people 4 --controller pid {shlex.join(EVERY_DAY)} --rhythm 'visentin-2015, pattern=hhl' --out out",
    "bound": f"--duration 300 {shlex.join(BOUT)}",
    "stress": f"--people 4 --controller pid --fault 'missing, duration_min=30' {shlex.join(BOUT)} --out out",
    "identify": "",
}


@pytest.mark.long
@pytest.mark.parametrize("command", COMMANDS)
def test_a_patient_of_twenty_lines_is_at_home(own, glucoloop, command):
    answer = glucoloop(command, *shlex.split(COMMANDS[command]), "--patient", own, "--json")
    assert answer.code == 0, answer.err
    if command == "trial":
        [controller] = json.loads(answer.out)["controllers"].values()
        assert controller["engine"] == "native"
