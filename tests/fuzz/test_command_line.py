"""Command lines and files of a corpus: each is refused in one sentence, or comes to where it would be computed."""

from pathlib import Path

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from glucoloop.cli.app import command_of

CORPUS = sorted((Path(__file__).parent / "corpus").iterdir())
FLAGS = {name: command_of(name).options for name in ("run", "compare", "identify", "bound", "tune", "trial")}
NAMES = sorted({option.flag for options in FLAGS.values() for option in options})
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
        ["", "-1", "0", "1", "5", "nan", "1e400", "9" * 5000, "mpc", "pid", "mpc, label=a", "50g@1h", "1:3",
         "a\0b", "\udcff", "\x1b[31m\n", "[red]", "missing", "x" * 5000, "local", "tcp://[", "parker1999", "--", "-h"]
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
@example("tune", ["--controller", "move_horizon=1:1000, prediction_horizon=1:1000, move_weight=1:1000:1"], [])
@example("reproduce", ["--seed", str(2**70)], ["parker1999"])
@example("reproduce", ["--seeds", str(10**9)], ["parker1999"])
@example("query", [], [".", "select 1"])
@settings(max_examples=120, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_any_command_line_is_answered(asked, command, pieces, more):
    if command == "trial" and "--dask" in pieces:
        pieces = [piece for piece in pieces if piece != "--dask"]
    asked(command, *pieces, *more)


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
    assert told.endswith("meal-mpc, imc, pid, basal-bolus, basal.\n")
