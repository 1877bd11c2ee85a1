"""Damaged and odd files: a sentence, never a traceback, and never a row lost in silence."""

import itertools
import json

import hypothesis.strategies as st
import pytest
from hypothesis import HealthCheck, example, given, settings

import glucoloop as gl
from device_files import (
    FILES,
    START,
    clarity,
    every,
    glucose,
    nightscout_entries,
    nightscout_treatments,
    tandem,
    tidepool,
)
from naming import naming

TEMPORARY = [
    (time, {"eventType": "Temp Basal", "absolute": 0.5, "duration": 30, "percent": -50}) for time in every(20, 10)
]
BYTES = {name: text.encode() for name, text in FILES.items()}
TABLES = ("clarity", "libre")
QUICK = settings(
    max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow]
)


def read_or_refused(path, data, **asked):
    """Record of damaged data, or None where it is refused; any other error is a bug."""
    path.write_bytes(data)
    try:
        record = gl.read_record(path, **asked)
    except gl.Refusal as error:
        told = str(error)
        assert told.startswith(f"{path}: ")
        assert "\n" not in told
        return None
    assert record.rows == record.rows_used + sum(record.left_out.values())
    assert record.frame["time"].is_sorted()
    assert record.frame["glucose_mg_dl"].drop_nulls().is_between(20, 800).all()
    assert sum(f"({count})" in note for note in record.notes for count in set(record.left_out.values())) >= len(
        set(record.left_out.values())
    )
    return record


@pytest.mark.parametrize("name", FILES)
@QUICK
@given(data=st.data())
def test_cut_off(tmp_path, name, data):
    whole = BYTES[name]
    read_or_refused(tmp_path / "cut", whole[: data.draw(st.integers(0, len(whole)))])


