"""The scripts that make figures and tables of the documentation fit the program; they take too long to be run."""

import runpy
from pathlib import Path

import pytest

DOCS = Path(__file__).parents[2] / "docs"
BENCHMARKS = DOCS.parent / "benchmarks"
RUNS_AT_ONCE = "conf.py"
SCRIPTS = sorted(path for path in [*DOCS.glob("*.py"), *BENCHMARKS.glob("*.py")] if path.name != RUNS_AT_ONCE)


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.name)
def test_what_a_script_imports_is_there(script, monkeypatch):
    monkeypatch.syspath_prepend(script.parent)
    assert runpy.run_path(str(script))["__doc__"]
