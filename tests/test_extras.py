"""What glucoloop does without the packages that only an extra installs."""

import ast
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import glucoloop
from glucoloop.refusal import EXTRAS, MissingExtraError, needed_for

SOURCE = Path(glucoloop.__file__).parent
PROJECT = tomllib.loads((SOURCE.parents[1] / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def test_each_package_is_of_its_extra_and_not_always_installed():
    extras = PROJECT["optional-dependencies"]
    for package, extra in EXTRAS.items():
        assert any(
            requirement.startswith((f"{package.replace('_', '-')}>=", f"{package}==")) for requirement in extras[extra]
        )
        assert not any(requirement.startswith(package) for requirement in PROJECT["dependencies"])


def test_every_extra_is_asked_for_by_name():
    of_the_package = set(PROJECT["optional-dependencies"]) - {"bench"}  # programs beside the package ask for that one
    assert set(EXTRAS.values()) == of_the_package


@pytest.mark.parametrize("package", EXTRAS)
def test_a_missing_package_is_told_with_its_extra(monkeypatch, package):
    monkeypatch.setitem(sys.modules, package, None)
    told = rf"^drawing needs {package}; install it with: pip install 'glucoloop\[{EXTRAS[package]}\]'$"
    with pytest.raises(MissingExtraError, match=told), needed_for("drawing"):
        __import__(f"{package}.part")


def test_another_missing_module_stays_what_it_is():
    with pytest.raises(ModuleNotFoundError, match="no_such_module"), needed_for("drawing"):
        import no_such_module  # noqa: F401


def test_sql_says_what_it_lacks(monkeypatch):
    monkeypatch.setitem(sys.modules, "duckdb", None)
    monkeypatch.delitem(sys.modules, "glucoloop.trials.query", raising=False)
    with pytest.raises(MissingExtraError, match="SQL needs duckdb"):
        __import__("glucoloop.trials.query")


LISTINGS = """
import importlib, inspect, pkgutil, pydoc, sys

class Missing:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] == sys.argv[1]:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

sys.meta_path.insert(0, Missing())
sys.modules[sys.argv[1]] = None
import glucoloop
from glucoloop.refusal import MissingExtraError

inspect.getmembers(glucoloop), pydoc.render_doc(glucoloop), exec("from glucoloop import *")
for found in pkgutil.walk_packages(glucoloop.__path__, "glucoloop.", onerror=lambda name: None):
    if not found.ispkg:
        continue
    try:
        module = importlib.import_module(found.name)
    except MissingExtraError:  # the module is of the extra, and no listing of another has it
        continue
    inspect.getmembers(module), pydoc.render_doc(module), exec(f"from {found.name} import *")
"""


@pytest.mark.long
@pytest.mark.parametrize("package", EXTRAS)
def test_listings_do_without_what_is_not_installed(package):
    subprocess.run([sys.executable, "-W", "error", "-c", LISTINGS, package], check=True)


def test_what_is_not_installed_is_named_by_whoever_asks_for_it():
    code = (
        "import sys; sys.modules['gymnasium'] = None; import glucoloop as gl; "
        "assert 'gym' not in {*dir(gl), *gl.__all__}"
        "\ntry: gl.gym\nexcept gl.Refusal as error: print(error)"
    )
    told = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout
    assert told.strip().endswith("pip install 'glucoloop[gym]'")


def guarded(tree):
    """Import statements within `needed_for`, or for type checkers alone."""
    for node in ast.walk(tree):
        block = isinstance(node, ast.With) and "needed_for" in ast.unparse(node.items[0])
        if block or (isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test)):
            yield from ast.walk(node)


def packages(node):
    names = [node.module or ""] if isinstance(node, ast.ImportFrom) else [name.name for name in node.names]
    return {name.partition(".")[0] for name in names}


def test_no_module_imports_an_extra_unguarded():
    unguarded = set()
    for path in SOURCE.rglob("*.py"):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        inside = set(map(id, guarded(tree)))
        for node in ast.walk(tree):
            if (
                isinstance(node, ast.Import | ast.ImportFrom)
                and id(node) not in inside
                and packages(node) & set(EXTRAS)
            ):
                unguarded.add(str(path.relative_to(SOURCE)))
    assert not unguarded


RECORDS = tomllib.loads((SOURCE.parents[1] / "packaging/records/pyproject.toml").read_text(encoding="utf-8"))["project"]
LEFT_OUT = {"diffrax", "jax", "llvmlite", "scipy"}
WITHOUT = f"""
import sys

class Missing:
    def find_spec(self, name, path=None, target=None):
        if name in {sorted(LEFT_OUT)!r}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)

sys.meta_path.insert(0, Missing())
from glucoloop.cli import program
program()
"""
DEXCOM = "Index,Timestamp (YYYY-MM-DDThh:mm:ss),Event Type,Glucose Value (mg/dL)\n" + "".join(
    f"{n},2026-01-{1 + n // 288:02}T{n // 12 % 24:02}:{5 * (n % 12):02}:00,EGV,{100 + n % 90}\n" for n in range(600)
)


def test_the_package_for_records_leaves_out_what_computes_and_nothing_else():
    left_out = {one for one in PROJECT["dependencies"] if one.partition(">=")[0] in LEFT_OUT}
    assert len(left_out) == len(LEFT_OUT)
    assert RECORDS["dependencies"] == [one for one in PROJECT["dependencies"] if one not in left_out]
    extras = PROJECT["optional-dependencies"]
    assert all(extras[name] == needs for name, needs in RECORDS["optional-dependencies"].items())
    assert all(RECORDS[key] == PROJECT[key] for key in ("scripts", "requires-python", "license"))


@pytest.mark.long
def test_records_are_read_and_reported_without_what_computes(tmp_path):
    def said(*words, code=0):
        done = subprocess.run(
            [sys.executable, "-c", WITHOUT, *words], cwd=tmp_path, capture_output=True, text=True, check=False
        )
        assert done.returncode == code, done.stderr
        return done.stdout + done.stderr

    (tmp_path / "clarity.csv").write_text(DEXCOM)
    assert "600" in said("records", "clarity.csv", "--glucose-unit", "mg/dl", "--out", "record.parquet")
    assert "report.html" in said("report", "record.parquet", "--out", "report")
    assert {"report.html", "figure.png", "metrics.csv"} < {file.name for file in (tmp_path / "report").iterdir()}
    assert "prediction_horizon" in said("list", "mpc")
    assert "@software" in said("cite")
    assert "SQL" in said("query", "--help")
    told = "glucoloop: this computes with jax, which is not installed; install it with: pip install glucoloop.\n"
    assert said("run", "--json", code=2) == told
