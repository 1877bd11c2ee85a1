"""A file is data: what it names as code is imported only where the user says so on the command line."""

import sys

import pytest

from glucoloop.component.code import entry_point

EVIL = """
from pathlib import Path
Path("harmed").touch()
from your_own_controller import YourOwnPI as x
"""
KINDS = {
    "run": "controller = 'evil:x'",
    "compare": "[[controller]]\nname = 'evil:x'\n[[controller]]\nname = 'basal'",
    "trial": "controller = ['evil:x']",
    "stress": "faults = ['evil:x, start_min=5']",
    "adversary": "controller = ['evil:x']",
    "robust": "beside = ['evil:x']",
    "detect": "controller = 'evil:x'",
    "tune": "controller = 'evil:x'",
    "bound": "patient = 'evil:x'",
    "identify": "patient = 'evil:x'",
    "export": "controller = 'evil:x'",
    "hil": "pump = 'evil:x, samples=3'",
    "run ": "metrics = ['evil:x']",
    "run  ": "sensor = 'evil:x, a=1'",
}


@pytest.fixture
def evil(install, tmp_path):
    """A folder with a module that does harm when it is imported."""
    install("your_own_controller", "controllers", "your-own-pi", "YourOwnPI")
    (tmp_path / "evil.py").write_text(EVIL)
    yield tmp_path / "harmed"
    entry_point.cache_clear()
    sys.modules.pop("evil", None)


@pytest.mark.parametrize("command", KINDS)
def test_what_a_file_names_is_not_imported(evil, refused, tmp_path, command):
    (tmp_path / "asked.toml").write_text(KINDS[command])
    told = refused(command.strip(), "--config", "asked.toml", "--out", "out")
    assert "'evil:x' names code that would be imported and run, and it stands in a file" in told
    assert "--allow-code" in told
    assert not evil.exists()


def test_what_the_folder_of_an_exported_controller_names_is_not_imported(evil, refused, tmp_path):
    (tmp_path / "pump").mkdir()
    (tmp_path / "pump" / "run.toml").write_text("controller = 'evil:x'")
    assert "'evil:x' names code" in refused("export", "--check", "pump")
    assert not evil.exists()


@pytest.mark.parametrize("given", [("--allow-code",), ("--controller", "evil:x, integral_min=-1")])
def test_it_is_imported_where_the_user_says_so(evil, refused, tmp_path, given):
    (tmp_path / "asked.toml").write_text("controller = 'evil:x, integral_min=-1'")
    assert "integral_min is -1 min; give a finite number above 0 min" in refused(
        "run", "--config", "asked.toml", *given
    )
    assert evil.exists()


def test_an_entry_point_is_known_in_a_file_too(evil, refused, tmp_path):
    (tmp_path / "asked.toml").write_text("controller = 'your-own-pi, integral_min=-1'")
    assert "integral_min is -1 min; give a finite number above 0 min" in refused("run", "--config", "asked.toml")


def test_a_module_of_the_current_folder_takes_the_place_of_no_installed_one(refused, tmp_path):
    (tmp_path / "colorsys.py").write_text("raise RuntimeError('it was imported')")
    assert "colorsys has no x" in refused("run", "--controller", "colorsys:x")


@pytest.mark.long
def test_a_folder_that_was_begun_with_typed_code_needs_the_name_again(evil, glucoloop, refused):
    short = ("--duration", "60", "--meal", "20g@20min")
    assert glucoloop("run", "--controller", "evil:x", *short, "--out", "a").code == 0
    assert "'evil:x' names code" in refused("run", "--config", "a/run.toml")
    assert glucoloop("run", "--config", "a/run.toml", "--allow-code", "--out", "b").code == 0
    with open("a/run.toml") as file:
        assert file.readline() == "# Repeat with: glucoloop run --config run.toml --allow-code\n"
    people = ("trial", "--people", "3", "--days", "1", "--meal", "20g@20min")
    assert glucoloop(*people, "--controller", "evil:x", "--out", "t").code == 0
    assert "'evil:x' names code" in refused("trial", "--config", "t/trial.toml", "--out", "t")
    assert "was finished before" in glucoloop(*people, "--controller", "evil:x", "--out", "t").err
    assert "was finished before" in glucoloop("trial", "--config", "t/trial.toml", "--allow-code", "--out", "t").err
