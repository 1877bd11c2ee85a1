"""Damaged files of glucoloop's own: commands that read them leave with a sentence and code 2, or read them right."""

import contextlib
import json
import random
from datetime import datetime, timedelta

import polars as pl
import pytest

from glucoloop import Refusal
from glucoloop.records.record import SCHEMA, DeviceRecord
from glucoloop.storage.model_file import read_model
from glucoloop.text import is_printable

MODEL = {
    "format": "glucoloop-model",
    "version": 1,
    "sample_time_min": 5.0,
    "step_response": [-1.0, -2.0],
    "impulse_response": [-1.0, -1.0],
    "operating_point": {"name": None, "basal_insulin_mU_min": 22.0, "glucose_mg_dl": 90.0},
    "provenance": {"glucoloop": "0", "source": "a record", "method": "csrs", "settings": {}, "notes": []},
}
WRONG = (None, True, "x", "\x1b[2J", "\u202e", -1, 2**63, 1e300, [], [1], [[[[]]]], {}, {"\x9b": 1})
"""Values of other types, and at their ends."""


def record_bytes():
    start = datetime(2026, 2, 1)
    frame = pl.DataFrame(
        {
            "time": [start + timedelta(minutes=5 * n) for n in range(300)],
            "glucose_mg_dl": [120.0 + n % 60 for n in range(300)],
        }
    )
    frame = frame.select(
        pl.col(n).cast(k) if n in frame.columns else pl.lit(None, k).alias(n) for n, k in SCHEMA.items()
    )
    return DeviceRecord(frame=frame, rows=300, notes=("A note.",)).parquet()


def damaged(data, number, seed):
    """Some copies of a file that are cut off or have other bytes."""
    draw = random.Random(seed)
    for _ in range(number):
        copy = bytearray(data)
        for _ in range(draw.choice((1, 1, 3))):
            copy[draw.randrange(len(copy))] = draw.randrange(256)
        yield bytes(copy if draw.random() < 0.7 else copy[: draw.randrange(len(copy))])


def harmless(answer):
    assert answer.code in (0, 2), answer
    assert "Traceback" not in answer.err
    assert all(map(is_printable, (answer.out + answer.err).split("\n")))
    return answer


def of_form(plain, path=()):
    """Paths of all values of a tree."""
    yield from (path and [path]) or ()
    if isinstance(plain, dict):
        for key, value in plain.items():
            yield from of_form(value, (*path, key))


def changed(plain, path, value):
    copy = json.loads(json.dumps(plain))
    within = copy
    for key in path[:-1]:
        within = within[key]
    within[path[-1]] = value
    return copy


def test_a_damaged_record(glucoloop, tmp_path):
    whole = record_bytes()
    place = tmp_path / "record.parquet"
    place.write_bytes(whole)
    assert glucoloop("records", "record.parquet").code == 0
    codes = []
    for data in damaged(whole, 60, 1):
        place.write_bytes(data)
        codes.append(harmless(glucoloop("records", "record.parquet", "--json")).code)
    assert codes.count(2) > 20


@pytest.mark.long
def test_a_record_with_another_footer(glucoloop, tmp_path):
    frame = pl.read_parquet(record_bytes())
    about = {"rows": 300, "left_out": {}, "notes": []}
    for name in about:
        for value in WRONG:
            metadata = {"glucoloop_record": json.dumps({**about, name: value})}
            frame.write_parquet(tmp_path / "record.parquet", metadata=metadata)
            answer = harmless(glucoloop("records", "record.parquet"))
            assert answer.code == 2 or value in ([], {}, 2**63), (name, value)


@pytest.mark.long
def test_a_record_that_is_reported(glucoloop, tmp_path):
    for number, data in enumerate(damaged(record_bytes(), 12, 2)):
        (tmp_path / f"{number}.parquet").write_bytes(data)
        answer = harmless(glucoloop("report", f"{number}.parquet", "--json"))
        assert answer.code == 0 or answer.err.startswith("glucoloop: ")


@pytest.mark.long
@pytest.mark.parametrize("path", list(of_form(MODEL)), ids=".".join)
def test_a_model_with_another_value(glucoloop, tmp_path, path):
    for value in WRONG:
        plain = changed(MODEL, path, value)
        if plain == MODEL:
            continue
        (tmp_path / "m.json").write_text(json.dumps(plain))
        with contextlib.suppress(Refusal):
            read_model(tmp_path / "m.json")
            continue  # another right model
        answer = harmless(glucoloop("run", "--controller", "mpc", "--model", "m.json"))
        assert answer.code == 2
        assert "m.json is not a model that can be used" in answer.err


@pytest.mark.long
@pytest.mark.parametrize("name", ["glucose_1min.parquet", "shards/00000/traces.parquet"])
def test_the_courses_of_a_simulation(glucoloop, tmp_path, name):
    place = tmp_path / "run" / name
    place.parent.mkdir(parents=True)
    names = {"person": [0] * 300, "controller": ["pid"] * 300} if "shards" in name else {}
    whole = pl.DataFrame({**names, "t_min": [5.0 * n for n in range(300)], "glucose_mg_dl": [120.0] * 300})
    for wrong in (
        whole.drop("t_min"),
        whole.with_columns(t_min=pl.lit("x")),
        whole.with_columns(t_min=pl.lit(None, pl.Float64)),
        whole.with_columns(t_min=pl.lit(1e300)),
        whole.with_columns(glucose_mg_dl=pl.lit(float("inf"))),
        whole.with_columns(glucose_mg_dl=pl.lit([1.0])),
        whole.with_columns(case=pl.lit("\x1b[2J")),
        whole.clear(),
    ):
        wrong.write_parquet(place)
        assert harmless(glucoloop("report", "run", "--json")).code == 2
    whole.write_parquet(place)
    for data in damaged(place.read_bytes(), 12, 3):
        place.write_bytes(data)
        harmless(glucoloop("report", "run", "--json"))


@pytest.mark.long
def test_a_twin_with_another_value(glucoloop, tmp_path):
    (tmp_path / "record.parquet").write_bytes(record_bytes())
    plain = {"patient": "hovorka-2004", "posterior": {}, "known": {}, "profile": {}}
    (tmp_path / "twin").mkdir()
    for name in plain:
        for value in WRONG:
            (tmp_path / "twin/twin.json").write_text(json.dumps({**plain, name: value}))
            assert harmless(glucoloop("replay", "record.parquet", "--twin", "twin")).code == 2


WRONG_IN_TOML = (
    "true",
    '"\\u001b[2J"',
    "-1",
    "9223372036854775808",
    "1e300",
    "nan",
    "[[1]]",
    "{ a = 1 }",
    "1979-05-27",
)


@pytest.mark.long
@pytest.mark.parametrize("key", ["patient", "controller", "meals", "duration_min", "seed", "sensor", "\\u009b"])
def test_a_configuration_with_another_value(glucoloop, tmp_path, key):
    for value in WRONG_IN_TOML:
        (tmp_path / "a.toml").write_text(f'"{key}" = {value}\n')
        assert harmless(glucoloop("run", "--config", "a.toml")).code == 2
