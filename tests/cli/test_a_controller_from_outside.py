"""A controller that another package brings is at home in every command."""

import sys
from pathlib import Path
from typing import Annotated

import polars as pl
import pytest

from glucoloop.component.code import entry_point
from glucoloop.component.request import Request, completed
from glucoloop.component.setting import About
from glucoloop.control.catalogue import CONTROLLERS
from glucoloop.control.part import ControllerComponent
from glucoloop.situations.toml import toml_text
from requests_read import asked

EXAMPLE = Path(__file__).parents[2] / "examples" / "your_own_controller.py"
NAME = "your_own_controller:YourOwnPI"
SHORT = ("--duration", "120", "--meal", "20g@20min")


@pytest.fixture
def outside(install, tmp_path):
    """A folder with the module, and an entry point that names it."""
    install("your_own_controller", "controllers", "your-own-pi", "YourOwnPI")
    return tmp_path


def test_it_is_found_by_its_entry_point_and_by_its_place(outside):
    assert "your-own-pi" in CONTROLLERS.names()
    assert CONTROLLERS.find("your-own-pi") == CONTROLLERS.find(NAME)


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (("--controller", "nobody"), "unknown controller 'nobody'; the known ones are: mpc, mpc-se"),
        (("--controller", "no_such_module:X"), "no_such_module cannot be imported: ModuleNotFoundError"),
        (("--controller", "no_such_module:X"), "check its name, and that it is installed for this Python or lies in"),
        (("--controller", "your_own_controller:NO"), "your_own_controller has no NO; name what it defines"),
        (
            ("--controller", "your_own_controller:Observation"),
            "your_own_controller:Observation is no controller: make it a class of ControllerComponent",
        ),
        (("--controller", f"{NAME}, integral_h=9"), "has no setting 'integral_h'; did you mean 'integral_min'?"),
        (
            ("--controller", f"{NAME}, integral_min=-1"),
            "--controller: your-own-pi: integral_min is -1 min; give a finite number above 0 min",
        ),
        (("--controller", f"{NAME}, integral_min=much"), "integral_min is 'much'; give a finite number"),
        (("--controller", f"{NAME}, move_weight=1"), "your-own-pi has no setting 'move_weight'"),
        (("--controller", "integral_min=9"), "the controller mpc has no setting 'integral_min'"),
    ],
)
def test_what_is_wrong_is_told(outside, refused, arguments, told):
    assert told in refused("run", *arguments)


@pytest.mark.long
def test_a_run_is_read_again_from_its_folder(outside, glucoloop):
    given = ("--controller", "your-own-pi, integral_min=60", *SHORT)
    answer = glucoloop("run", *given, "--out", "a", "--json")
    assert answer.code == 0, answer.err
    config = answer.json["config"]["controller"]
    assert (config["name"], config["integral_min"], config["proportional_gain"]) == ("your-own-pi", 60.0, 0.6)
    assert glucoloop("run", "--config", "a/run.toml", "--json").json["config"] == answer.json["config"]
    other = asked("run", "--config", "a/run.toml", "--controller", "basal").case.controller
    assert (other.name, other.values()) == ("basal", {})


@pytest.mark.parametrize("command", ["compare", "trial", "stress", "adversary"])
def test_cases_have_settings_of_their_own(outside, command):
    cases = [f"{NAME}, integral_min=30, label=quick", f"{NAME}, label=slow", "basal, label=none"]
    found = asked(command, *(f"--controller={case}" for case in cases))
    assert settings_of(found) == {"quick": 30.0, "slow": 150.0, "none": None}
    Path("asked.toml").write_text(toml_text(found.tree(), ""))
    assert asked(command, "--config", "asked.toml") == found
    changed = asked(command, "--config", "asked.toml", "--set", "controller.slow.integral_min=90")
    assert settings_of(changed) == {"quick": 30.0, "slow": 90.0, "none": None}


def settings_of(found):
    return {case.label: getattr(case.controller, "integral_min", None) for case in found.cases}


def test_a_test_of_estimators_takes_its_settings(outside):
    assert asked("detect", "--controller", f"{NAME}, integral_min=30").case.controller.integral_min == 30.0


def test_it_is_not_tuned_unless_its_entry_says_so(outside, refused):
    assert "cannot be tuned; the known ones are: mpc, mpc-se, nlqdmc-se" in refused("tune", "--controller", NAME)


def test_a_setting_that_every_case_has_is_refused(outside, refused):
    Path("clash.py").write_text(EXAMPLE.read_text().replace("integral_min", "faults"))
    told = refused("run", "--controller", "clash:YourOwnPI")
    assert told.startswith("the controller clash:YourOwnPI has a setting 'faults', which every case has already")


