"""A page in another language: its texts stand in the place of the English ones, and none is passed over in silence."""

import json
import subprocess

import pytest

from browser import NODE
from glucoloop.lab.pack import PAGE, page
from glucoloop.pages import program
from glucoloop.refusal import Refusal

BEGUN = """export const language = "de";
export const own = {{
  page: {{ pin: "Anheften"{more} }},
  run: (number) => `Lauf ${{number}}`,
}};
export const sentences = {{ {sentences} }};
"""


def begun(more="", sentences=""):
    """A module of a language with few texts."""
    return BEGUN.format(more=more, sentences=sentences)


@pytest.fixture
def told():
    """What the module of texts holds with a language in its place, and data that it has put into words."""

    if NODE is None:
        pytest.skip("needs node (Debian: apt install nodejs)")

    def tell(language, data="{}"):
        code = program([PAGE / "texts.mjs"], {PAGE / "language.mjs": language})
        asked = (
            'const { texts, unknown, dataInWords } = need("texts");'
            f"const data = dataInWords({json.dumps(data)});"
            "console.log(JSON.stringify([texts.page.pin, texts.run(2), texts.page.undo, data, unknown]));"
        )
        done = subprocess.run([NODE, "-e", code + asked], capture_output=True, text=True, check=True)
        return json.loads(done.stdout)

    return tell


def test_what_is_left_out_stays_english(told):
    pin, run, undo, data, unknown = told(begun())
    assert (pin, run, undo) == ("Anheften", "Lauf 2", "Undo")
    assert (data, unknown) == ({}, [])


@pytest.mark.parametrize("shown", ["Largest dose.", "Largest dose"])
def test_sentences_of_the_data_are_put_into_words(told, shown):
    data = {"summary": "Largest dose.", "name": "usual", "least": 1.5}
    language = begun(sentences=f'"{shown}": "Größte Dosis."')
    assert told(language, json.dumps(data))[3:] == [{**data, "summary": "Größte Dosis."}, []]


def test_what_the_page_does_not_have_is_named(told):
    language = begun(more=', pim: "Anheften", undo: ["Zurück"]', sentences='"Nothing.": "Nichts."')
    *_, unknown = told(language)
    assert unknown == ["page.pim", "page.undo", "Nothing."]


@pytest.mark.parametrize(
    ("language", "why"),
    [
        ("export const language = 'de';", "exports no 'own' and no 'sentences'; begin each with a line like"),
        (begun() + 'import "other.mjs";', "does not fit the page: language.mjs has 'import"),
    ],
)
def test_a_file_of_another_form_is_refused(language, why):
    with pytest.raises(Refusal, match=why):
        page(language=language)