@pytest.mark.long
@pytest.mark.parametrize("name", TABLES)
@QUICK
@given(rows=st.integers(6, 30))
def test_every_line_of_a_cut_table_is_counted(tmp_path, name, rows):
    lines = FILES[name].splitlines()[: rows + 2]
    lines[-1] = lines[-1][: len(lines[-1]) // 2]
    record = read_or_refused(tmp_path / "cut", "\n".join(lines).encode())
    assert record is not None
    assert record.left_out["a last row that is cut off"] == 1
    assert record.rows == len(lines) - {"clarity": 1, "libre": 2}[name]


def test_a_part_of_the_last_value_is_not_a_value(tmp_path):
    above = "".join(f"2024-03-13 08:{5 * n:02d},{{}}\n" for n in range(6))
    for cell, last, why in (
        ("312", "31", "a last row that is cut off"),
        ("298", "31", "a last row that may be cut off"),
        ("10.4", "10.", "a last row that is cut off"),
        ("10.4", "9", "a last row that is cut off"),
        ('"10,4"', '"9,', "a last row that is cut off"),
        ("298", "312", None),
        ("298", "0", None),
        ("8.4", "10.4", None),
    ):
        unit = "glucose_mg_dl" if cell.isdecimal() else "glucose_mmol_l"
        text = f"time,{unit}\n" + above.format(*6 * [cell]) + f"2024-03-13 08:30,{last}"
        for end in ("", "\n"):
            with naming(f"{last!r} after {cell!r}, then {end!r}"):
                record = read_or_refused(tmp_path / "cut", (text + end).encode())
                cut = {name for name in record.left_out if "cut off" in name}
                assert cut == ({why} if why and not end else set())


def test_a_part_of_a_number_in_full_is_not_a_value(read):
    others = ["7.123456789012345", "8.5", *(f"{7 + n / 7:.15f}" for n in range(20))]
    rows = [f"2024-03-13 08:{n:02d},{value}" for n, value in enumerate(others)]
    for last, cut in (("9.12", 1), ("9", 1), ("9.12345678901234", 0)):
        with naming(last):
            record = read("\n".join(["time,glucose_mmol_l", *rows, f"2024-03-13 09:00,{last}"]))
            assert record.left_out == ({"a last row that is cut off": 1} if cut else {})


@pytest.mark.long
def test_what_is_read_of_a_cut_file_stands_in_the_whole_one(tmp_path):
    for name in ("tandem", "t1d-uom", "replaybg", "carelink", "glooko"):
        whole = FILES[name]
        columns = ["time", "glucose_mg_dl", "carbs_g", "bolus_U", "bolus_min"]
        rows = set(read_or_refused(tmp_path / "whole", whole.encode()).frame.select(columns).iter_rows())
        for at in range(len(whole) - 90, len(whole)):
            with naming(f"{name} at {at}"):
                record = read_or_refused(tmp_path / "cut", whole[:at].encode())
                assert record is None or set(record.frame.select(columns).iter_rows()) <= rows


def test_doses_of_a_row_that_cannot_be_used_are_not_used(tmp_path):
    text = tandem().replace(',"2.00","3.00","120","30",', ',"2.00","3.00","120","30","x","x","x","x","x","x","x","x",')
    record = read_or_refused(tmp_path / "more", text.encode())
    assert record.left_out["rows with more fields than the header"] == 1
    assert 3.0 not in record.frame["bolus_U"].to_list()


@pytest.mark.long
@pytest.mark.parametrize("name", FILES)
@QUICK
@given(place=st.integers(0, 10_000), junk=st.binary(min_size=1, max_size=40))
@example(place=900, junk=b'"')
@example(place=3000, junk=b"\xff\xfe\x00")
def test_binary_junk_within(tmp_path, name, place, junk):
    whole = BYTES[name]
    at = place % len(whole)
    read_or_refused(tmp_path / "junk", whole[:at] + junk + whole[at + len(junk) :])


ODD = st.one_of(
    *(st.none(), st.booleans(), st.integers(), st.floats(), st.text(max_size=8), st.lists(st.integers(), max_size=2)),
    st.sampled_from([1e300, -1e14, 10**13, "2024-02-30T00:00:00Z", "12/12/12 12:12", "Temp Basal", {}]),
)


@pytest.mark.long
@pytest.mark.parametrize("name", ["nightscout", "tidepool", "treatments"])
@QUICK
@given(odd=st.lists(st.tuples(st.integers(0, 29), st.integers(0, 20), ODD), min_size=1, max_size=6))
def test_odd_values_in_json(tmp_path, name, odd):
    items = json.loads(FILES.get(name) or nightscout_treatments(*TEMPORARY))
    for row, key, value in odd:
        item = items[row % len(items)]
        item[list(item)[key % len(item)]] = value
    record = read_or_refused(tmp_path / "odd", json.dumps(items).encode())
    assert record is None or record.rows == len(items)


@QUICK
@given(junk=st.binary(max_size=400))
@example(junk=b"")
@example(junk=b"PAR1")
@example(junk=b"[" * 100_000)
@example(junk=b"<glucose_level")
@example(junk=b"\xff\xfea")
@example(junk="Index,Timestamp,Event Type,Glucose Value\n".encode("utf-16"))
def test_nothing_but_junk(tmp_path, junk):
    assert read_or_refused(tmp_path / "junk", junk) is None


@pytest.mark.long
@pytest.mark.parametrize("name", TABLES)
@QUICK
@given(quotes=st.sets(st.integers(0, 20_000), min_size=1, max_size=5))
@example(quotes={0, 1})
@example(quotes={0, 2101})
def test_quotes_that_do_not_close_swallow_no_row(tmp_path, name, quotes):
    lines = FILES[name].splitlines()
    head = {"clarity": 1, "libre": 2}[name]
    for place in quotes:
        row = head + place % (len(lines) - head)
        at = place % (len(lines[row]) + 1)
        lines[row] = f'{lines[row][:at]}"{lines[row][at:]}'
    record = read_or_refused(tmp_path / "quotes", "\n".join(lines).encode())
    assert record is not None
    assert record.rows == len(lines) - head


@pytest.mark.parametrize(("name", "delimiter"), list(itertools.product(TABLES, ";\t")))
def test_another_delimiter_is_seen(read, name, delimiter):
    assert read(FILES[name].replace(",", delimiter)).frame.equals(read(FILES[name]).frame)


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "cp1252"])
@pytest.mark.parametrize("name", FILES)
def test_another_encoding_is_seen(read, name, encoding):
    assert read(FILES[name].replace("\n", "\r\n").encode(encoding, "replace")).frame.equals(read(FILES[name]).frame)


@pytest.mark.long
@QUICK
@given(mixed=st.sets(st.integers(0, 29), max_size=12))
def test_some_readings_in_mmol_are_left_out_by_name(tmp_path, mixed):
    lines = FILES["clarity"].splitlines()
    for row in mixed:
        lines[5 + row] = lines[5 + row].replace(f"G6,{glucose(row)},", f"G6,{glucose(row) / 18:.1f},")
    record = read_or_refused(tmp_path / "mixed", "\n".join(lines).encode())
    assert record is not None
    assert record.left_out.get("rows with values that are no number or not possible", 0) == len(mixed)
    assert any("outside of 20 to 800 mg/dl" in note for note in record.notes) == bool(mixed)


