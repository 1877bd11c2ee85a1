"""A file keeps what was given apart from what was computed: the one stays whatever else changes, the other follows."""

import tomllib
from pathlib import Path

import pytest

from glucoloop.cli.request import configuration_of
from glucoloop.situations.toml import read_toml, toml_text
from requests_read import asked, root_of, typed

UNDER_THE_SKIN = ("--patient", "hovorka-2004")
# Each is the default value of the patient of 1999, and no usual one under the skin.
GIVEN = {
    "move_weight = 0.0": lambda case: case.controller.move_weight == 0.0,
    "prediction_horizon = 8": lambda case: case.controller.prediction_horizon == 8,
    "guard = {max_on_board = 1.3}": lambda case: case.guard.max_on_board == 1.3,
    "model = {memory = 36}": lambda case: case.model.memory == 36,
    "model = {laguerre_functions = 2}": lambda case: case.model.laguerre_functions == 2,
}
TWO = '[[controller]]\nname = "mpc"\nlabel = "b"\n'


@pytest.fixture
def of_file(tmp_path):
    """Write a file; returns the option that names it."""

    def written(text, name="a.toml"):
        (tmp_path / name).write_text(text, encoding="utf-8")
        return ("--config", str(tmp_path / name))

    return written


@pytest.mark.parametrize("command", ["run", "compare", "trial"])
@pytest.mark.parametrize("line", GIVEN)
def test_what_a_file_gives_stays_with_another_patient(of_file, command, line):
    text = f'[[controller]]\nname = "mpc"\nlabel = "a"\n{line}\n{TWO if command == "compare" else ""}'
    found = asked(command, *of_file(text), *UNDER_THE_SKIN)
    assert found.patient.name == "hovorka-2004"
    assert GIVEN[line](found.cases[0])
    usual = asked(command, *of_file(text.replace(line, "")), *UNDER_THE_SKIN).cases[0]
    assert usual.guard is None
    assert (usual.controller.prediction_horizon, usual.model.memory) == (36, 288)


def test_limit_of_a_file_stays_with_another_pump(of_file):
    named = of_file("[pump]\nmax_insulin_mU_min = 40\n")
    assert asked("run", *named).pump.max_insulin_mU_min == 40.0
    assert asked("run", *named, "--pump", "max_change_mU_min=5").pump.max_insulin_mU_min == 40.0
    # a pump that is named is another one, of which the file says nothing
    assert asked("run", *named, "--pump", "expiring, samples=3").pump.max_insulin_mU_min == 66.9


def test_what_follows_from_the_people_stays_where_it_was_given(of_file):
    assert asked("trial", *of_file("shard_people = 40\npeople = 100\n"), "--people", 200).shard_people == 40


def test_a_population_goes_with_its_patient_and_days_with_a_duration(of_file):
    named = of_file('population = "lognormal"\ndays = 3\n')
    assert asked("trial", *named, "--patient", "parker-1999").population.name == "lognormal"
    assert asked("trial", *named, *UNDER_THE_SKIN).population.name == "boiroux2017"
    assert asked("trial", *named, "--duration", "10h").days is None


@pytest.mark.parametrize("command", ["run", "compare", "trial"])
def test_file_is_read_from_what_was_given_alone(of_file, command):
    cases = ("--controller", "mpc, label=a, move_weight=2", "--controller", "pid")
    found = asked(command, "--noise", 2, "--guard", "none", *(cases if command != "run" else cases[:2]))
    everything = found.tree(whole=True)
    text = toml_text(everything, "", found.tree())
    written = read_toml(text, "a.toml")
    assert set(written.keys) == {"sensor", "guard", "controller"}
    assert written.used["seed"] == 0
    again = asked(command, *of_file(text))
    assert again == found
    assert again.tree() == found.tree()
    assert again.tree(whole=True) == everything


def test_table_of_what_was_used_is_a_table(refused, tmp_path):
    (tmp_path / "a.toml").write_text("used = 3")
    assert "used is 3 in a.toml; it is the table of what was used" in refused("run", "--config", "a.toml")


@pytest.mark.long
def test_folder_repeats_the_run_and_follows_another_patient(glucoloop):
    assert glucoloop("run", "--duration", "120", "--controller", "move_weight=2", "--out", "a").code == 0
    written = tomllib.loads(Path("a/run.toml").read_text())
    assert {key: value for key, value in written.items() if key not in ("glucoloop", "used")} == {
        "duration_min": 120.0,
        "controller": [{"name": "mpc", "move_weight": 2.0}],
    }
    assert written["used"]["controller"][0]["model"]["memory"] == 36
    again = glucoloop("run", "--config", "a/run.toml", "--out", "b")
    assert "filled in otherwise" not in again.err
    assert Path("a/trace.csv").read_bytes() == Path("b/trace.csv").read_bytes()
    assert Path("a/run.toml").read_bytes() == Path("b/run.toml").read_bytes()
    other = glucoloop("run", "--config", "a/run.toml", "--patient", "hovorka-2004", "--json")
    assert other.json["config"]["controller"]["model"]["memory"] == 288
    assert other.json["config"]["controller"]["move_weight"] == 2.0
    assert "filled in otherwise" not in other.err


def test_default_that_changed_since_the_file_was_written_is_told(of_file, tmp_path, capsys):
    run = asked("run", "--seed", 3)
    used = run.tree(whole=True)
    used["controller"][0]["model"]["memory"] = 40
    named = of_file(toml_text({**used, "seed": 9}, "", run.tree()))
    configuration_of(typed("run", *named, "--noise", 1), root_of("run"))
    told = " ".join(capsys.readouterr().err.split())
    assert f"What {tmp_path / 'a.toml'} leaves out was filled in otherwise when it was written:" in told
    assert "seed was 9 and is 3" in told
    assert "model.memory of case 'mpc' was 40 and is 36" in told


@pytest.mark.long
def test_tuning_that_was_settled_is_told_beside_what_was_given(glucoloop):
    answer = glucoloop("run", "--controller", "pid", "--duration", "60", "--out", "a", "--json")
    told = answer.json["settled"]
    assert told["gain"] > 0.0
    written = tomllib.loads(Path("a/run.toml").read_text())
    assert written["controller"] == [{"name": "pid"}]
    [used] = written["used"]["controller"]
    assert (used["gain"], used["settled"]) == (0.0, told)
    assert f"gain {told['gain']:.4g}" in Path("a/figure.html").read_text()
    again = glucoloop("run", "--config", "a/run.toml", "--out", "b")
    assert "filled in otherwise" not in again.err
    cases = (
        "--controller",
        "pid",
        "--controller",
        "pid, closed_loop_min=90, label=slow",
        "--guard",
        "--duration",
        "60",
    )
    both = glucoloop("compare", *cases, "--out", "c", "--json").json["cases"]
    assert both["pid"]["settled"] == told
    assert 0.0 < both["slow"]["settled"]["gain"] < told["gain"]
    assert "filled in otherwise" not in glucoloop("compare", "--config", "c/compare.toml").err
