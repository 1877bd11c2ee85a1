"""What is built for others: the wheel and the source distribution, their bytes, and what they hold."""

import os
import shutil
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from pathlib import Path
from types import SimpleNamespace

import pytest
import yaml

import glucoloop

ROOT = Path(__file__).resolve().parents[1]
NAMED = f"glucoloop-{glucoloop.__version__}"
WHEEL = f"{NAMED}-py3-none-any.whl"
SDIST = f"{NAMED}.tar.gz"
FOR_CHECKS = {"tsconfig.json"}
"""Names of files beside the pages that only a compiler of TypeScript reads, in tests."""


def copied(files, folder, umask):
    """The tree at another path, with the permissions that another person's umask gives, and what is no part of it."""
    for file in files:
        target = folder / file
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(ROOT / file, target)
        target.chmod((0o777 if os.access(ROOT / file, os.X_OK) else 0o666) & ~umask)
    for stray in ("src/glucoloop/__pycache__/left.cpython-311.pyc", "docs/_build/left.html", ".venv/left.py"):
        target = folder / stray
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_text("left by an earlier run")
    return folder


def build(folder, *kinds, dated):
    """Wheel, source distribution or both of a tree, without network."""
    command = [sys.executable, "-m", "hatchling", "build", "-d", folder / "dist"]
    command += [word for kind in kinds for word in ("-t", kind)]
    variables = {**os.environ, "SOURCE_DATE_EPOCH": dated}
    done = subprocess.run(command, cwd=folder, env=variables, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return folder / "dist"


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """Both distributions, of each of two copies of what git keeps, or would once it is added."""
    asked = ["git", "-C", ROOT, "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    if not (ROOT / ".git").exists() or shutil.which("git") is None:
        pytest.skip("needs a clone and git, which says what belongs to the project")
    listed = subprocess.run(asked, capture_output=True, text=True, check=True).stdout.split("\0")
    files = {file for file in listed if file and (ROOT / file).is_file()}
    made = [
        build(copied(files, tmp_path_factory.mktemp(name), umask), "wheel", "sdist", dated="1700000000")
        for name, umask in (("one", 0o022), ("other", 0o077))
    ]
    return SimpleNamespace(files=files, one=made[0], other=made[1])


@pytest.fixture(scope="module")
def unpacked(built, tmp_path_factory):
    """The source distribution, unpacked."""
    folder = tmp_path_factory.mktemp("unpacked")
    with tarfile.open(built.one / SDIST) as archive:
        filtered = {"filter": "data"} if hasattr(tarfile, "data_filter") else {}  # of Python 3.11.4 and newer
        archive.extractall(folder, **filtered)
    return folder / NAMED


@pytest.mark.long
@pytest.mark.parametrize("name", [WHEEL, SDIST])
def test_two_builds_have_the_same_bytes(built, name):
    assert (built.one / name).read_bytes() == (built.other / name).read_bytes()


@pytest.mark.long
def test_the_source_distribution_gives_the_same_wheel(built, unpacked):
    assert (build(unpacked, "wheel", dated="1700000000") / WHEEL).read_bytes() == (built.one / WHEEL).read_bytes()
    shutil.rmtree(unpacked / "dist")


def test_the_source_distribution_holds_what_git_keeps(built, unpacked):
    held = {path.relative_to(unpacked).as_posix() for path in unpacked.rglob("*") if path.is_file()}
    assert held == built.files | {"PKG-INFO"}


def test_the_wheel_holds_the_package_and_nothing_else(built):
    with zipfile.ZipFile(built.one / WHEEL) as wheel:
        held = {name for name in wheel.namelist() if not name.startswith(f"{NAMED}.dist-info/")}
    package = {file.removeprefix("src/") for file in built.files if file.startswith("src/")}
    assert held == {file for file in package if Path(file).name not in FOR_CHECKS}
    assert {"glucoloop/lab/page/lab.wasm", "glucoloop/reporting/templates/base.html", "glucoloop/py.typed"} < held


def test_the_package_of_the_wheel_answers(built, tmp_path):
    """Installed beside what this environment has, and imported from there."""
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-index", "--no-compile"]
    subprocess.run([*pip, "--target", tmp_path, built.one / WHEEL], check=True, timeout=120)
    variables = {**os.environ, "PYTHONPATH": str(tmp_path), "PYTHONDONTWRITEBYTECODE": "1"}
    asked = "import glucoloop, sys; print(glucoloop.__file__); from glucoloop.cli import program; sys.exit(program())"
    done = subprocess.run(
        [sys.executable, "-c", asked, "list", "mpc"], cwd=tmp_path, env=variables, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    where, _, said = done.stdout.partition("\n")
    assert Path(where).is_relative_to(tmp_path)
    assert "prediction_horizon" in said
    assert (tmp_path / "bin" / "glucoloop").exists()


@pytest.mark.long
def test_the_wheel_for_records_holds_the_same_package(built):
    made = build(built.one.parent / "packaging" / "records", "wheel", dated="1700000000")
    with zipfile.ZipFile(made / WHEEL.replace("glucoloop", "glucoloop_records")) as wheel:
        held = {name for name in wheel.namelist() if ".dist-info/" not in name}
    assert held == {file.removeprefix("src/") for file in built.files if file.startswith("src/")}


def conda_name(requirement):
    """A requirement of PyPI as conda-forge spells it."""
    name, least = requirement.split(">=")
    return f"{ {'lazy-loader': 'lazy_loader', 'matplotlib': 'matplotlib-base'}.get(name, name) } >={least}"


def test_the_recipe_of_conda_says_what_the_project_says():
    recipe = yaml.safe_load((ROOT / "recipe" / "recipe.yaml").read_text(encoding="utf-8"))
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    needs, context = recipe["requirements"], recipe["context"]
    assert context["version"] == glucoloop.__version__
    assert project["project"]["requires-python"] == f">={context['python_min']}"
    assert needs["run"][1:] == [conda_name(requirement) for requirement in project["project"]["dependencies"]]
    assert {conda_name(requirement) for requirement in project["build-system"]["requires"]} < set(needs["host"])
    assert recipe["about"]["summary"] == project["project"]["description"]
    assert recipe["build"]["python"]["entry_points"] == [
        f"{name} = {where}" for name, where in project["project"]["scripts"].items()
    ]


def test_the_container_is_built_of_what_a_wheel_needs(built, tmp_path):
    """The files that it copies are there, and give the same wheel."""
    lines = (ROOT / "Containerfile").read_text(encoding="utf-8").splitlines()
    copied = [
        word for line in lines if line.startswith("COPY ") and "--from" not in line for word in line.split()[1:-1]
    ]
    assert copied == ["pyproject.toml", "README.md", "LICENSE", "src", "requirements.lock"]
    for name in copied:
        source, target = ROOT / name, tmp_path / name
        shutil.copytree(source, target) if source.is_dir() else shutil.copyfile(source, target)
    made = build(tmp_path, "wheel", dated="1700000000") / WHEEL
    assert made.read_bytes() == (built.one / WHEEL).read_bytes()
