"""The exercise sheets: the page takes the situations that they give, and shows the numbers of their solutions."""

import re
from pathlib import Path

DOCS = Path(__file__).resolve().parents[2] / "docs"
NUMBER = re.compile(r"\d+\.\d")


def printed(text, row):
    """Numbers of the rows of this name in what commands print."""
    return [float(number) for line in re.findall(rf"^ +{row} .*$", text, re.M) for number in NUMBER.findall(line)]


def test_the_page_shows_the_numbers_of_the_sheets(in_node):
    texts = {path.name: path.read_text(encoding="utf-8") for path in sorted((DOCS / "exercises").glob("*.md"))}
    given = [(name, link) for name, text in texts.items() for link in re.findall(r"`lab\.html(#[^`]+)`", text)]
    assert len({name for name, _ in given}) == 6
    for (name, link), answer in zip(given, in_node([link for _, link in given]), strict=True):
        assert "refused" not in answer, f"{name}: {link}: {answer.get('refused')}"
        for row, shown in (("Minimum glucose", "minimum_mg_dl"), ("Maximum glucose", "peak_mg_dl")):
            # a printed number is rounded to 0.1, and page and program agree to 0.02 mg/dl
            assert min(abs(number - answer["summary"][shown]) for number in printed(texts[name], row)) < 0.07, name
