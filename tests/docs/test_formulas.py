"""Formulas become MathML, and pages load nothing from a network."""

import re
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest
from docutils.utils.math import MathError

DOCS = Path(__file__).resolve().parents[2] / "docs"
MATHML = "{http://www.w3.org/1998/Math/MathML}"


def formulas() -> list[tuple[str, bool]]:
    found = []
    for page in sorted([*DOCS.glob("*.md"), *DOCS.glob("guide/*.md")]):
        text = re.sub(r"```.*?```|`[^`\n]*`", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
        for block, inline in re.findall(r"\$\$(.*?)\$\$|(?<!\\)\$([^$\n]+?)\$", text, re.DOTALL):
            found.append((block or inline, bool(block)))
    return found


def tags(latex: str, docs_module) -> list[str]:
    root = ElementTree.fromstring(docs_module("mathml").mathml(latex, as_block=False))
    return [element.tag.removeprefix(MATHML) for element in root.iter()]


def test_every_formula_of_the_pages_is_read(docs_module):
    mathml = docs_module("mathml").mathml
    found = formulas()
    assert len(found) > 100
    for latex, block in found:
        root = ElementTree.fromstring(mathml(latex, as_block=block))
        assert root.tag == f"{MATHML}math"
        assert len(root)


def test_an_index_stands_beside_an_accented_letter(docs_module):
    assert "munderover" not in tags(r"\hat h_i + \bar{G}^2", docs_module)
    assert tags(r"\hat h_i", docs_module).count("msub") == 1


def test_an_exponent_belongs_to_the_whole_norm(docs_module):
    inside = tags(r"\lVert x + y \rVert^2", docs_module)
    assert inside[:3] == ["math", "msup", "mrow"]


def test_a_prime_is_an_exponent(docs_module):
    assert "msubsup" in tags("G_{BV}'", docs_module)


def test_what_docutils_does_not_know_is_refused(docs_module):
    with pytest.raises(MathError, match="nosuchcommand"):
        docs_module("mathml").mathml(r"\nosuchcommand x", as_block=False)


@pytest.mark.parametrize(
    "text",
    [
        '<script async="async" src="https://cdn.example.org/mathjax.js"></script>',
        "<img alt='a' src=//example.org/a.png>",
        '<link href="https://fonts.example.org/a.css" rel="stylesheet">',
        "@font-face { src: url(https://example.org/a.woff2) }",
        '@import "http://example.org/a.css";',
    ],
)
def test_what_a_browser_would_load_is_found(text, docs_module):
    assert len(docs_module("offline").loaded(text)) == 1


@pytest.mark.parametrize(
    "text",
    [
        '<a href="https://example.org/">a link</a>',
        '<script src="_static/a.js"></script>',
        '<link rel="canonical" href="https://example.org/a.html">',
        "url(stix-two-math.woff2)",
        "<p>Read https://example.org/</p>",
    ],
)
def test_a_link_is_not_loaded(text, docs_module):
    assert docs_module("offline").loaded(text) == []


def test_an_included_file_is_no_page(docs_module):
    included = docs_module("generate").included(DOCS)
    assert "guide/parker1999.md" in included
    assert "_generated/interpretations.md" in included
    assert "guide/reproducing.md" not in included
