"""Models, records and the folders of trials of any content are read or refused in a sentence."""

import io
import json
import math
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from glucoloop.identification import record_from_samples
from glucoloop.situations.population import named_population
from glucoloop.storage import disk
from glucoloop.storage.files import read_text
from glucoloop.storage.folder import SUMS
from glucoloop.storage.model_file import read_model
from glucoloop.storage.results import RECORD_COLUMNS, read_record_columns
from glucoloop.trials.folder import RECORD, SHARD, SHARDS, SUMMARY, TrialOrigin
from glucoloop.trials.query import trial_tables
from glucoloop.trials.trial import Trial

MODEL = {
    "format": "glucoloop-model",
    "version": 1,
    "sample_time_min": 5.0,
    "step_response": [-1.0, -2.0],
    "impulse_response": [-1.0, -1.0],
    "operating_point": {"name": None, "basal_insulin_mU_min": 22.0, "glucose_mg_dl": 90.0},
    "provenance": {"glucoloop": "0", "source": "a record", "method": "csrs", "settings": {}, "notes": []},
}
HEAD = ",".join(RECORD_COLUMNS)

json_values = st.recursive(
    st.none() | st.booleans() | st.integers(-(10**30), 10**30) | st.floats() | st.text(max_size=4),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=3), inner, max_size=3),
)
numbers = st.floats(allow_nan=False, allow_infinity=False)
cells = st.one_of(
    st.floats(0, 200).map(repr),
    st.floats().map(repr),
    st.sampled_from(["", " ", "nan", "inf", "1e999", "1_0", "high", '"', '"90"', '"a\nb"', "90,5", "\x00", "٩٠"]),
    st.just("9" * 400),
)
heads = st.sampled_from([HEAD, HEAD + ",t_min", HEAD.replace(",", ", "), "a,b", '"' + HEAD])
rows = st.lists(st.lists(cells, min_size=1, max_size=4).map(",".join), max_size=6)


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    """Write a file, over and over."""
    path = tmp_path_factory.mktemp("files") / "file.toml"

    def write(content):
        path.write_bytes(content if isinstance(content, bytes) else content.encode("utf-8", "surrogatepass"))
        return path

    return write


@given(st.binary(max_size=60))
@example(b"\xff\xfea\x00")
@example(b"\xef\xbb\xbf" * 2)
@example(b"[" * 100_000)
@settings(max_examples=150)
def test_any_bytes_are_read_or_refused(refusal, file, content):
    path = file(content)
    for read in (read_model, read_record_columns):
        assert refusal(read, path) is not None
    refusal(read_text, path, "a text")
    assert refusal(named_population, str(path)) is not None


@pytest.mark.parametrize("path", ["a\0b", "a\0b.toml", "x" * 5000 + ".toml", "/", "/dev/null", "/dev/null/a.toml"])
def test_path_that_no_file_can_have_is_refused(refusal, tmp_path, path):
    place = tmp_path / path
    for read in (read_model, read_record_columns, lambda place: named_population(f"{place}")):
        assert refusal(read, place) is not None


def test_file_without_an_end_is_refused_before_it_fills_the_memory(refusal):
    assert "it is a device, not a file" in refusal(read_model, Path("/dev/zero"))


@pytest.mark.long
@given(st.sampled_from([*MODEL, "operating_point.glucose_mg_dl", "provenance.settings", "other"]), json_values)
@example("step_response", [1e308, 1e308])
@example("version", 10**4000)
@example("provenance.settings", {"a": [math.inf]})
@settings(max_examples=200)
def test_model_with_any_value_is_read_whole_or_refused(refusal, file, key, value):
    model = json.loads(json.dumps(MODEL))
    outer, _, inner = key.partition(".")
    (model[outer] if inner else model)[inner or outer] = value
    path = file(json.dumps(model))
    if refusal(read_model, path) is None:
        read = read_model(path)
        assert read_model(file(read.text())) == read


@given(st.lists(numbers, min_size=1, max_size=4), st.floats(0.1, 120.0))
@example([1e308, 1e308], 5.0)
@settings(max_examples=100)
def test_model_that_is_read_is_finite(refusal, file, impulse, sample_time):
    with np.errstate(over="ignore"):
        step = np.cumsum(impulse).tolist()
    told = {**MODEL, "impulse_response": impulse, "step_response": step, "sample_time_min": sample_time}
    path = file(json.dumps(told))
    if refusal(read_model, path) is None:
        assert np.isfinite(read_model(path).step_response_model().step_response).all()


def _record(path):
    return record_from_samples(*read_record_columns(path)[0].values(), allow_unusual=True)


@pytest.mark.long
@given(heads, rows, st.sampled_from(["\n", "\r\n", "\r"]))
@example(HEAD, ["0,1e308,90", "2,1e308,90", "5,1e308,90"], "\n")
@example(HEAD, ["-1.7e308,1,90", "1.7e308,1,90"], "\n")
@example(HEAD, ["0,1,90", "", "5,1,91", "", ""], "\r\n")
@settings(max_examples=150)
def test_record_that_is_read_is_finite(refusal, file, head, rows, end):
    path = file(end.join([head, *rows]))
    if refusal(_record, path) is None:
        record, _ = _record(path)
        assert np.isfinite(record.insulin_mU_min).all()
        assert np.isfinite(record.glucose_mg_dl).all()
        assert record.glucose_mg_dl.size == record.insulin_mU_min.size + 1