@pytest.mark.long
def test_a_trial_designs_it_for_each_person(outside, glucoloop):
    cases = ("--controller", f"{NAME}, integral_min=60, label=mine", "--controller", "basal, label=none")
    answer = glucoloop("trial", "--people", "4", *cases, "--design", "individual", *SHORT, "--out", "t", "--json")
    assert answer.code == 0, answer.err
    people = pl.concat([pl.read_parquet(path) for path in sorted(Path("t").rglob("people*.parquet"))])
    assert people.height == 8
    varied = people.group_by("controller").agg(pl.col("insulin_total_variation_mU_min").min())
    assert dict(varied.iter_rows())["mine"] > dict(varied.iter_rows())["none"] == 0.0


@pytest.mark.parametrize(
    ("changed", "told"),
    [
        ({"tunable": True}, "the controller x cannot be tunable: it lacks one of move_horizon"),
        ({"individual": ":f"}, "':f' of the controller x is no place"),
        ({"name": 1, "__annotations__": {"name": "int"}}, "a setting of X is called 'name', as of every component"),
        ({"request": 1, "__annotations__": {"request": "int"}}, "a setting of X is called 'request', as of every"),
    ],
)
def test_a_part_that_cannot_be_meant_is_refused(changed, told):
    with pytest.raises(TypeError, match=told):
        type("X", (ControllerComponent,), changed, name="x")


def test_a_setting_that_does_not_say_what_it_means_is_refused():
    class Mistyped(ControllerComponent, name="mistyped"):
        k: Annotated[int, About("")] = "a"

    class Unsaid(ControllerComponent, name="unsaid"):
        k: int = 1

    with pytest.raises(ValueError, match="k is 'a', a str; give a whole number"):
        completed(Request(Mistyped))
    with pytest.raises(TypeError, match=r"the setting k does not say what it means; annotate it, like k: Annotated"):
        Unsaid()


COMMANDS = {
    "trial": ("--people", "2", *SHORT),
    "stress": ("--people", "4", "--fault", "missing, start_min=20, duration_min=30", *SHORT),
    "adversary": ("--people", "4", "--generations", "2", "--error", "10", *SHORT),
    "verify": ("--loops", "20"),
    "detect": ("--days", "1"),
}
WITH_FOLDER = ("trial", "stress", "adversary")


@pytest.mark.long
@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_takes_it(outside, glucoloop, command):
    folder = ("--out", "out") if command in WITH_FOLDER else ()
    answer = glucoloop(command, *COMMANDS[command], *folder, "--controller", NAME)
    # it leaves the pump's limits to the pump, and verify finds that: the promise about what is asked for is broken
    assert answer.code == (1 if command == "verify" else 0), answer.err


@pytest.mark.long
def test_a_folder_goes_on_only_with_the_code_that_began_it(glucoloop, refused, outside):
    asked = ("trial", "--people", 2, "--controller", NAME, *SHORT, "--out", "people")
    assert glucoloop(*asked).code == 0
    before = glucoloop(*asked)
    assert "was computed with code of" not in before.out
    _edit(outside / "your_own_controller.py")
    assert "people was computed with code of your_own_controller " in glucoloop(*asked).err
    # unfinished, it would mix what two versions of the code computed
    (outside / "people" / "SHA256SUMS").unlink()
    assert refused(*asked).startswith("people was computed with code of your_own_controller ")


def _edit(module):
    module.write_text(module.read_text(encoding="utf-8") + "# another version\n", encoding="utf-8")
    sys.modules.pop(module.stem)
    entry_point.cache_clear()


PLAIN = """
import jax
from dataclasses import dataclass
from glucoloop.control import Decision
from glucoloop.control.part import ControllerComponent


@jax.tree_util.register_static
@dataclass(frozen=True)
class Plain:
    sample_time_min: float = 5.0

    def init(self, observation):
        return observation.delivered_mU_min

    def step(self, state, observation):
        rate = 30.0 if observation.glucose_mg_dl > 90.0 else 10.0
        return state, Decision(insulin_mU_min=rate + 0.0 * state, status=0)


class PlainPart(ControllerComponent, name="plain"):
    uses_model = False

    def designed(self, case):
        return Plain()
"""


def test_an_if_on_a_reading_is_told_what_to_write(outside, refused):
    (outside / "plain_if.py").write_text(PLAIN)
    told = refused("run", "--controller", "plain_if:PlainPart", *SHORT)
    assert "Plain asks for the value of a number" in told
    assert "of plain_if.py" in told
    assert "jnp.where" in told
