"""Documentation and help use the field's words."""

import re
from pathlib import Path

import pytest

from glucoloop.cli.app import command_of, names

ROOT = Path(__file__).parents[2]
TEXTS = ROOT / "src/glucoloop/lab/page/texts.mjs"
PAGES = sorted(
    [
        *(ROOT / name for name in ("README.md", "CONTRIBUTING.md", "SECURITY.md")),
        *(page for page in ROOT.glob("docs/**/*.md") if not page.parent.name.startswith("_")),
    ]
)
FIELD = {
    r"(under|below) the skin": "subcutaneous",
    r"(in|into) (a|the) vein": "intravenous",
    r"\banew\b": "again, re-initialised",
    r"\bwakes\b": "initialises",
    r"(believed|doubted) reading|reading (was|is) (believed|doubted)": "accepted or rejected reading",
    r"what could be reached": "performance limit, optimality gap",
    r"carried by the (\[?\w+ )?integrator": "integrated",
    r"lives (the|those) days (of a record )?again": "simulates the days again",
    r"read in one way": "interpreted in one stated way",
    r"is a fold\b": "accumulator",
    r"memory of (\$M\$|\d+ h)": "model horizon",
    r"(not told|told) of (a|the|each) meal": "announced, unannounced",
    r"the most the pump gives": "maximum rate of the pump",
}
"""Phrases that a reader of the field does not know, as patterns, and the field's word for each."""
EXCEPTIONS: dict[str, dict[str, str]] = {}
"""Phrases that a page keeps: page, pattern of `FIELD`, reason."""


def phrases(text):
    """Phrases of a text that have a word of the field."""
    return {pattern for pattern in FIELD if re.search(pattern, " ".join(text.split()), re.I)}


def test_a_phrase_is_found_across_lines():
    assert phrases("Insulin goes under\n  the skin.") == {r"(under|below) the skin"}


@pytest.mark.parametrize("page", [*PAGES, TEXTS], ids=lambda page: str(page.relative_to(ROOT)))
def test_a_page_uses_the_words_of_the_field(page):
    assert phrases(page.read_text(encoding="utf-8")) == set(EXCEPTIONS.get(str(page.relative_to(ROOT)), {}))


@pytest.mark.parametrize("command", names())
def test_help_uses_the_words_of_the_field(command):
    assert not phrases(command_of(command).help())
