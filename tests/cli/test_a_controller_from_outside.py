"""A controller that another package brings is at home in every command."""

import sys
from pathlib import Path
from typing import Annotated

import polars as pl
import pytest
from glucoloop.config.trial import trial_keys

from glucoloop.cli.request import file_keys, with_lists
from glucoloop.control.catalogue import controller_entry, controller_names
from glucoloop.parts.code import found
from glucoloop.parts.controllers import ControllerPart
from glucoloop.parts.setting import About
from glucoloop.situations.toml import toml_text
from requests_read import request_of

EXAMPLE = Path(__file__).parents[2] / "examples" / "your_own_controller.py"
NAME = "your_own_controller:YourOwnPI"
SHORT = ("--duration", "120", "--meal", "20g@20min")


@pytest.fixture
def outside(install, tmp_path):
    """A folder with the module, and an entry point that names it."""
    install("your_own_controller", "controllers", "your-own-pi", "YourOwnPI")
    return tmp_path


def test_it_is_found_by_its_entry_point_and_by_its_place(outside):
    assert "your-own-pi" in controller_names()
    assert controller_entry("your-own-pi") == controller_entry(NAME)


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (("--controller", "nobody"), "unknown controller 'nobody'; the known ones are: mpc, mpc-se"),
        (("--controller", "no_such_module:X"), "no_such_module cannot be imported: ModuleNotFoundError"),
        (("--controller", "your_own_controller:NO"), "your_own_controller has no NO; name what it defines"),
        (
            ("--controller", "your_own_controller:ProportionalIntegral"),
            "your_own_controller:ProportionalIntegral is no controller: make it a class of ControllerPart",
        ),
        (("--controller", NAME, "--setting", "integral=9"), "unknown key 'integral'; did you mean 'integral_min'?"),
        (
            ("--controller", NAME, "--setting", "integral_min=-1"),
            "integral_min is -1 min; give a finite number above 0 min",
        ),
        (("--controller", NAME, "--setting", "integral_min=much"), "integral_min is 'much'; give a finite number"),
        (("--controller", NAME, "--move-weight", "1"), "your-own-pi has no setting 'move_weight'"),
        (("--setting", "integral_min=9"), "unknown key 'integral_min'"),
        (("--setting", "move_weight"), "'move_weight' in the option --setting is not a key with a value"),
        (("--setting", "seed=3"), "seed is not a setting of a controller; give --seed in place of --setting"),
        (
            ("--move-weight", "1", "--setting", "move_weight=2"),
            "--setting move_weight and --move-weight say the same; leave one out",
        ),
    ],
)
def test_what_is_wrong_is_told(outside, refused, arguments, told):
    assert told in refused("run", *arguments)


@pytest.mark.long
def test_a_run_is_read_again_from_its_folder(outside, glucoloop):
    given = ("--controller", "your-own-pi", "--setting", "integral_min=60", *SHORT)
    answer = glucoloop("run", *given, "--out", "a", "--json")
    assert answer.code == 0, answer.err
    config = answer.json["config"]
    assert (config["controller"], config["integral_min"], config["proportional_gain"]) == ("your-own-pi", 60.0, 0.6)
    assert keys_of("run", (), "a/run.toml") == config
    assert "integral_min" not in keys_of("run", {"controller": "basal"}, "a/run.toml")


def keys_of(command, given, file=None):
    """The configuration of a command, from its options and its file."""
    asked = request_of(command, with_lists(dict(given)), file_keys(None if file is None else Path(file)))
    return trial_keys(asked) if command == "trial" else asked.keys()


@pytest.mark.parametrize("command", ["compare", "trial", "stress", "adversary"])
def test_cases_have_settings_of_their_own_and_take_shared_ones(outside, command):
    cases = [f"quick: {NAME}, integral_min=30", f"slow: {NAME}", "none: basal"]
    keys = keys_of(command, {"cases": cases, "settings": ["proportional_gain=0.3"]})
    assert settings_of(keys) == {"quick": (30.0, 0.3), "slow": (150.0, 0.3), "none": (None, None)}
    Path("asked.toml").write_text(toml_text(keys, ""))
    assert keys_of(command, {}, "asked.toml") == keys
    changed = keys_of(command, {"settings": ["integral_min=90"]}, "asked.toml")
    assert settings_of(changed) == {"quick": (90.0, 0.3), "slow": (90.0, 0.3), "none": (None, None)}
    with pytest.raises(ValueError, match=r"^case 'b': no_such_module cannot be imported"):
        keys_of(command, {"cases": [f"a: {NAME}", "b: no_such_module:X"]})
    with pytest.raises(ValueError, match=r"^case 'a': unknown key 'integral_min'"):
        keys_of(command, {"cases": ["a: basal, integral_min=30", f"b: {NAME}"]})