def test_record_may_have_a_mark_of_its_encoding_other_ends_of_lines_and_empty_rows(file):
    plain, _ = _record(file(f"{HEAD}\n0,1,90\n5,1,91\n"))
    other, _ = _record(file(f"\ufeff{HEAD}\r\n\r\n0,1,90\r\n5,1,91\r\n\r\n\r\n"))
    np.testing.assert_array_equal(other.glucose_mg_dl, plain.glucose_mg_dl)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (f"{HEAD},t_min\n0,1,90,9\n", "has the column 't_min' twice; leave one out"),
        (f"{HEAD}\n0,1_0,90\n5,1,90\n", "is '1_0': it must be a number"),
        (f"{HEAD}\n0,1,٩٠\n5,1,90\n", "is '٩٠': it must be a number"),
        (f"{HEAD}\n0,1e5,90\n5,1,90\n", "at least 0 and at most 10000"),
        (f"{HEAD}\n2e9,1,90\n", "from -1e+09 to 1e+09 min"),
    ],
)
def test_record_is_refused_for_its_fault(refusal, file, text, told):
    assert told in refusal(_record, file(text))


@pytest.fixture(scope="module")
def trial(tmp_path_factory):
    """The folder of a trial with one shard."""
    folder = tmp_path_factory.mktemp("trial")
    origin = TrialOrigin.of(Trial(people=2))
    (folder / RECORD).write_text(origin.text())
    people = pl.DataFrame({"person": [0, 1], "controller": ["mpc", "[/a] :smile:"], "peak_mg_dl": [150.0, None]})
    counts = {"controller": ["mpc"], "quantity": ["glucose"], "t_min": [0.0], "low": [1.0], "high": [2.0], "count": [3]}
    tables = {"people.parquet": people, "bands.parquet": pl.DataFrame(counts)}
    told = {
        **origin.of_shard(0),
        "first_person": 0,
        "people": 2,
        "rows": {name: table.height for name, table in tables.items()},
    }
    files = {SHARD: json.dumps(told).encode()}
    for name, table in tables.items():
        table.write_parquet(written := io.BytesIO())
        files[name] = written.getvalue()
    (folder / SHARDS).mkdir()
    disk.put_folder(folder / SHARDS / "00000", files)
    return folder


def _open(folder):
    with trial_tables(folder) as tables:
        return tables.views


@given(st.sampled_from([*json.loads(TrialOrigin.of(Trial(people=2)).text())]), json_values)
@example("shards", 10**18)
@example("shards", math.inf)
@example("config", {"controller": [1]})
@settings(max_examples=60)
def test_origin_with_any_value_is_read_or_refused(refusal, trial, key, value):
    whole = (trial / RECORD).read_text()
    try:
        (trial / RECORD).write_text(json.dumps({**json.loads(whole), key: value}))
        refusal(_open, trial)
    finally:
        (trial / RECORD).write_text(whole)


@pytest.mark.parametrize("text", ["[", "[]", "1", "null", "[" * 100_000, '{"a":' * 3000])
def test_origin_that_is_none_is_refused(refusal, tmp_path, text):
    (tmp_path / RECORD).write_text(text)
    assert "is damaged" in refusal(TrialOrigin.of_folder, tmp_path)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "{",
        "[]",
        "{}",
        '{"controllers":[]}',
        '{"controllers":{}}',
        '{"controllers":{"a":{"metrics":{"m":{"b":""}}}}}',
    ],
)
def test_damaged_summary_is_refused(refusal, trial, text):
    try:
        (trial / SUMS).write_text("")
        (trial / SUMMARY).write_text(text)
        pl.DataFrame({"a": [1]}).write_parquet(trial / "bands.parquet")
        assert refusal(_open, trial) is not None
    finally:
        for name in (SUMS, SUMMARY, "bands.parquet"):
            (trial / name).unlink()


QUESTIONS = [
    "", ";", "select", "(" * 3000, "select " + "1+" * 5000 + "1", "select 1; select 2", "drop table people", "\ud800",
    "select '\0'", "select interval 10000000 years", "select '/etc/passwd'::json", "from read_csv('/etc/passwd')",
    "copy people to 'x'", "pragma version", "set memory_limit='1'", "select ?", "select error('a\nb')", "attach 'x.db'",
]  # fmt: skip
ANSWERED = [
    "from people", "summarize people", "select '[/a]' as \"[/b]\"", "select date '99999-01-01', 'infinity'::date",
    "select 1::hugeint << 100, '\\xff'::blob, [1, null], {'a': 1}, 'nan'::float, null", "values (1) limit 0",
    "select controller -- why\n\tfrom people", "select chr(27) || '[2J' || chr(155) || chr(8238) as a",
]  # fmt: skip


@pytest.mark.parametrize("question", QUESTIONS, ids=lambda question: repr(question[:20]))
def test_question_is_refused(asked, trial, question):
    assert asked("query", str(trial), question, "--csv").code == 2


@pytest.mark.long
@pytest.mark.parametrize("how", [(), ("--json",), ("--csv",)])
def test_question_is_answered_whatever_the_cells_hold(asked, trial, how):
    for question in ANSWERED:
        answer = asked("query", str(trial), question, *how)
        assert answer.code == 0, answer
        assert not {*"\x1b\x9b\u202e"} & {*answer.out}
    assert "[/a] :smile:" in asked("query", str(trial), "from people", *how).out
