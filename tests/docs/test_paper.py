"""The paper has the journal's form, no number without its command, and no citation without its entry."""

import re
import tomllib
from pathlib import Path

import pytest
import yaml

from glucoloop.cli import app
from glucoloop.patients.catalogue import PATIENTS

ROOT = Path(__file__).resolve().parents[2]
FOLDER = ROOT / "paper"
TEXT = (FOLDER / "paper.md").read_text(encoding="utf-8")
_, HEAD, BODY = TEXT.split("---\n", 2)
NUMBERS = tomllib.loads((FOLDER / "numbers.toml").read_text(encoding="utf-8"))["number"]
NAMES = re.compile(r"type [12] diabetes|model of 2008|Cortex-M4F|LoopInsighT1|oref0")
"""Names that hold a number which nothing measured."""


def plain(text):
    return " ".join(text.split())


def prose():
    """Text of the paper without citations and names."""
    return NAMES.sub("", re.sub(r"\[?(@[\w]+(; )?)+\]?", "", plain(BODY)))


def test_the_form_is_that_of_the_journal():
    head = yaml.safe_load(HEAD)
    assert head["authors"] == [{"name": "The glucoloop authors", "affiliation": 1}]
    assert {"title", "tags", "affiliations", "date"} <= head.keys()
    assert (FOLDER / head["bibliography"]).is_file()
    sections = re.findall(r"^# (.*)$", BODY, re.M)
    assert sections[:3] == ["Summary", "Statement of need", "State of the field"]
    assert {"What is new", "How it was checked", "Limits"} <= set(sections)
    assert sections[-1] == "References"
    assert 750 <= len(BODY.split()) <= 1750


@pytest.mark.parametrize("number", NUMBERS, ids=lambda number: number["text"][:40])
def test_a_number_has_its_page_and_its_command(number):
    assert number["text"] in plain(BODY)
    assert number["found"] in plain((ROOT / number["page"]).read_text(encoding="utf-8"))
    for command in number["commands"]:
        program, *words = command.split()
        if program == "python":
            assert (ROOT / words[0]).is_file()
        else:
            assert program == "glucoloop"
            app.command_of(words[0]).given(words[1:])


def test_no_number_is_without_them():
    text = prose()
    for number in NUMBERS:
        text = text.replace(number["text"], "")
    assert not re.findall(r"\S*\s?\S*\d\S*", text.replace("below 54 mg/dl", ""))


def test_the_people_are_counted():
    words = ["Five", "Six", "Seven", "Eight", "Nine", "Ten"]
    assert f"{words[len(PATIENTS) - 5]} models of people" in BODY


def test_entries_are_those_that_are_cited(docs_module):
    script = docs_module("bibliography")
    held = (FOLDER / "paper.bib").read_text(encoding="utf-8")
    assert held == script.bibliography(TEXT)
    assert re.findall(r"^@\w+\{(\w+),$", held, re.M) == script.cited(TEXT)
    assert held.count("{") == held.count("}")
