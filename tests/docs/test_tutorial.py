"""The tutorial and the gallery: what they show is run, and what they name is there."""

import re
import shlex
from pathlib import Path

import pytest

from glucoloop.cli import main

DOCS = Path(__file__).resolve().parents[2] / "docs"
TUTORIAL = (DOCS / "tutorial.md").read_text(encoding="utf-8")


def commands() -> list[str]:
    blocks = re.findall(r"^```text\n(.*?)^```", TUTORIAL, re.MULTILINE | re.DOTALL)
    return [line for block in blocks for line in block.splitlines() if line.startswith("glucoloop ")]


@pytest.fixture
def pictures(docs_module):
    return docs_module("pictures")


def test_every_script_of_the_gallery_has_its_place(pictures):
    assert {path.stem for path in (DOCS / "gallery").glob("*.py")} == set(pictures.SCRIPTS)


def test_a_script_is_read_as_title_text_and_code(pictures):
    for name in pictures.SCRIPTS:
        script = pictures.Script.read(DOCS / "gallery" / f"{name}.py")
        assert "\n" not in script.title
        assert script.text.endswith(".")
        assert script.code.startswith(("import ", "from "))
        assert "figure" in script.code.splitlines()[-1] or "figure" in script.code


def test_what_the_tutorial_includes_is_made(pictures):
    included = re.findall(r"^```\{include\} _pictures/(\w+)-(?:code|figure)\.md$", TUTORIAL, re.MULTILINE)
    assert set(included) <= set(pictures.SCRIPTS)
    assert len(included) == 2 * len(set(included))


def test_a_script_becomes_figure_and_text(pictures, tmp_path):
    path = tmp_path / "one.py"
    path.write_text(
        '"""One title\n\nOne sentence.\n"""\n\nfrom matplotlib.figure import Figure\n\nprint(7)\nfigure = Figure()\n'
    )
    pictures.run(pictures.Script.read(path), tmp_path)
    assert (tmp_path / "one.png").stat().st_size > 0
    assert "```text\n7\n```" in (tmp_path / "one-code.md").read_text()
    assert ":alt: One title" in (tmp_path / "one-figure.md").read_text()


def test_a_script_without_a_figure_or_a_description_is_refused(pictures, tmp_path):
    path = tmp_path / "one.py"
    path.write_text('"""One title\n\nOne sentence.\n"""\n\nprint(7)\n')
    with pytest.raises(ValueError, match="leaves no figure"):
        pictures.run(pictures.Script.read(path), tmp_path)
    path.write_text('"""One title"""\n')
    with pytest.raises(ValueError, match="begins without"):
        pictures.Script.read(path)


@pytest.mark.long
def test_the_commands_of_the_tutorial_run(monkeypatch, tmp_path, capsys):
    monkeypatch.chdir(tmp_path)
    lines = commands()
    assert len(lines) > 5
    for line in lines:
        with pytest.raises(SystemExit) as left:
            main(shlex.split(line)[1:])
        assert left.value.code == 0, f"{line}: {capsys.readouterr().err}"
