"""A record that glucoloop wrote is read back as it was, and checked like a stranger's file."""

import io
import json
from datetime import timedelta

import hypothesis.strategies as st
import polars as pl
import pytest
from hypothesis import HealthCheck, given, settings

import glucoloop as gl
from device_files import START
from glucoloop.records.record import SCHEMA, record_from_parquet

ROWS = 40
KEY = "glucoloop_record"
ABOUT = {"rows": ROWS + 1, "left_out": {"rows without a readable time": 1}, "notes": ["A note."]}


def frame_of(**changed):
    columns = {
        "time": [START + timedelta(minutes=5 * n) for n in range(ROWS)],
        "utc_offset_min": [60] * ROWS,
        "glucose_mg_dl": [100.0 + n for n in range(ROWS)],
        "carbs_g": [None] * ROWS,
        "bolus_U": [None] * ROWS,
        "bolus_min": [None] * ROWS,
        "bolus_type": ["automatic", "manual", *[None] * (ROWS - 2)],
        "long_acting_U": [None] * ROWS,
        "basal_U_h": [0.8, float("nan"), *[None] * (ROWS - 2)],
        "glucagon_ug": [None, 40.0, *[None] * (ROWS - 2)],
        "out_of_range": ["low", *[None] * (ROWS - 1)],
        "device": ["Dexcom G6"] * ROWS,
    }
    frame = pl.DataFrame({**columns}, schema=SCHEMA)
    return frame.with_columns(**changed)


def parquet_of(frame, about):
    buffer = io.BytesIO()
    frame.write_parquet(buffer, metadata={KEY: about if isinstance(about, str) else json.dumps(about)})
    return buffer.getvalue()


WHOLE = parquet_of(frame_of(), ABOUT)


def read_or_refused(data):
    """Record of any bytes, which holds nothing that a record cannot; None where it is refused in a sentence."""
    try:
        record = record_from_parquet(data)
    except gl.Refusal as error:
        told = str(error)
    else:
        told = ""
    assert told.isprintable()
    if told:
        return None
    assert 0 < record.rows_used <= record.rows
    assert all(note.isprintable() for note in (*record.notes, *record.left_out))
    assert record.frame["time"].dt.year().is_between(1000, 9999).all()
    assert record.frame["glucose_mg_dl"].drop_nulls().is_between(20, 800).all()
    assert set(record.frame["out_of_range"].drop_nulls()) <= {"low", "high"}
    return record


def test_a_record_is_read_back_as_it_was():
    record = record_from_parquet(WHOLE)
    assert record_from_parquet(record.parquet()).frame.equals(record.frame, null_equal=True)
    assert (record.rows, record.left_out, record.notes) == (ROWS + 1, ABOUT["left_out"], ("A note.",))


@pytest.mark.parametrize(
    "absent",
    [["glucagon_ug"], ["bolus_type", "glucagon_ug"], ["bolus_min", "bolus_type", "long_acting_U", "glucagon_ug"]],
)
def test_a_record_of_an_earlier_version_is_read(absent):
    frame = record_from_parquet(parquet_of(frame_of().drop(absent), ABOUT)).frame
    assert dict(frame.schema) == SCHEMA
    assert all(frame[name].is_null().all() for name in absent)


@pytest.mark.parametrize(
    ("about", "told"),
    [
        ({**ABOUT, "rows": "x"}, "rows is 'x'"),
        ({**ABOUT, "rows": -5}, "rows is -5"),
        ({**ABOUT, "rows": 1}, "of its 1 rows 1 are left out"),
        ({**ABOUT, "rows": 1e300}, "rows is 1e"),
        ({**ABOUT, "notes": [1]}, "notes.0 is 1"),
        ({**ABOUT, "notes": "A note."}, "notes is 'A note.'"),
        ({**ABOUT, "notes": ["\x1b]0;title\x07"]}, "control characters"),
        ({**ABOUT, "notes": ["a\u202eb"]}, "control characters"),
        ({**ABOUT, "notes": ["\ud800"]}, "control characters"),
        ({**ABOUT, "left_out": {"a": -1}}, "left_out.a is -1"),
        ({**ABOUT, "left_out": []}, "left_out is []"),
        ({**ABOUT, "more": 1}, "more is not a known key"),
        ([], "it is []; it should be an object"),
        ("[[[[", "not JSON"),
        ("[" * 100_000, "nested too deeply"),
    ],
)
def test_a_footer_that_is_none_is_refused(about, told):
    with pytest.raises(gl.Refusal) as refused:
        record_from_parquet(parquet_of(frame_of(), about))
    assert told in str(refused.value)
    assert str(refused.value).isprintable()


ENDS = (-(2**63), 2**63 - 1, 0, 10**18)


@pytest.mark.parametrize(
    "changed",
    [
        *({"time": pl.Series([end] * ROWS, dtype=pl.Int64).cast(pl.Datetime("us"))} for end in (*ENDS[:2], ENDS[3])),
        *({"glucose_mg_dl": pl.lit(value)} for value in (float("nan"), 1e300, -50.0, 0.0, float("inf"), 900.0)),
        *(
            {name: pl.lit(value)}
            for name in ("carbs_g", "bolus_U", "glucagon_ug")
            for value in (float("nan"), -1.0, 1e9)
        ),
        *({"basal_U_h": pl.lit(value)} for value in (-1.0, 1e9, float("inf"))),
        {"time": pl.lit(None, pl.Datetime("us"))},
        {"time": pl.col("time").reverse()},
        {"time": pl.col("time").cast(pl.Datetime("ms"))},
        {"utc_offset_min": pl.lit(2**31 - 1, pl.Int32)},
        {"out_of_range": pl.lit("odd")},
        {"bolus_type": pl.lit("odd")},
        {"device": pl.lit("\x1b[2J")},
        {"device": pl.lit("\x9b31m")},
        {"glucose_mg_dl": pl.lit("100")},
        {"other": pl.lit(1)},
    ],
    ids=lambda changed: next(iter(changed)),
)
def test_a_cell_that_no_record_has_is_refused(changed):
    with pytest.raises(gl.Refusal, match="no whole record that glucoloop wrote"):
        record_from_parquet(parquet_of(frame_of(**changed), ABOUT))


@given(st.integers(0, len(WHOLE)))
@settings(max_examples=60, deadline=None)
def test_a_file_that_is_cut_off(length):
    read_or_refused(WHOLE[:length])


@pytest.mark.long
@given(st.lists(st.tuples(st.integers(0, len(WHOLE) - 1), st.integers(1, 255)), min_size=1, max_size=4))
@settings(max_examples=400, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_a_file_with_other_bytes(capfd, changes):
    data = bytearray(WHOLE)
    for place, change in changes:
        data[place] ^= change
    read_or_refused(bytes(data))
    assert capfd.readouterr() == ("", "")
