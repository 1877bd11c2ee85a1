"""No text of a file or of the command line reaches the terminal with control characters."""

import ast
import io
import json
import unicodedata
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.table import Table

import glucoloop
from glucoloop.cli import app, screen
from glucoloop.text import is_printable, printable, printable_json, printable_lines

HOSTILE = "\x1b[2J\x1b]0;title\x07 \x9b31m \x08\r \x7f \u202egnp \u2066 \u2028 \x0b\x0c \ud800"
SOURCE = Path(glucoloop.__file__).parent
DOORS = {
    "cli/screen.py": {"print", "stdout", "stderr"},
    "cli/app.py": {"stdout", "stderr"},
    "cli/progress.py": {"stderr"},
    "records/workbook_process.py": {"stdout"},
}
"""Files that may print: the door, those that prepare streams or look whether one is a terminal, and a process that
answers the one that started it, which checks each cell like that of any other file."""


def harmless(text):
    turning = set("\u202e\u2066\u200f\u061c")
    control = {letter for letter in text if unicodedata.category(letter) in ("Cc", "Cs", "Zl", "Zp")}
    return not (control - set("\n\t")) and not (turning & set(text))


def test_everything_is_printed_in_one_place():
    """A print that goes past the door would show what it is given."""
    found = {}
    for file in sorted(SOURCE.rglob("*.py")):
        name = file.relative_to(SOURCE).as_posix()
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "print":
                found.setdefault(name, set()).add("print")
            of_sys = isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "sys"
            if of_sys and node.attr in ("stdout", "stderr", "__stdout__", "__stderr__"):
                found.setdefault(name, set()).add(node.attr)
    assert found == DOORS


@pytest.mark.parametrize(
    "shown",
    [
        lambda: screen.print_text(HOSTILE),
        lambda: screen.print_text(HOSTILE, error=True),
        lambda: screen.note([HOSTILE]),
        lambda: screen.show(Table(HOSTILE)),
        lambda: screen.print_json({HOSTILE: HOSTILE}, {"a": HOSTILE}, [HOSTILE]),
    ],
)
def test_what_is_printed_is_harmless(capsys, shown):
    shown()
    captured = capsys.readouterr()
    assert harmless(captured.out + captured.err)
    assert "title" in captured.out + captured.err


def test_cells_of_a_table_are_harmless(capsys):
    table = Table("Name")
    table.add_row(HOSTILE)
    screen.show(table)
    out = capsys.readouterr().out
    assert harmless(out)
    assert r"\x1b" in out


def test_json_keeps_its_value(capsys):
    screen.print_json({"text": HOSTILE}, {})
    assert json.loads(capsys.readouterr().out)["text"] == HOSTILE


def test_the_traceback_of_a_bug_is_harmless(capsys):
    error = RuntimeError(HOSTILE)
    app._print_bug(RuntimeError, error, None)
    assert harmless(capsys.readouterr().err)


@pytest.mark.parametrize("name", ["a\x1b[2J.toml", "a\u202eb.csv"])
def test_a_path_is_harmless(glucoloop, name):
    for arguments in (("run", "--config", name), ("records", name), ("cite", name), (name,), ("run", "--no\x1b[2J")):
        answer = glucoloop(*arguments)
        assert answer.code == 2
        assert harmless(answer.out + answer.err)


def test_a_configuration_is_harmless(glucoloop, tmp_path):
    for text in (
        'patient = "\\u001b[2J"',
        '"\\u001b[2J" = 1',
        '[[controller]]\nlabel = "\\u001b[2J"\nkind = "mpc"',
        'glucoloop = "\\u001b[2J"\npatient = "\\u202ex"',
    ):
        (tmp_path / "a.toml").write_text(text)
        answer = glucoloop("run", "--config", "a.toml")
        assert answer.code == 2
        assert harmless(answer.out + answer.err)


@given(st.text())
def test_text_that_can_be_printed_stays(text):
    assert is_printable(printable(text))
    assert harmless(printable_lines(text))
    assert (printable(text) == text) == is_printable(text)
    assert json.loads(printable_json(json.dumps(text, ensure_ascii=False))) == text


def test_columns_are_as_wide_as_before(capsys):
    """What can be printed is printed as rich does it."""
    table = Table("Name", "Value")
    table.add_row("glucose", "1")
    screen.show(table)
    from rich.console import Console

    Console(width=200, highlight=False, file=(expected := io.StringIO())).print(table)
    assert capsys.readouterr().out == expected.getvalue()
