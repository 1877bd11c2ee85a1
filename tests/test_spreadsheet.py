"""Texts in CSV tables: no spreadsheet computes them, they are read back as they were, and numbers stay numbers."""

import csv
import io
import json
import re
import shutil
import subprocess

import polars as pl
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from glucoloop.pages import PAGES
from glucoloop.situations.population import named_population
from glucoloop.spreadsheet import text_cell, text_of_cell, write_rows
from glucoloop.storage import results

COMPUTED = "=+-@\t\r\n＝＋－＠"
TEXTS = st.text(st.one_of(st.sampled_from(COMPUTED + "';,\" a1"), st.characters(codec="utf-8")), max_size=12)
NODE = shutil.which("node")


def cells(text):
    """Cells that a spreadsheet may see in one, where it divides by commas, semicolons or tabs."""
    return [text, *re.split(r"[;\t\r\n]", text)]


@example("=cmd|' /C calc'!A0")
@example("a;=1+1")
@example("'=1")
@example("\t=1")
@given(TEXTS)
def test_a_text_is_never_computed_and_is_read_back(text):
    cell = text_cell(text)
    assert not any(part.startswith(tuple(COMPUTED)) for part in cells(cell))
    assert text_of_cell(cell) == text
    if not any(part.lstrip("'").startswith(tuple(COMPUTED)) for part in cells(text)):
        assert cell == text


def test_tables_keep_numbers_and_escape_texts_names_and_lists():
    table = pl.DataFrame(
        {
            "=name": ["=1+1", None],
            "minus": [-0.1, -1e-300],
            "whole": [-3, 4],
            "numbers": [[-1.5, 2.0], []],
            "texts": [["=1", "b"], ["a"]],
            "kind": pl.Series(["@a", "b"], dtype=pl.Categorical),
        }
    )
    assert results.csv(table).decode() == (
        "'=name,minus,whole,numbers,texts,kind\n'=1+1,-0.1,-3,-1.5 2.0,'=1 b,'@a\n,-1e-300,4,\"\",a,b\n"
    )


@given(st.lists(st.tuples(TEXTS, st.floats(allow_nan=False), st.integers()), max_size=3))
def test_rows_keep_numbers_and_escape_texts(rows):
    out = io.StringIO()
    write_rows(out, ["@name", "x", "n"], rows)
    head, *lines = csv.reader(io.StringIO(out.getvalue(), newline=""))
    assert head == ["'@name", "x", "n"]
    assert [(text_of_cell(name), float(x), int(n)) for name, x, n in lines] == rows


def test_people_of_a_table_are_read_with_the_names_that_were_written(tmp_path):
    out = io.StringIO()
    names = ["=anna", "-ben", "'carla"]
    write_rows(out, ["name", "weight_kg"], [[name, 60.0 + i] for i, name in enumerate(names)])
    file = tmp_path / "people.csv"
    file.write_text(out.getvalue())
    people = named_population(str(file), "hovorka-2004")
    assert list(people.table.names) == names


@pytest.mark.skipif(NODE is None, reason="needs node (Debian: apt install nodejs)")
def test_pages_write_the_same_cells_and_read_them_back(tmp_path):
    texts = ["=1+1", "+a", "-b", "@c", "\td", "\re", "'=f", "''g", "a;=1", "calm, glucose", 'a "b"', "＝1", "plain", ""]
    script = tmp_path / "csv.mjs"
    script.write_text(
        f"import {{ csvText, csvRows }} from {json.dumps(str(PAGES / 'csv.mjs'))};\n"
        f"const text = csvText({json.dumps([[text, -1.5, 0] for text in texts])});\n"
        "console.log(JSON.stringify([text, csvRows(text)]));\n"
    )
    done = subprocess.run([NODE, script], capture_output=True, text=True, check=True)
    text, rows = json.loads(done.stdout)
    assert rows == [[text, "-1.5", "0"] for text in texts]
    assert list(csv.reader(io.StringIO(text, newline=""))) == [[text_cell(text), "-1.5", "0"] for text in texts]
