"""Publications of parts: each is there, is used, and is an entry that BibTeX reads."""

import re
from pathlib import Path

import pytest
import yaml

import glucoloop
from glucoloop.component.catalogue import catalogues
from glucoloop.component.listing import known_references, reference

PARTS = [part for kind in catalogues().values() for part in kind.values()]
USED = {source for part in PARTS for source in part.sources}
POPULATIONS = {name for part in catalogues()["patient"].values() for name in part.populations}
CITATION = Path(__file__).parents[2] / "CITATION.cff"


def test_every_source_of_a_part_is_known_and_every_publication_has_a_use():
    assert set(known_references()) >= USED
    assert set(known_references()) <= USED | POPULATIONS | {"glucoloop"}


@pytest.mark.parametrize("kind", ["patient", "meal model", "rhythm", "estimator"])
def test_every_model_of_the_body_names_its_source(kind):
    assert [part.name for part in catalogues()[kind].values() if not part.sources] == []


@pytest.mark.parametrize("key", known_references())
def test_an_entry_is_one_that_bibtex_reads(key):
    lines = known_references()[key].bibtex().splitlines()
    assert re.fullmatch(rf"@[a-z]+\{{{key},", lines[0])
    assert lines[-1] == "}"
    for line in lines[1:-1]:
        value = re.fullmatch(r"  [a-z]+ = \{(.*)\},?", line)[1]
        depth = 0
        for letter in value:
            depth += {"{": 1, "}": -1}.get(letter, 0)
            assert depth >= 0
        assert depth == 0
        assert not re.search(r"(?<!\\)[&%#]", value)


def test_family_names_of_several_words_stay_together():
    entry = known_references()["rebrin1999"].bibtex()
    assert "author = {Rebrin, K. and Steil, G. M. and van Antwerp, W. P. and Mastrototaro, J. J.}" in entry
    assert "Doyle, III, F. J." in known_references()["parker1999"].bibtex()


def test_a_publication_is_one_line_for_people():
    assert reference("parker1999").text == (
        "R. S. Parker, F. J. Doyle III, N. A. Peppas, "
        '"A model-based algorithm for blood glucose control in type I diabetic patients", '
        "IEEE Trans. Biomed. Eng. 46(2), 148-157, 1999"
    )


def test_the_citation_file_tells_the_same_of_glucoloop():
    told, known = yaml.safe_load(CITATION.read_text(encoding="utf-8")), known_references()["glucoloop"].fields
    assert told["title"] == known["title"]
    assert told["version"] == known["version"] == glucoloop.__version__
