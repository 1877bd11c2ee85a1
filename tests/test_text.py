"""Numbers stand with their nouns and verbs."""

import pytest

from glucoloop.text import how_many, percent


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


@pytest.mark.parametrize(
    ("share", "told"),
    [
        (100.0 - 2e-14, "100 %"),
        (2e-14, "0 %"),
        (99.995, "> 99.99 %"),
        (0.005, "< 0.01 %"),
        (99.5, "99.50 %"),
        (12.34, "12.3 %"),
    ],
)
def test_percentage_that_is_neither_a_few_nor_nearly_all(share, told):
    assert percent(share) == told