def settings_of(keys):
    return {case["label"]: (case.get("integral_min"), case.get("proportional_gain")) for case in keys["case"]}


def test_a_test_of_estimators_takes_its_settings(outside):
    keys = keys_of("detect", {"controller": NAME, "settings": ["integral_min=30"]})
    assert (keys["controller"], keys["integral_min"]) == (NAME, 30.0)
    with pytest.raises(ValueError, match=r"^unknown key 'integral_min' of a test of estimators"):
        keys_of("detect", {"settings": ["integral_min=30"]})


def test_a_search_for_a_tuning_stands_beside_it(outside):
    assert keys_of("robust", {"beside": [NAME]})["beside"] == [NAME]


def test_it_is_not_tuned_unless_its_entry_says_so(outside):
    with pytest.raises(ValueError, match=r"cannot be tuned; the known ones are: mpc, mpc-se, nlqdmc-se$"):
        keys_of("tune", {"controller": NAME})


def test_a_setting_that_is_a_key_of_every_run_is_refused(outside, refused):
    Path("clash.py").write_text(EXAMPLE.read_text().replace("integral_min", "seed"))
    told = refused("run", "--controller", "clash:YourOwnPI")
    assert told.startswith("the controller your-own-pi has a setting 'seed', which is a key of every run already")


@pytest.mark.long
def test_a_trial_designs_it_for_each_person(outside, glucoloop):
    cases = ("--case", f"mine: {NAME}, integral_min=60", "--case", "none: basal", "--design", "individual")
    answer = glucoloop("trial", "--people", "4", *cases, *SHORT, "--out", "t", "--json")
    assert answer.code == 0, answer.err
    people = pl.concat([pl.read_parquet(path) for path in sorted(Path("t").rglob("people*.parquet"))])
    assert people.height == 8
    varied = people.group_by("controller").agg(pl.col("insulin_total_variation_mU_min").min())
    assert dict(varied.iter_rows())["mine"] > dict(varied.iter_rows())["none"] == 0.0


@pytest.mark.parametrize(
    ("changed", "told"),
    [
        ({"design": "module"}, "'module' of the controller x is no place; write it like module:function"),
        ({"tunable": True}, "the controller x cannot be tunable: it lacks one of move_horizon"),
        ({"individual": ":f"}, "':f' of the controller x is no place"),
        ({"name": 1, "__annotations__": {"name": "int"}}, "a setting of X is called 'name', as of every part"),
    ],
)
def test_a_part_that_cannot_be_meant_is_refused(changed, told):
    with pytest.raises(TypeError, match=told):
        type("X", (ControllerPart,), changed, name="x")


def test_a_setting_that_does_not_say_what_it_means_is_refused():
    class Mistyped(ControllerPart, name="mistyped"):
        k: Annotated[int, About("")] = "a"

    class Unsaid(ControllerPart, name="unsaid"):
        k: int = 1

    with pytest.raises(ValueError, match="k is 'a', a str; give a whole number"):
        Mistyped.partial({}).completed()
    with pytest.raises(TypeError, match=r"the setting k does not say what it means; annotate it, like k: Annotated"):
        Unsaid()


COMMANDS = {
    "trial": ("--people", "8", "--setting", "integral_min=60", *SHORT),
    "stress": ("--people", "4", "--fault", "missing, start_min=20, duration_min=30", *SHORT),
    "adversary": ("--people", "4", "--generations", "2", "--error", "10", *SHORT),
    "verify": ("--loops", "20"),
    "detect": ("--days", "2", "--setting", "integral_min=60"),
}
WITH_FOLDER = ("trial", "stress", "adversary")


@pytest.mark.long
@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_takes_it(outside, glucoloop, command):
    folder = ("--out", "out") if command in WITH_FOLDER else ()
    answer = glucoloop(command, *COMMANDS[command], *folder, "--controller", NAME)
    # it leaves the pump's limits to the pump, and verify finds that: the promise about what is asked for is broken
    assert answer.code == (1 if command == "verify" else 0), answer.err


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
    found.cache_clear()


PLAIN = """
import jax
from dataclasses import dataclass
from glucoloop.control import Decision
from glucoloop.parts.controllers import ControllerPart


@jax.tree_util.register_static
@dataclass(frozen=True)
class Plain:
    sample_time_min: float = 5.0

    def init(self, observation):
        return observation.delivered_mU_min

    def step(self, state, observation):
        rate = 30.0 if observation.glucose_mg_dl > 90.0 else 10.0
        return state, Decision(insulin_mU_min=rate + 0.0 * state, status=0)


class PlainPart(ControllerPart, name="plain"):
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