def test_rows_with_a_decimal_comma_between_commas_are_left_out_by_name(read):
    lines = FILES["clarity"].splitlines()
    for row in (8, 9, 10):
        lines[row] = lines[row].replace(f"G6,{glucose(row - 5)},", "G6,101,5,")
    record = read("\n".join(lines))
    assert record.left_out["rows with more fields than the header"] == 3
    assert record.frame.height == 27
    assert record.frame["bolus_U"].null_count() == 27


def test_a_delimiter_at_the_end_of_every_row_does_no_harm(read):
    head, *lines = FILES["clarity"].splitlines()
    assert read("\n".join([head, *(f"{line}," for line in lines)])).frame.equals(read(FILES["clarity"]).frame)


def test_notes_of_several_files_name_the_file(read):
    record = read(
        clarity(3).replace("G6,100", "G6,x"), clarity(6, start=START.replace(hour=5)).replace("G6,100", "G6,y")
    )
    assert [note[:8] for note in record.notes if "no number." in note] == ["File 1: ", "File 2: "]


def test_a_note_of_two_lines_is_one_row(read):
    note = (
        "FreeStyle LibreLink,X,13-03-2024 00:09,6,,,,,,,,,,",
        '"a walk, then, oddly,\nsleep, and, later, more"',
        ",,,,,",
    )
    record = read(FILES["libre"] + "".join(note) + "\n")
    assert record.rows == 31
    assert record.left_out == {"notes and other entries": 1}


def test_another_unit_than_is_said_is_refused(refused):
    lines = [line.replace(f"G6,{glucose(n - 5)},", "G6,5.5,") for n, line in enumerate(clarity(30).splitlines())]
    assert refused("\n".join(lines)) == (
        "its glucose is taken as mg/dl, but it looks like mmol/l: half of the readings are below 5.5; if it is in "
        "mmol/l, say so where the unit is given"
    )


def test_a_unit_that_is_not_said_is_asked_for(read, refused):
    text = clarity(5).replace(" (mg/dL),Ins", ",Ins")
    assert refused(text).startswith("it does not say whether glucose is in mg/dl or in mmol/l; give glucose_unit")
    assert read(text, glucose_unit="mg/dl").frame.height == 5
    assert "leave out glucose_unit" in refused(clarity(5), glucose_unit="mmol/l")


def test_what_no_reader_knows_is_told_by_what_was_seen(refused):
    for text, seen in (
        ('{"name": 1, "age": 2}', "it is JSON, one object"),
        ("<html></html>", "it is XML or HTML"),
        ("hello", "it is text of 1 lines without commas, semicolons or tabs in the first"),
    ):
        assert refused(text).startswith(f"no reader knows it: {seen}. The readers are dexcom-clarity, libreview, ")
    assert (
        refused("[1, 2") == "it begins like JSON, and breaks off or is damaged; give the whole file as it was exported"
    )


def test_two_readers_that_could_take_a_file_are_named(read, refused):
    entries = nightscout_entries(3)[:-1] + "," + tidepool(3)[1:]
    told = refused(entries)
    assert told == "it could be read by nightscout and by tidepool; say which with reader=nightscout (--reader)"
    assert read(entries, reader="nightscout").rows == 6


def test_a_folder_a_missing_file_and_none_are_refused(tmp_path):
    for path, words in ((tmp_path, "it is a folder"), (tmp_path / "none.csv", "it cannot be read: No such file")):
        with pytest.raises(gl.Refusal, match=words):
            gl.read_record(path)
    with pytest.raises(gl.Refusal, match="no file is given"):
        gl.read_record()


def test_a_file_without_anything_to_use_says_what_it_has(refused):
    assert refused(clarity(0)) == (
        "nothing in it can be used: it has 4 rows, of which rows about the patient and the devices (4); give a file "
        "with readings, meals or insulin"
    )


def test_entities_of_xml_are_refused(refused):
    text = '<!DOCTYPE x [<!ENTITY a "b">]>' + FILES["ohio"].split("?>")[1]
    assert refused(text).startswith("it defines its own kinds of XML")
