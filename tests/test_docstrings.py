"""Docstrings of the package say what they describe: a sentence or a noun phrase, not a fragment."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

import glucoloop

PACKAGE = Path(glucoloop.__file__).parent

# Words with which no docstring begins: the noun that they refer to stands somewhere else, or nowhere.
OPENERS = frozenset(
    re.findall(
        r"\w+",
        "about above according across after against along also amid among and around as at because before behind below "
        "beside between beyond but by during else except for from he her here him his how if in inside into it its "
        "itself like likewise near neither no nobody none nor not nothing of off on once only or out outside over per "
        "same see she since so such than that their them then there these they this those through to toward under "
        "until up upon what whatever when where wherever which whichever while who whoever whom whose why with within "
        "without",
    )
)
PERSONAL = re.compile(r"\b(he|his|him|himself)\b", re.IGNORECASE)
SHAPE = re.compile(r"^(``)?\([^()]*\)(``)?[,:]?\s+")
SECTION = re.compile(r"^(Parameters|Returns|Yields|Attributes)\n-+\n", re.MULTILINE)
MIN_WORDS = 3


def fault_of_lead(text: str) -> str | None:
    """Fault of the first paragraph of a docstring, with the mend; None for a good one."""
    lead = text.strip().split("\n\n")[0]
    phrase = SHAPE.sub("", lead)
    words = phrase.split()
    if phrase == lead and re.fullmatch(r"(``)?\([^()]*\)(``)?\.?", lead):
        return "it gives a shape alone; add what the array holds: '(n,) basal rates.'"
    if first_word(phrase) in OPENERS:
        return (
            f"it begins with '{words[0]}'; begin with the noun or the verb, as in 'Sample time of the loop.' for "
            "'Of the loop.', 'Number of shards.' for 'How many shards.'"
        )
    if len(words) < MIN_WORDS - (phrase != lead):
        return f"it has fewer than {MIN_WORDS} words; say of what: 'Peak glucose of the run.' for 'The peak.'"
    return fault_of_person(text)


def fault_of_entry(text: str) -> str | None:
    """Fault of the description of a parameter or a result, with the mend; None for a good one."""
    if first_word(SHAPE.sub("", text)) in OPENERS - {"as", "see"}:
        return f"the entry '{text}' is a fragment; begin with the noun: 'Variance of a reading' for 'Of a reading'"
    return None


def fault_of_person(text: str) -> str | None:
    """Fault of a docstring that calls a person 'him', with the mend; None for a good one."""
    found = PERSONAL.search(text)
    return f"it says '{found[0]}'; say 'the person' or 'the patient'" if found else None


def first_word(phrase: str) -> str:
    """First word in lower case, without marks around it; code in backticks is no word."""
    words = phrase.split()
    return words[0].strip(".,;:()").lower() if words else ""


def docstrings(tree: ast.AST) -> Iterator[tuple[int, str]]:
    """Line and text of each docstring of a module, its classes, functions and fields."""
    for node in ast.walk(tree):
        body = getattr(node, "body", None)
        for statement in body if isinstance(body, list) else []:
            match statement:
                case ast.Expr(value=ast.Constant(value=str(text))) if text.strip():
                    yield statement.lineno, text


def entries(text: str) -> Iterator[str]:
    """First line of the description of each parameter, result and attribute in a docstring."""
    text = "\n".join(line.strip() and line for line in _dedented(text).splitlines())
    for section in SECTION.finditer(text):
        body = re.split(r"\n\S.*\n-+\n", text[section.end() :])[0]
        for entry in re.finditer(r"^\S.*\n((?: {4}.*\n?)+)", body, re.MULTILINE):
            yield entry[1].strip().splitlines()[0]


def _dedented(text: str) -> str:
    first, _, rest = text.partition("\n")
    margin = min((len(line) - len(line.lstrip()) for line in rest.splitlines() if line.strip()), default=0)
    return "\n".join([first, *(line[margin:] for line in rest.splitlines())])


def faults_of(source: str) -> list[str]:
    found = []
    for line, text in docstrings(ast.parse(source)):
        faults = [fault_of_lead(text), *map(fault_of_entry, entries(text))]
        found += [f"{line}: {fault}" for fault in faults if fault]
    return found


def test_no_docstring_is_a_fragment() -> None:
    found = [
        f"{path.relative_to(PACKAGE.parent)}:{fault}"
        for path in sorted(PACKAGE.rglob("*.py"))
        for fault in faults_of(path.read_text(encoding="utf-8"))
    ]
    assert not found, "\n".join(["docstrings that a reader cannot understand by themselves:", *found])


@pytest.mark.parametrize(
    "text",
    [
        "Of the population; None: the nominal patient.",
        "By how much the rate exceeds the limit.",
        "How many people there are.",
        "(n,)",
        "(samples, bins) of those with a basal rate.",
        "See `Pump`.",
        "Version.",
        "Rate at which he rests before the run.",
    ],
)
def test_a_fragment_is_refused(text: str) -> None:
    assert faults_of(f'"""{text}"""')


@pytest.mark.parametrize(
    "text",
    [
        "Person of the population, or None for the nominal patient.",
        "Distance by which the rate exceeds the limit.",
        "(n,) numbers of the people.",
        "``(n,)``, basal rate of each person.",
        "Whether glucose is settled.",
        "Carry a state over one sample.",
    ],
)
def test_a_phrase_or_a_sentence_passes(text: str) -> None:
    assert not faults_of(f'"""{text}"""')


def test_descriptions_of_parameters_are_looked_at() -> None:
    source = '''
def f(rate, seed):
    """Infusion that holds a glucose.

    Parameters
    ----------
    rate : float
        Of the pump.
    seed : int

    Returns
    -------
    float
        How much is given.

    Raises
    ------
    ValueError
        For a rate below 0.
    """
'''
    assert [fault.split("'")[1] for fault in faults_of(source)] == ["Of the pump.", "How much is given."]


def test_no_docstring_begins_with_the_name_of_a_class_in_place_of_words():
    trees = {
        path: ast.parse(path.read_text(encoding="utf-8")) for path in Path(glucoloop.__file__).parent.rglob("*.py")
    }
    nodes = [(path, node) for path, tree in trees.items() for node in ast.walk(tree)]
    names = {node.name for _, node in nodes if isinstance(node, ast.ClassDef) and re.search("[a-z][A-Z]", node.name)}
    texts = [
        (f"{path}:{node.lineno}", node.value.value)
        for path, node in nodes
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)
    ]
    found = [place for place, text in texts if (start := re.match(r"(\w+) [a-z]", text)) and start[1] in names]
    assert not found
