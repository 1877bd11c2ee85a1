"""Options beside a configuration file: those given on the command line win, in every command that takes both."""

import pytest

from requests_read import asked

COMMANDS = ("run", "compare", "trial")
FILE = """
sensor = ["white-noise, variance=1", {name = "dead-time", minutes = 5}]
meals = ["50g@50min", "20g@90min"]
guard = {max_hour = 2, low_mg_dl = 60}
[pump]
max_insulin_mU_min = 50
"""
TWO = '[[controller]]\nname = "mpc"\nlabel = "a"\nmove_weight = 1\n[[controller]]\nname = "pid"\nlabel = "b"\n'
ONE = '[controller]\nname = "mpc-se"\nmove_weight = 1\n'


@pytest.fixture
def read(tmp_path):
    """What a command is asked for with a file and options."""

    def with_file(command, *arguments, of_file=FILE, cases=""):
        (tmp_path / "a.toml").write_text(of_file + (cases or (TWO if command == "compare" else "")), encoding="utf-8")
        return asked(command, "--config", tmp_path / "a.toml", *arguments)

    return with_file


@pytest.mark.parametrize("command", COMMANDS)
def test_what_is_given_wins_and_the_rest_of_the_file_stands(read, command):
    found = read(command, "--noise", 2, "--meal", "30g@1h", "--pump", "max_bolus_U=3", "--guard", "low_mg_dl=70")
    assert (found.noise_variance, found.dead_time_min) == (2.0, 5.0)
    assert [part.name for part in found.sensor] == ["white-noise", "dead-time"]
    assert found.meals == ("30g@60min",)
    assert (found.pump.max_insulin_mU_min, found.pump.max_bolus_U) == (50.0, 3.0)
    assert (found.cases[0].guard.max_hour, found.cases[0].guard.low_mg_dl) == (2.0, 70.0)


@pytest.mark.parametrize("command", COMMANDS)
def test_a_part_that_is_named_again_or_none_takes_the_place_of_that_of_the_file(read, command):
    found = read(command, "--sensor", "lag", "--pump", "limited", "--guard", "usual, max_hour=3", "--meal", "none")
    assert [part.name for part in found.sensor] == ["lag"]
    assert found.pump.max_insulin_mU_min == 66.9
    assert (found.cases[0].guard.max_hour, found.cases[0].guard.low_mg_dl) == (3.0, 65.0)
    assert found.meals == ()
    assert read(command, "--sensor", "none", "--guard", "none").sensor == ()
    assert read(command, "--guard", "none").cases[0].guard is None


def test_noise_is_put_inside_a_dead_time_and_either_outside_the_rest(read):
    def chain(*arguments, of_file):
        return [part.name for part in read("run", *arguments, of_file=of_file).sensor]

    assert chain("--noise", 1, "--dead-time", 5, of_file="seed = 1\n") == ["white-noise", "dead-time"]
    late = ("--dead-time", 5, "--sensor", "lag", "--noise", 1)
    assert chain(*late, of_file="seed = 1\n") == ["lag", "white-noise", "dead-time"]
    assert chain("--noise", 1, of_file='sensor = ["lag", "dead-time"]\n') == ["lag", "white-noise", "dead-time"]


def test_settings_without_a_name_change_the_controller_of_the_file(read):
    found = read("run", "--controller", "prediction_horizon=20", cases=ONE).case.controller
    assert (found.name, found.move_weight, found.prediction_horizon) == ("mpc-se", 1.0, 20)
    found = read("run", "--controller", "mpc, prediction_horizon=20", cases=ONE).case.controller
    assert (found.name, found.move_weight, found.prediction_horizon) == ("mpc", 1.0, 20)  # the default one with noise
    found = read("run", "--set", "controller.move_weight=3", cases=ONE).case.controller
    assert (found.name, found.move_weight) == ("mpc-se", 3.0)


@pytest.mark.parametrize("command", ["compare", "trial"])
def test_controllers_given_take_the_place_of_those_of_the_file(read, command):
    found = read(command, "--controller", "imc", "--controller", "mpc, label=x", cases=TWO)
    assert [case.label for case in found.cases] == ["imc", "x"]
    assert [case.label for case in read(command, cases=TWO).cases] == ["a", "b"]


@pytest.mark.parametrize("command", ["compare", "trial"])
def test_a_setting_of_one_of_several_controllers_is_named_by_its_label(read, command):
    found = read(command, "--set", "controller.a.move_weight=3", "--set", "controller.2.closed_loop_min=90", cases=TWO)
    assert found.cases[0].controller.move_weight == 3.0
    assert found.cases[1].controller.closed_loop_min == 90.0
    with pytest.raises(
        ValueError, match=r"the settings name no controller, and there are several \(a, b\); name one, or write --set"
    ):
        read(command, "--controller", "move_weight=3", cases=TWO)
    with pytest.raises(ValueError, match=r"^--set controller.c.move_weight: .* no 'c'; the known ones are: a, b"):
        read(command, "--set", "controller.c.move_weight=3", cases=TWO)


@pytest.mark.parametrize(
    ("option", "path", "value"),
    [
        ("--sensor", "sensor", "none"),
        ("--sensor", "sensor", "lag, lag_min=8"),
        ("--meal", "meals", "30g@1h"),
        ("--meal", "meals", "none"),
        ("--pump", "pump", "max_bolus_U=3"),
        ("--guard", "guard", "low_mg_dl=70"),
        ("--guard", "guard", "none"),
        ("--controller", "controller", "pid, label=x"),
        ("--duration", "duration_min", "2h"),
    ],
)
def test_a_setting_of_the_situation_is_read_by_its_path_as_by_its_option(read, option, path, value):
    assert read("run", "--set", f"{path}={value}").tree() == read("run", option, value).tree()


def test_guard_given_holds_for_the_controllers_of_the_file(read):
    cases = '[[controller]]\nlabel = "a"\nguard = {low_mg_dl = 60, max_hour = 3}\n[[controller]]\nlabel = "b"\n'
    found = read("compare", "--guard", "low_mg_dl=70", of_file="", cases=cases).cases
    assert [(case.guard.low_mg_dl, case.guard.max_hour) for case in found] == [(70.0, 3.0), (70.0, 2.4)]
    assert [case.guard for case in read("compare", "--guard", "none", of_file="", cases=cases).cases] == [None, None]


def test_model_given_takes_the_place_of_that_of_the_file(read, tmp_path):
    cases = '[[controller]]\nlabel = "a"\nmodel = {memory = 30}\n[[controller]]\nlabel = "b"\n'
    found = read("compare", "--model", "m.json", of_file="", cases=cases).cases
    assert [(case.model.name, case.model.path) for case in found] == [("file", "m.json")] * 2
    found = read("compare", "--model", "laguerre_pole=0.8", of_file="", cases=cases).cases
    assert [(case.model.memory, case.model.laguerre_pole) for case in found] == [(30, 0.8), (36, 0.8)]
    of_file = read("run", of_file='model = "m.json"\n').case
    assert of_file.model.path == str(tmp_path / "m.json")  # a path of a file starts at the file
