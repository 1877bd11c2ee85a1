"""How much a table unfolds to is told before it is read, by this program as by another one, and of no file too late."""

import contextlib
import io

import duckdb
import numpy as np
import polars as pl
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from glucoloop.schema.tables import TableBounds, parquet_size
from glucoloop.storage.results import parquet, read_parquet

TABLES = {
    "nobody": pl.DataFrame({"a": pl.Series([], dtype=pl.Float64)}),
    "one": pl.DataFrame({"a": [1.0], "b": ["x"], "c": [True], "d": [None]}),
    "groups": pl.DataFrame({"a": np.arange(10_000), "b": [f"label {n % 7}" for n in range(10_000)]}),
    "wide": pl.DataFrame({f"column {n}": [float(n)] * 3 for n in range(300)}),
    "lists": pl.DataFrame({"a": [[1, 2], [], None]}),
}


@pytest.mark.parametrize("name", TABLES)
@pytest.mark.parametrize(
    "options", [{}, {"row_group_size": 1000}, {"compression": "uncompressed", "statistics": False}]
)
def test_agrees_with_another_reader(tmp_path, name, options):
    TABLES[name].write_parquet(tmp_path / "t.parquet", **options)
    size = parquet_size((tmp_path / "t.parquet").read_bytes())
    with duckdb.connect() as connection:
        found = connection.execute(
            "select coalesce(sum(total_uncompressed_size), 0) from parquet_metadata(?)", [f"{tmp_path}/t.parquet"]
        ).fetchall()
    assert [(size.bytes,)] == found
    assert size.rows == TABLES[name].height


def test_small_file_of_a_huge_table_is_not_unfolded(tmp_path, monkeypatch):
    buffer = io.BytesIO()
    pl.DataFrame({"a": np.zeros(20_000_000)}).write_parquet(buffer, compression="zstd")
    (tmp_path / "t.parquet").write_bytes(buffer.getvalue())
    assert len(buffer.getvalue()) < 200_000
    monkeypatch.setattr(pl, "read_parquet", lambda *of: pytest.fail("it was read"))
    with pytest.raises(ValueError, match=r"t\.parquet is damaged: it has 20000000 rows, and 100 are expected"):
        read_parquet(tmp_path / "t.parquet", TableBounds(least_rows=100, most_rows=100, columns=1))


def test_long_texts_are_not_unfolded(tmp_path):
    pl.DataFrame({"a": ["x" * 30_000_000]}).write_parquet(tmp_path / "t.parquet", compression="zstd")
    with pytest.raises(ValueError, match=r"it unfolds to 3.* bytes, and at most"):
        read_parquet(tmp_path / "t.parquet", TableBounds(least_rows=1, most_rows=1, columns=1, longest_text=10))


def varint(number, width=0):
    """A whole number of the compact protocol, in so many bytes or in as few as it takes."""
    zigzag, last = 2 * number, max(width, -(-max(2 * number, 1).bit_length() // 7)) - 1
    return bytes((zigzag >> 7 * n) & 127 | (128 if n < last else 0) for n in range(last + 1))


def lying(table):
    """A file whose footer says one row and nothing to unfold, and whose only page holds the whole table."""
    buffer = io.BytesIO()
    one = {"data_page_size": 2**31 - 1, "row_group_size": table.height}
    table.write_parquet(buffer, compression="zstd", statistics=False, **one)
    data = buffer.getvalue()
    begin = len(data) - 8 - int.from_bytes(data[-8:-4], "little")
    footer, size = data[begin:-8], parquet_size(data)
    for old, new in ((table.height, 1), (size.bytes, 0)):
        assert varint(old) in footer
        footer = footer.replace(varint(old), varint(new, len(varint(old))))
    return data[:begin] + footer + data[-8:]


def test_footer_that_lies_about_its_pages_is_not_believed(tmp_path, monkeypatch):
    (tmp_path / "t.parquet").write_bytes(lying(pl.DataFrame({"a": np.zeros(2_000_000)})))
    assert (tmp_path / "t.parquet").stat().st_size < 20_000
    with duckdb.connect() as connection:
        told = connection.execute(
            "select num_values, total_uncompressed_size from parquet_metadata(?)", [f"{tmp_path}/t.parquet"]
        ).fetchall()
    assert told == [(1, 0)]
    monkeypatch.setattr(pl, "read_parquet", lambda *of: pytest.fail("it was read"))
    with pytest.raises(ValueError, match=r"it unfolds to 160000\d\d bytes, and at most 10000016 are expected"):
        read_parquet(tmp_path / "t.parquet", TableBounds(least_rows=1, most_rows=1, columns=1))


WHOLE = parquet(TABLES["one"])


@given(
    st.integers(4, len(WHOLE) - 9),
    st.binary(min_size=1, max_size=9),
)
def test_damaged_file_is_a_sentence_or_a_number(at, bytes_there):
    data = WHOLE[:at] + bytes_there + WHOLE[at + len(bytes_there) :]
    with contextlib.suppress(ValueError):
        size = parquet_size(data)
        assert size.rows >= 0
        assert size.bytes >= 0


@pytest.mark.long
@given(st.binary(max_size=300))
@example(b"")
@example(b"\x19\xfc\xff\xff\xff\xff\x0f")
@example(b"\x1c" * 200)
def test_anything_in_a_footer_is_a_sentence_or_a_number(footer):
    data = b"PAR1" + footer + len(footer).to_bytes(4, "little") + b"PAR1"
    with contextlib.suppress(ValueError):
        assert parquet_size(data).rows >= 0


@pytest.mark.parametrize("count", [-64, -1, 63])
def test_a_page_that_lies_about_its_number_of_values_is_not_read(count):
    """By it polars asks for memory, and ends the process where there is not as much."""
    buffer = io.BytesIO()
    pl.DataFrame({"a": ["x", None, "x"]}).write_parquet(buffer, statistics=False)
    data, bounds = buffer.getvalue(), TableBounds(least_rows=3, most_rows=3, columns=1)
    assert bounds.check(data) == 3
    begin, _, end = data.partition(b"\x2c\x15\x06\x15")  # header of a data page, whose first field is three values
    with pytest.raises(ValueError, match=r"damaged|63 values, and at most 3 are expected"):
        bounds.check(begin + bytes([0x2C, 0x15, (count << 1 ^ count >> 63) & 127, 0x15]) + end)
