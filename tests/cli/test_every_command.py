"""Every command: its help fits on two screens, and what is asked for is the same from options, a file and both."""

import re

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from glucoloop.cli.app import command_of, names
from glucoloop.cli.command import SET
from glucoloop.cli.request import command_request
from glucoloop.component.request import configuration_from, read_root
from glucoloop.refusal import Refusal
from glucoloop.situations.run import Run
from glucoloop.situations.situation import Situation
from glucoloop.situations.toml import toml_text
from glucoloop.studies.catalogue import STUDIES
from naming import naming
from requests_read import asked, root_of

MAX_LINES, MAX_OPTIONS, WIDTH = 80, 30, 100
ASKING = tuple(STUDIES)


def files_of(command):
    """What has to be typed without an option, such as the files of a record."""
    return ["a.csv" for option in command_of(command).options if option.is_argument and option.required]


def of_a_patient(command):
    """Whether a command takes settings by their path, and a patient among them."""
    root = root_of(command)
    return SET in command_of(command).options and issubclass(root, Situation) and "patient" not in root.refused


def test_help_fits_on_two_screens(glucoloop, monkeypatch):
    monkeypatch.setenv("COLUMNS", str(WIDTH))
    for command in names():
        with naming(command):
            answer = glucoloop(command, "--help")
            lines = answer.out.splitlines()
            assert answer.code == 0
            assert lines[0].startswith(f"Usage: glucoloop {command}")
            assert max(map(len, lines)) <= WIDTH
            assert len([line for line in lines if re.match(r"  --", line)]) <= MAX_OPTIONS
            assert len(lines) <= MAX_LINES
            for option in command_of(command).options:
                assert option.flag in answer.out


def test_every_option_is_a_sentence():
    for command in names():
        with naming(command):
            flags = [option.flag for option in command_of(command).options]
            assert len(flags) == len(set(flags))
            for option in command_of(command).options:
                assert option.help.endswith("."), option.flag


def test_the_example_of_a_setting_by_its_path_is_one_that_each_command_takes():
    [example] = re.findall(r"like (\S+);", SET.help)
    commands = [name for name in ASKING if of_a_patient(name)]
    assert len(commands) > 5
    for command in commands:
        with naming(command):
            options = command_of(command).options
            files = ["a.csv"] if any(option.flag == "FILE..." for option in options) else []
            given = command_of(command).given([*files, SET.flag, example])
            read = read_root(root_of(command), command_request(given, options).tree)
            assert read.value("patient").value("operating_point") == "fasting-81"


def test_an_unknown_option_is_refused_with_the_likely_one(refused):
    for command in names():
        with naming(command):
            answer = refused(command, "--wobble", "1")
            assert re.match("there is no option --wobble; (see glucoloop|did you mean --)", answer)


def test_a_number_is_refused_by_the_name_of_its_option():
    tried = 0
    for command in ASKING:
        for option in command_of(command).options:
            if option.setting is None or option.setting.kind not in (int, float):
                continue
            about = option.setting.about
            beyond = [
                number
                for number in (about.at_most + 1, about.at_least - 1, about.above, about.below)
                if abs(number) < 5e5
            ]
            for value in ("wobble", *(f"{number:g}" for number in beyond)):
                tried += 1
                with naming(command, option.flag, value):
                    typed = command_of(command).given([option.flag, value, *files_of(command)])
                    with pytest.raises(Refusal) as refused:
                        read_root(root_of(command), command_request(typed, command_of(command).options).tree)
                    assert re.match(rf"{option.flag} is '?{re.escape(value[:6])}", str(refused.value))
                    assert "; give " in str(refused.value)
    assert tried > 200


# Arguments of a run that a file may hold as well.
ARGUMENTS = {
    "--setpoint": st.integers(80, 150).map(str),
    "--noise": st.sampled_from(["1.45", "2"]),
    "--dead-time": st.sampled_from(["5", "10min"]),
    "--meal": st.sampled_from(["none", "50g@50min", "30g@1h/10min"]),
    "--duration": st.sampled_from(["300", "5h"]),
    "--seed": st.integers(0, 2**32 - 1).map(str),
    "--guard": st.sampled_from(["none", "usual", "max_hour=2", "usual, low_mg_dl=70"]),
    "--patient": st.sampled_from(["parker-1999", "operating_point=nominal-22", "hovorka-2004"]),
    "--pump": st.sampled_from(["limited", "max_insulin_mU_min=60", "expiring, samples=3", "resolution_mU_min=1"]),
    "--fault": st.sampled_from(["none", "missing, start_min=1h", "spikes"]),
    "--model": st.sampled_from(["none", "noise_variance=0", "identified, laguerre_functions=3"]),
    "--controller": st.sampled_from(
        ["mpc", "move_weight=2", "mpc, move_weight=3, label=own", "mpc, guard=none", "mpc, guard=(max_hour=2)"]
    ),
    "--integrator": st.sampled_from(["fast", "adaptive"]),
}
several = st.fixed_dictionaries({}, optional=ARGUMENTS)


def typed(options):
    return [f"{flag}={value}" for flag, value in options.items()]


@settings(max_examples=60)
@given(of_file=several, over=several)
def test_a_file_and_options_are_the_same_as_options_at_once(tmp_path_factory, of_file, over):
    lower = asked("run", *typed(of_file), "--allow-unusual")
    place = tmp_path_factory.mktemp("asked") / "a.toml"
    place.write_text(toml_text(lower.tree(whole=True), "run", lower.tree()), encoding="utf-8")
    assert asked("run", "--config", place) == lower
    assert asked("run", "--config", place).tree() == lower.tree()
    disjoint = {flag: value for flag, value in over.items() if flag not in of_file}
    if {"--noise", "--dead-time"} & set(of_file):  # what comes first is inside
        disjoint = {flag: value for flag, value in disjoint.items() if flag not in ("--noise", "--dead-time")}
    if "guard=" in of_file.get("--controller", ""):  # an option replaces the guard of a file's controller, not its own
        disjoint.pop("--guard", None)
    both = asked("run", "--config", place, *typed(disjoint), "--allow-unusual")
    at_once = asked("run", *typed({**of_file, **disjoint}), "--allow-unusual")
    assert both == at_once
    assert both.cases == at_once.cases
    assert both.tree() == at_once.tree()
    assert both.explicit.keys() == at_once.explicit.keys()


@given(options=several)
def test_options_are_those_of_python(options):
    found = asked("run", *typed(options), "--allow-unusual")
    again = configuration_from(Run, found.tree())
    assert again == found
    assert Run(**{name: getattr(found, name) for name in found.explicit}) == found
