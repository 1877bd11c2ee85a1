"""A file keeps what was given apart from what was computed: the one stays whatever else changes, the other follows."""

import importlib
import tomllib
from pathlib import Path

import pytest

from glucoloop.cli.request import file_keys
from glucoloop.situations.toml import read_toml, toml_text
from glucoloop.config.trial import trial_keys
from requests_read import request_of

UNDER_THE_SKIN = {"patient": "hovorka-2004"}
# Each is the usual value of the patient of 1999, and no usual one under the skin.
GIVEN = {"guard_max_on_board": 1.3, "memory": 36, "laguerre_functions": 2, "move_weight": 0.0, "prediction_horizon": 8}


def read(command, given, of_file):
    return request_of(command, dict(given), dict(of_file))


def used(asked):
    keys = trial_keys(asked) if hasattr(asked, "people") else asked.keys()
    return {**keys, **(keys["case"][0] if "case" in keys else {})}


@pytest.mark.parametrize("command", ["run", "compare", "trial", "export", "hil"])
@pytest.mark.parametrize("key", GIVEN)
def test_what_a_file_gives_stays_with_another_patient(command, key):
    of_file = {"controller": "mpc", "guard": True, key: GIVEN[key]}
    if command == "compare":
        of_file = {"case": [{"label": "a", **of_file}, {"label": "b"}]}
    elif command == "trial":
        of_file = {"case": [{"label": "a", **of_file}]}
    found = used(read(command, UNDER_THE_SKIN, of_file))
    assert found["patient"] == "hovorka-2004"
    assert found[key] == GIVEN[key]


@pytest.mark.parametrize("key", ["max_insulin_mU_min", "max_change_mU_min"])
def test_limit_of_a_file_stays_with_another_pump(key):
    of_file = used(read("run", {}, {}))
    found = used(read("run", {"pump": "expiring, samples=3"}, {key: of_file[key]}))
    assert found[key] == of_file[key]


@pytest.mark.parametrize(
    ("command", "of_file", "upper", "key"),
    [
        ("trial", {"shard_people": 40, "people": 100}, {"people": 200}, "shard_people"),
        ("detect", {"days": 3}, {"people": 2}, "days"),
    ],
)
def test_what_follows_from_the_people_stays_where_it_was_given(command, of_file, upper, key):
    found = read(command, upper, of_file)
    assert getattr(found if command == "trial" else found.own, key) == of_file[key]


@pytest.mark.parametrize("command", ["run", "compare", "trial", "stress", "adversary", "tune", "robust", "detect"])
def test_file_is_read_from_what_was_given_alone(command):
    cases = {"case": [{"label": "a", "move_weight": 2.0}, {"label": "b", "controller": "pid"}]}
    given = {"noise_variance": 2.0, **(cases if command in ("compare", "trial", "stress", "adversary") else {})}
    asked = read(command, {}, given)
    assert asked.given == given
    everything = _keys_of(command)(asked)
    text = toml_text(everything, "", asked.given)
    written = read_toml(text, "a.toml")
    assert written.keys == given
    assert written.used == {key: value for key, value in everything.items() if value is not None}
    assert _keys_of(command)(read(command, {}, written.keys)) == everything


def _keys_of(command):
    return trial_keys if command == "trial" else lambda asked: asked.keys()


def test_table_of_what_was_used_is_a_table(refused, tmp_path):
    (tmp_path / "a.toml").write_text("used = 3")
    assert "used is 3 in a.toml; it is the table of what was used" in refused("run", "--config", "a.toml")


@pytest.mark.long
def test_folder_repeats_the_run_and_follows_another_patient(glucoloop):
    assert glucoloop("run", "--duration", "120", "--move-weight", "2", "--out", "a").code == 0
    written = tomllib.loads(Path("a/run.toml").read_text())
    assert {key: value for key, value in written.items() if key not in ("glucoloop", "used")} == {
        "duration_min": 120.0,
        "move_weight": 2.0,
    }
    assert written["used"]["memory"] == 36
    again = glucoloop("run", "--config", "a/run.toml", "--out", "b")
    assert "filled in otherwise" not in again.err
    assert Path("a/trace.csv").read_bytes() == Path("b/trace.csv").read_bytes()
    assert Path("a/run.toml").read_bytes() == Path("b/run.toml").read_bytes()
    other = glucoloop("run", "--config", "a/run.toml", "--patient", "hovorka-2004", "--json")
    assert other.json["config"]["memory"] == 288
    assert other.json["config"]["move_weight"] == 2.0
    assert "filled in otherwise" not in other.err


def test_default_that_changed_since_the_file_was_written_is_told(tmp_path, capsys):
    place = tmp_path / "run.toml"
    run = read("run", {}, {"seed": 3})
    place.write_text(toml_text({**run.keys(), "memory": 40, "seed": 9}, "", run.given))
    request = importlib.import_module("glucoloop.cli.request")
    command = importlib.import_module("glucoloop.cli.run")
    request.read_again(command._read, request.keys_used, {"noise_variance": 1.0}, file_keys(place))
    told = " ".join(capsys.readouterr().err.split())
    assert f"What {place} leaves out was filled in otherwise when it was written:" in told
    assert "seed was 9 and is 3; memory was 40 and is 36." in told


@pytest.mark.long
def test_tuning_that_was_settled_is_told_beside_what_was_given(glucoloop):
    answer = glucoloop("run", "--controller", "pid", "--duration", "60", "--out", "a", "--json")
    told = answer.json["settled"]
    assert told["gain"] > 0.0
    written = tomllib.loads(Path("a/run.toml").read_text())
    assert "gain" not in written
    assert (written["used"]["gain"], written["used"]["settled"]) == (0.0, told)
    assert f"gain {told['gain']:.4g}" in Path("a/figure.html").read_text()
    again = glucoloop("run", "--config", "a/run.toml", "--out", "b")
    assert "filled in otherwise" not in again.err
    cases = ("--case", "pid", "--case", "slow: pid, closed_loop_min=90", "--guard", "--duration", "60")
    both = glucoloop("compare", *cases, "--out", "c", "--json").json["cases"]
    assert both["pid"]["settled"] == told
    assert 0.0 < both["slow"]["settled"]["gain"] < told["gain"]
    assert "filled in otherwise" not in glucoloop("compare", "--config", "c/compare.toml").err
