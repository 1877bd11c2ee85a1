"""Classes and modules that the documentation names exist."""

import importlib
import importlib.util
import re
from pathlib import Path

import pytest

import glucoloop
from glucoloop.refusal import MissingExtraError

DOCS = Path(__file__).parents[2] / "docs"
SOURCE = Path(glucoloop.__file__).parent
OTHERS = {
    "ValueError",
    "TypeError",
    "OverflowError",
    "DeprecationWarning",
    "NaN",
    "T1DSimGymnaisumEnv",
    "PtID",
}
"""Names that are none of our classes: of Python, of other libraries, and that of an example to be written."""
GROUPS = {
    "actions",
    "glucagon_controllers",
    "profile_errors",
    *("controllers", "estimators", "habits", "meal_models", "patients", "pumps", "readers", "rescues", "rhythms"),
    *("forecast_methods", "samplers", "scenarios", "sensors"),
}
"""Groups of entry points of plug-ins."""
PAGES = sorted(path for path in DOCS.rglob("*.md") if "_generated" not in path.parts and path.name != "changelog.md")
_FENCED = re.compile(r"^(`{3,}|~{3,}).*?^\1", re.M | re.S)
_CAMEL = re.compile(r"`([A-Z][a-z0-9]+(?:[A-Z][a-z0-9]*)+)`")
_DOTTED = re.compile(r"`((?:[a-z_]\w*\.)+[A-Za-z_]\w*)(?:\(\))?`")


def classes():
    names = r"^\s*(?:class (\w+)|([A-Z][a-z0-9]\w*)(?::[^=\n]*)? = )"
    found = re.findall(names, "\n".join(path.read_text() for path in SOURCE.rglob("*.py")), re.M)
    return {name for both in found for name in both if name}


def resolves(dotted):
    """Whether a name below glucoloop is a module, or an attribute of one."""
    parts = dotted.split(".")
    for known in range(len(parts), 0, -1):
        try:
            value = importlib.import_module(".".join(parts[:known]))
        except ModuleNotFoundError:
            continue
        for name in parts[known:]:
            try:
                if not hasattr(value, name) and name not in getattr(value, "__annotations__", {}):
                    return False
            except MissingExtraError:  # it is there, and its library is not
                return True
            value = getattr(value, name, None)
        return True
    return False


def ours(dotted):
    """Full name of what could be ours; None for a file, or for a name of another library."""
    first = dotted.split(".")[0]
    if first == "glucoloop":
        return None if dotted.removeprefix("glucoloop.") in GROUPS else dotted
    last = dotted.rsplit(".", 1)[-1]
    if last in {
        "py",
        "md",
        "toml",
        "json",
        "csv",
        "html",
        "parquet",
        "c",
        "h",
        "mjs",
        "txt",
        "lock",
        "in",
        "yml",
        "pyi",
        "wasm",
    }:
        return None
    return f"glucoloop.{dotted}" if (SOURCE / first).is_dir() or (SOURCE / f"{first}.py").exists() else None


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(DOCS)))
def test_classes_and_modules_of_a_page_exist(page, known):
    text = _FENCED.sub("", page.read_text(encoding="utf-8"))
    unknown = {name for name in _CAMEL.findall(text) if name not in known | OTHERS}
    dotted = {name: ours(name) for name in _DOTTED.findall(text)}
    unknown |= {name for name, full in dotted.items() if full is not None and not resolves(full)}
    assert not unknown


@pytest.fixture(scope="module")
def known():
    return classes()
