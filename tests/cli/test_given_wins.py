"""Options beside a configuration file: those given on the command line win, in every command that takes both."""

import pytest

from glucoloop.cli.app import app
from glucoloop.config.identification import identification_keys
from glucoloop.config.trial import trial_keys
from requests_read import request_of


def own_keys(read):
    return read.keys()


MANY = ("compare", "trial", "stress", "adversary")
KEYS_OF = {
    "run": own_keys,
    "compare": own_keys,
    "bound": own_keys,
    "tune": own_keys,
    "robust": own_keys,
    "trial": trial_keys,
    "stress": own_keys,
    "adversary": own_keys,
    "detect": own_keys,
    "identify": identification_keys,
    "export": own_keys,
    "hil": own_keys,
}
LATE = {"noise_variance": 1.0, "dead_time_min": 5.0}
CASES = {"case": [{"label": "a", "controller": "mpc", "move_weight": 1.0}, {"label": "b", "controller": "pid"}]}


def read(command, given, of_file):
    """The configuration of a command, from its options and the keys of its file."""
    given, of_file = dict(given), {key: list(of) if isinstance(of, list) else of for key, of in of_file.items()}
    return KEYS_OF[command](request_of(command, given, of_file))


def cases_of(found):
    return {case["label"]: case for case in found["case"]}


def test_every_command_with_a_file_is_here():
    commands = {command.name: command.callback.__signature__.parameters for command in app.registered_commands
                if hasattr(command.callback, "__signature__")}  # fmt: skip
    assert {name for name, parameters in commands.items() if "config" in parameters} == KEYS_OF.keys()


@pytest.mark.parametrize("command", KEYS_OF)
def test_number_given_wins_and_the_rest_of_the_file_stands(command):
    more = CASES if command in ("compare", "trial", "stress", "adversary") else {}
    found = read(command, {"noise_variance": 2.0}, {**LATE, **more})
    assert found["noise_variance"] == 2.0
    assert found["dead_time_min"] == 5.0


@pytest.mark.parametrize(
    "command", ["run", "compare", "trial", "detect", "bound", "robust", "tune", "stress", "adversary"]
)
def test_meals_given_take_the_place_of_those_of_the_file(command):
    more = CASES if command in MANY else {}
    found = read(command, {"meals": ["30g@60min"]}, {"meals": ["50g@50min", "20g@90min"], **more} | (
        {"meal_time_spread_min": 0.0} if command == "detect" else {}))  # fmt: skip
    assert found["meals"] == ["30g@60min"]


@pytest.mark.parametrize("command", ["run", "tune", "detect"])
def test_controller_given_takes_the_place_of_that_of_the_file(command):
    given = {"controller": "mpc-se"}
    assert read(command, given, {"controller": "mpc" if command != "detect" else "basal"})["controller"] == "mpc-se"


def test_controller_given_holds_for_every_case_of_a_comparison():
    of_file = {"case": [{"label": "a", "output_weight": 2.0}, {"label": "b", "controller": "imc", "filter_min": 2.0}]}
    with pytest.raises(ValueError, match=r"--controller pid makes the cases 'a' and 'b' of the file alike; leave it"):
        read("compare", {"controller": "pid"}, of_file)
    of_file["case"][1] = {"label": "b", "controller": "imc", "known_dead_time": True}
    found = cases_of(read("compare", {"controller": "pid"}, of_file))
    assert [case["controller"] for case in found.values()] == ["pid", "pid"]


@pytest.mark.parametrize("command", ["trial", "stress", "adversary"])
def test_controllers_given_take_the_place_of_those_of_the_file(command):
    for of_file in (CASES, {"controllers": ["mpc", "imc"]}, {**CASES, "controllers": ["imc"]}):
        assert list(cases_of(read(command, {"controllers": ["pid"]}, of_file))) == ["pid"]
        assert list(cases_of(read(command, {"cases": ["own: mpc-se"]}, of_file))) == ["own"]
    assert list(cases_of(read(command, {}, CASES))) == ["a", "b"]


def test_cases_given_take_the_place_of_those_of_the_file():
    found = cases_of(read("compare", {"cases": ["x: mpc", "y: imc"]}, CASES))
    assert list(found) == ["x", "y"]


@pytest.mark.parametrize("command", MANY)
def test_setting_given_holds_for_the_cases_of_the_file_that_have_it(command):
    found = cases_of(read(command, {"move_weight": 3.0}, CASES))
    assert found["a"]["move_weight"] == 3.0
    assert "move_weight" not in found["b"]
    found = cases_of(read(command, {"move_weight": 3.0, "cases": ["x: mpc", "y: mpc, move_weight=5"]}, CASES))
    assert (found["x"]["move_weight"], found["y"]["move_weight"]) == (3.0, 5.0)


@pytest.mark.parametrize("command", MANY)
def test_setting_that_no_case_has_is_refused(command):
    with pytest.raises(ValueError, match=r"^--filter-min is a setting of none of these controllers: mpc, pid; leave"):
        read(command, {"filter_min": 2.0}, CASES)


def test_guard_given_holds_for_the_cases_of_the_file():
    of_file = {"case": [{"label": "a", "guard": True, "guard_low_mg_dl": 60.0}, {"label": "b"}]}
    found = cases_of(read("compare", {"guard_low_mg_dl": 70.0}, of_file))
    assert (found["a"]["guard_low_mg_dl"], found["b"]["guard"]) == (70.0, False)
    found = cases_of(read("compare", {"guard": False}, of_file))
    assert [case["guard"] for case in found.values()] == [False, False]


def test_model_given_takes_the_place_of_the_way_to_identify_one():
    of_file = {"case": [{"label": "a", "memory": 30}, {"label": "b", "move_weight": 2.0}]}
    found = cases_of(read("compare", {"model": "m.json"}, of_file))
    assert [case["model"] for case in found.values()] == ["m.json", "m.json"]
    assert "memory" not in found["a"]
