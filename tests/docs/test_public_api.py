"""The page of public names is that of the program, and examples keep to it."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
A_STUDY = "policy_search.py"  # it closes loops by the engine of trials
SHOWN = [ROOT / "docs/guide/add-your-own.md", *sorted((ROOT / "examples").glob("*.py"))]
SHOWN = [file for file in SHOWN if file.name != A_STUDY]


def test_the_page_lists_every_public_name_with_its_arguments(docs_module):
    api = docs_module("public_api")
    assert api.PAGE.read_text(encoding="utf-8") == api.page(), "changed on purpose? python docs/public_api.py"


@pytest.mark.parametrize("file", SHOWN, ids=lambda file: file.name)
def test_examples_import_public_names_only(file):
    text = file.read_text(encoding="utf-8")
    if file.suffix == ".md":
        assert "from glucoloop." not in text.replace("from glucoloop.plugin", "")
        return
    for statement in ast.walk(ast.parse(text)):
        names = [statement.module] if isinstance(statement, ast.ImportFrom) else []
        names += [name.name for name in statement.names] if isinstance(statement, ast.Import) else []
        inside = {name for name in names if name and name.partition(".")[0] == "glucoloop"}
        assert inside <= {"glucoloop", "glucoloop.plugin", "glucoloop.gym"}
