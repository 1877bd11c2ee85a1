"""Numbers stand with their nouns and verbs."""

import pytest

from glucoloop.text import how_many, percent, without_credentials


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


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("lost (tcp://ann:s3cret@10.0.0.1:8786 timed out)", "lost (tcp://***@10.0.0.1:8786 timed out)"),
        ("https:/ann:s3cret@host/a.csv is no file", "https:/***@host/a.csv is no file"),
        ("GET /entries.json?count=3&token=s3cret&x=1 failed", "GET /entries.json?count=3&token=***&x=1 failed"),
        ("https:/a/b?token=s3cret: no such file", "https:/a/b?token=***: no such file"),
        ("s3://bucket/a?X-Amz-Signature=s3cret", "s3://bucket/a?X-Amz-Signature=***"),
        ("45g@7h and 20g@12:30 are meals", "45g@7h and 20g@12:30 are meals"),
        ("write to ann@example.org", "write to ann@example.org"),
    ],
)
def test_credentials_of_addresses_are_not_shown(text, shown):
    assert without_credentials(text) == shown
    assert "s3cret" not in without_credentials(text)
