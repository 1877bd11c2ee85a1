"""Numbers stand with their nouns and verbs."""

import pytest

from glucoloop.printable import how_many


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ((1, "meal"), "1 meal"),
        ((0, "meal"), "0 meals"),
        ((2, "meal"), "2 meals"),
        ((1, "person", "people"), "1 person"),
        ((20, "person", "people"), "20 people"),
    ],
)
def test_number_with_its_noun(words, told):
    assert how_many(*words) == told
