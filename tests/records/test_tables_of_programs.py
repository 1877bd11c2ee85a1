"""Tables that programs for data write, Parquet and JSON, are read as the same table in CSV is."""

import io
import json
from datetime import timedelta

import hypothesis.strategies as st
import polars as pl
import pytest
from hypothesis import HealthCheck, given, settings

import glucoloop as gl
from device_files import every, glucose
from naming import naming

ROWS = 40
TIMES = every(5, ROWS)
TABLE = pl.DataFrame(
    {
        "time": TIMES,
        "glucose": [float(glucose(n)) for n in range(ROWS)],
        "carbs": [45 if n == 7 else None for n in range(ROWS)],
        "bolus": [4.25 if n == 7 else None for n in range(ROWS)],
        "note": ['two\nlines\tand a "word"' if n == 3 else None for n in range(ROWS)],
        "parts": [[1.0, 2.0]] * ROWS,
    }
)
COLUMNS = "time=time,glucose_mg_dl=glucose,carbs_g=carbs,bolus_U=bolus"


def parquet_of(table):
    buffer = io.BytesIO()
    table.write_parquet(buffer)
    return buffer.getvalue()


def texts_of_times(table):
    return table.with_columns(pl.col("time").dt.to_string("%Y-%m-%d %H:%M:%S"))


def in_json():
    return {
        "a list of objects": json.dumps(texts_of_times(TABLE).to_dicts()),
        "an object on each line": "\n".join(map(json.dumps, texts_of_times(TABLE).to_dicts())),
        "lists by column": json.dumps(texts_of_times(TABLE).to_dict(as_series=False)),
        "rows by column": json.dumps(
            {
                name: {str(number): value for number, value in enumerate(column)}
                for name, column in texts_of_times(TABLE).to_dict(as_series=False).items()
            }
        ),
    }


def test_the_same_record_whatever_wrote_the_table(read):
    expected = read(texts_of_times(TABLE.drop("parts", "note")).write_csv(), columns=COLUMNS).frame
    assert expected["glucose_mg_dl"].to_list() == [float(glucose(n)) for n in range(ROWS)]
    assert (expected["carbs_g"].sum(), expected["bolus_U"].sum()) == (45.0, 4.25)
    for name, data in {"Parquet": parquet_of(TABLE), **in_json()}.items():
        with naming(name):
            assert read(data, columns=COLUMNS).frame.equals(expected, null_equal=True)
    assert gl.read_record(TABLE, columns=COLUMNS).frame.equals(expected, null_equal=True)
    with pytest.raises(gl.records.FileRefusal, match="the table: its glucose is taken as mmol/l, but it looks like"):
        gl.read_record(TABLE, columns=COLUMNS.replace("mg_dl", "mmol_l"))
    own = TABLE.rename({"glucose": "glucose_mg_dl", "carbs": "carbs_g", "bolus": "bolus_U"})
    assert read(parquet_of(own)).frame.equals(expected, null_equal=True)


def test_times_of_a_parquet_file_keep_their_zone(read):
    table = TABLE.with_columns(pl.col("time").dt.replace_time_zone("Europe/Berlin"))
    frame = read(parquet_of(table), columns=COLUMNS).frame
    assert frame["time"].to_list() == TIMES
    assert set(frame["utc_offset_min"]) == {60}
    in_utc = TABLE.with_columns(pl.col("time").dt.replace_time_zone("UTC"))
    frame = read(parquet_of(in_utc), columns=COLUMNS, time_zone="Europe/Berlin").frame
    assert frame["time"].to_list() == [time + timedelta(hours=1) for time in TIMES]


def test_a_record_that_was_changed_by_another_program_is_a_table(read):
    record = read(parquet_of(TABLE), columns=COLUMNS)
    half = record.frame.filter(pl.col("time") < TIMES[20])
    assert read(parquet_of(half)).frame.select(half.columns).equals(half, null_equal=True)


def test_the_columns_that_a_refusal_names_can_be_given(read, refused):
    tables = {
        "date,time,Glucose (mmol/L),Carbs (g),Bolus (U)\n2024-03-13,00:03,5.5,,1.5\n2024-03-13,00:08,6.1,20,\n": 5,
        "Patient;Jane Doe\n\nDatum;Uhrzeit;BZ (mmol/l);KH (g)\n13.03.24;00:03;5,5;\n13.03.24;00:08;6,1;20\n": 4,
        "timestamp\tsgv mg/dl\tbasal (U/h)\n2024-03-13 00:03\t100\t0.8\n2024-03-13 00:08\t101\t\n": 3,
        json.dumps([{"timestamp": "2024-03-13 00:03", "glucose mg/dl": 100, "name": "Jane"}] * 2): 2,
    }
    for text, number in tables.items():
        with naming(text[:40]):
            sentence = refused(text)
            assert sentence.startswith("no reader knows it")
            assert "Jane" not in sentence
            columns = sentence.partition("columns='")[2].partition("'")[0]
            assert columns.count("=") == number
            assert read(text, columns=columns).frame["glucose_mg_dl"].drop_nulls().is_between(99, 111).all()
    assert "columns='time=Zeit,glucose_mg_dl=BZ'" in refused("a,b\n1,2\n")
    for name in ("time Jane", "Jane: glucose mg/dl", "glucoseJane"):
        with naming(name):
            assert "Jane" not in refused(f"{name},timestamp,BZ (mg/dl),KH (g)\n1,2024-03-13 00:03,100,\n")
            record = read(f"time,glucose_mg_dl,{name}\n2024-03-13 00:03,100,5\n")
            assert "Jane" not in " ".join(record.notes)


def test_a_parquet_file_that_cannot_be_read_or_unfolds_too_far(refused, monkeypatch):
    whole = parquet_of(TABLE)
    assert "it is a Parquet file" in refused(whole[: len(whole) // 2], columns=COLUMNS)
    monkeypatch.setattr("glucoloop.records.user_files.MAX_ROWS", ROWS - 1)
    assert refused(whole, columns=COLUMNS) == (
        f"it is a Parquet file that cannot be read: it has {ROWS} rows, and at most {ROWS - 1} can be read; write it "
        "again, or as CSV"
    )


@pytest.mark.long
@given(st.data())
@settings(max_examples=300, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_a_parquet_file_with_other_bytes(tmp_path, capfd, data):
    content = bytearray(parquet_of(TABLE))
    for place, change in data.draw(
        st.lists(st.tuples(st.integers(4, len(content) - 1), st.integers(1, 255)), min_size=1, max_size=4)
    ):
        content[place] ^= change
    path = tmp_path / "table.parquet"
    path.write_bytes(bytes(content))
    sentence = ""
    try:
        record = gl.read_record(path, columns=COLUMNS)
        assert record.frame["glucose_mg_dl"].drop_nulls().is_between(20, 800).all()
    except gl.Refusal as error:
        sentence = str(error)
    assert sentence.isprintable()
    assert capfd.readouterr() == ("", "")
