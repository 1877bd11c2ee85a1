"""Every reader of the catalogue on damaged files: a record whose rows are used or named, or a sentence."""

import contextlib

import hypothesis.strategies as st
import pytest
from hypothesis import HealthCheck, given, settings

import glucoloop as gl
from device_files import FILES, NAME, SERIAL, SURNAME
from glucoloop.records.answers import Answers
from glucoloop.records.file_text import DELIMITERS, content_of
from glucoloop.records.reader import READERS
from glucoloop.records.reading import reader_of
from glucoloop.text import is_printable

MANY = settings(
    max_examples=24, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow]
)
ENCODINGS = (
    "utf-8",
    "utf-8-sig",
    "utf-16",
    "utf-16-le",
    "utf-16-be",
    "utf-32",
    "cp1252",
    "latin-1",
    "cp1250",
    "mac_roman",
)
HUGE = (
    "9" * 5000,
    "x" * 100_000,
    "\u202e\x1b[31m" * 50,
    "1e308",
    "-1e308",
    "0" * 3000 + "1",
    '"' * 999,
    "=cmd|' /C x'!A1",
)


def test_each_reader_has_a_file():
    of_each = {reader_of(content_of(text.encode()), Answers()).name for text in FILES.values()}
    assert of_each == set(READERS.names())


@pytest.mark.parametrize("name", FILES)
def test_names_of_columns_in_another_case(tmp_path, name):
    (tmp_path / "upper").write_text(FILES[name].upper() if "{" not in FILES[name] else FILES[name])
    with contextlib.suppress(gl.Refusal):
        assert gl.read_record(tmp_path / "upper").frame.height


def cut(data, draw):
    return data[: draw(st.integers(0, len(data)))]


def flipped(data, draw):
    damaged = bytearray(data)
    for at in draw(st.lists(st.integers(0, len(data) - 1), min_size=1, max_size=30)):
        damaged[at] ^= 1 << draw(st.integers(0, 7))
    return bytes(damaged)


def lines_doubled(data, draw):
    lines = data.split(b"\n")
    for at in draw(st.lists(st.integers(0, len(lines) - 1), min_size=1, max_size=6)):
        lines.insert(draw(st.integers(0, len(lines))), lines[at])
    return b"\n".join(lines)


def columns_exchanged(data, draw):
    """Two columns change their places, in all lines or from one on."""
    text = data.decode()
    delimiter = max(DELIMITERS, key=text.count)
    first, second = draw(st.integers(0, 14)), draw(st.integers(0, 14))
    begin = draw(st.integers(0, text.count("\n")))
    lines = []
    for number, line in enumerate(text.split("\n")):
        cells = line.split(delimiter)
        if number >= begin and max(first, second) < len(cells):
            cells[first], cells[second] = cells[second], cells[first]
        lines.append(delimiter.join(cells))
    return "\n".join(lines).encode()


def encoded(data, draw):
    return data.decode().encode(draw(st.sampled_from(ENCODINGS)), "replace")


def huge_cells(data, draw):
    text = data.decode()
    delimiter = max(DELIMITERS, key=text.count)
    lines = text.split("\n")
    for _ in range(draw(st.integers(1, 3))):
        at = draw(st.integers(0, len(lines) - 1))
        cells = lines[at].split(delimiter)
        cells[draw(st.integers(0, len(cells) - 1))] = draw(st.sampled_from(HUGE))
        lines[at] = delimiter.join(cells)
    return "\n".join(lines).encode()


DAMAGES = (cut, flipped, lines_doubled, columns_exchanged, encoded, huge_cells)


@pytest.mark.long
@pytest.mark.parametrize("name", FILES)
@MANY
@given(data=st.data())
def test_damaged(tmp_path, name, data):
    path = tmp_path / "damaged"
    path.write_bytes(data.draw(st.sampled_from(DAMAGES))(FILES[name].encode(), data.draw))
    record, refusal = None, ""
    try:
        record = gl.read_record(path)
    except gl.Refusal as error:
        refusal = str(error)
    assert is_printable(refusal)
    assert not any(secret in refusal for secret in (NAME, SURNAME, SERIAL))
    if record is None:
        return
    assert record.rows == record.rows_used + sum(record.left_out.values())
    for reason, count in record.left_out.items():
        assert f"Left out: {reason} ({count})." in record.notes
    assert all(map(is_printable, [*record.notes, *record.left_out, *record.frame["device"].drop_nulls().unique()]))
    assert not any(secret in note for secret in (NAME, SURNAME, SERIAL) for note in record.notes)
