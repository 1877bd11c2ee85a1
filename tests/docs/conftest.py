"""The documentation's own modules, which are no package."""

import importlib
import sys
from pathlib import Path
from types import ModuleType

import pytest

DOCS = Path(__file__).resolve().parents[2] / "docs"


@pytest.fixture
def docs_module(monkeypatch: pytest.MonkeyPatch):
    """A function that imports a module of docs/ by name."""
    monkeypatch.syspath_prepend(str(DOCS))

    def load(name: str) -> ModuleType:
        try:
            return importlib.import_module(name)
        finally:
            sys.modules.pop(name, None)

    return load
