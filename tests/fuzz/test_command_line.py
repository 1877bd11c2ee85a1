"""Command lines and files of a corpus: each is refused in one sentence, or comes to where it would be computed."""

import json
from pathlib import Path

import pytest
import tomli_w
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from glucoloop.cli.app import command_of
from glucoloop.control.catalogue import CONTROLLERS
from glucoloop.situations.run import Run

CORPUS = sorted((Path(__file__).parent / "corpus").iterdir())
FLAGS = {
    name: command_of(name).options for name in ("run", "compare", "identify", "bound", "tune", "trial", "export", "hil")
}
NAMES = sorted({part for options in FLAGS.values() for option in options for part in option.flag.split("/")})
READERS = {
    ".toml": [(command, "--config") for command in FLAGS] + [("trial", "--out", "out", "--population")],
    ".csv": [("identify", "--data")],
    ".json": [("run", "--model")],
}

values = st.one_of(
    st.text(max_size=6),
    st.floats().map(repr),
    st.integers().map(str),
    st.sampled_from(
        ["", "-1", "0", "1", "5", "nan", "1e400", "9" * 5000, "mpc", "pid", "mpc, move_weight=1, label=a", "50g@1h",
         "a\0b", "\udcff", "\x1b[31m\n", "[red]", "missing", "x" * 5000, "local", "tcp://[", "parker1999", "--", "-h",
         "none", "move_weight=1", "usual, max_hour=2", "white-noise, variance=2", "memory=48", "mpc, guard=(", "1:3",
         "x=(a=(b=1))", "controller.move_weight=1", "a.b.c=1"]
    ),
)  # fmt: skip
pieces = st.lists(st.tuples(st.sampled_from(NAMES), values), max_size=3).map(
    lambda pairs: [piece for pair in pairs for piece in pair if piece not in ("--help", "-h")]
)
commands = st.sampled_from([*FLAGS, "reproduce", "query", "ruun"])


@pytest.mark.long
@given(commands, pieces, st.lists(values, max_size=2))
@example("run", ["--config", "a\0b"], [])
@example("run", ["--controller", "x" * 100_000], [])
@example("run", ["--model", "a\n\x1b[31m\udcff"], [])
@example("trial", ["--population", "a\0.toml", "--out", "out"], [])
@example("tune", ["--controller", "mpc, move_horizon=1:1000, prediction_horizon=1:1000, move_weight=1:1000:1"], [])
@example("run", ["--controller", "mpc, model=" + "(a=" * 5000 + ")" * 5000], [])
@example("run", ["--set", ".".join("a" * 5000) + "=1"], [])
@example("reproduce", ["--seed", str(2**70)], ["parker1999"])
@example("reproduce", ["--seeds", str(10**9)], ["parker1999"])
@example("query", [], [".", "select 1"])
@settings(max_examples=120, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_any_command_line_is_answered(asked, command, pieces, more):
    if command == "trial" and "--dask" in pieces:
        pieces = [piece for piece in pieces if piece != "--dask"]
    asked(command, *pieces, *more)


KEYS = sorted({"path", *Run.settings()})
in_files = st.recursive(
    values | st.integers() | st.booleans() | st.sampled_from(["mpc", "ideal", "usual", "identified", "limited"]),
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(
            st.sampled_from(["name", "label", "guard", "model", "path", "move_weight"]), inner, max_size=3
        )
    ),
    max_leaves=6,
)


@pytest.mark.long
@given(
    st.sampled_from(["run", "compare", "trial", "tune", "identify"]),
    st.dictionaries(st.sampled_from(KEYS), in_files, max_size=3),
    pieces,
)
@example("run", {"sensor": [1]}, ["--noise", "1"])
@example("run", {"sensor": [1]}, ["--set", "sensor.x=1"])
@example("run", {"controller": 5}, ["--guard"])
@example("run", {"controller": [1, 2]}, ["--controller", "move_weight=1"])
@example("tune", {"controller": [1]}, [])
@example("tune", {"controller": [{"name": 1, "move_weight": [1]}]}, [])
@example("run", {"guard": "none", "controller": {"name": "pid", "guard": "none"}}, ["--guard", "max_hour=2"])
@settings(max_examples=200, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_options_over_any_file_are_answered(asked, tmp_path_factory, command, keys, pieces):
    keys = json.loads(json.dumps(keys).replace("\\u0000", "0").replace("\\udcff", "u"))  # TOML has neither
    file = tmp_path_factory.getbasetemp() / "any.toml"
    file.write_text(tomli_w.dumps(keys))
    pieces = [piece for piece in pieces if piece not in ("--config", "--dask")]
    asked(command, "--config", str(file), *pieces)


@pytest.mark.parametrize(
    ("ranges", "told"),
    [
        ("move_horizon=1000", "move_horizon is 1000; give a whole number from 1 to 50."),
        ("prediction_horizon=-1:3", "prediction_horizon is -1; give a whole number from 0 to 288."),
        ("move_weight=0|1e99", "move_weight is 1e+99; give a number of a size up to 1e+30."),
        ("move_weight=5:1:1", "move_weight runs from 5 down to 1; write the lower end first."),
        ("move_weight=nan:3:1", "move_weight is 'nan:3:1'; write it like .3:.8:.05 or 0|1|3."),
        ("reference_filter=٠", "reference_filter is '٠'; write it like .3:.8:.05 or 0|1|3."),
    ],
)
def test_a_range_that_is_not_possible_is_refused_before_a_model_is_identified(asked, ranges, told):
    assert asked("tune", "--controller", f"mpc-se, {ranges}").err == f"glucoloop: {told}\n"


def test_a_small_weight_of_a_run_is_a_range_of_one(asked, tmp_path):
    file = tmp_path / "run.toml"
    file.write_text('controller = {name = "mpc", move_weight = 1e-05}\n')
    assert asked("tune", "--config", str(file)).code == 130


@pytest.mark.parametrize("option", ["--guard", "--model"])
def test_a_part_that_a_file_leaves_out_is_given_settings(asked, tmp_path, option):
    file = tmp_path / "none.toml"
    file.write_text('guard = "none"\nmodel = "none"\n')
    setting = {"--guard": "max_hour=2", "--model": "memory=48"}[option]
    assert asked("run", "--config", str(file), option, setting).code == 130
    assert asked("run", "--config", str(file), "--set", f"{option[2:]}.{setting}").code == 130


@pytest.mark.long
@pytest.mark.parametrize("file", CORPUS, ids=lambda file: file.name)
def test_file_of_the_corpus_is_answered(asked, file):
    for reader in READERS[file.suffix]:
        assert asked(*reader, str(file)).code == (130 if file.stem.startswith("good") else 2)


def test_sentence_is_told_in_one_line_without_its_controls(asked):
    told = asked("run", "--model", "a\n\x1b[31m\udcff").err
    assert "a\\n\\x1b[31m\\udcff cannot be read as a model" in told


def test_sentence_about_a_long_value_keeps_its_end(asked):
    told = asked("run", "--controller", "x" * 100_000).err
    assert len(told) < 2200
    assert told.endswith(f"{', '.join(CONTROLLERS)}.\n")
