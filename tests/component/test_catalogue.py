"""Catalogues: each entry names the class that has its name, and nothing is imported before it is used."""

import subprocess
import sys

import pytest

from glucoloop.component.catalogue import Catalogue, catalogues

_PROGRAM = (
    "import sys\n"
    "from glucoloop.cli.app import main\n"
    "try:\n    main(sys.argv[1:])\n"
    "except SystemExit:\n    pass\n"
    "print(*sys.modules, file=sys.stderr)\n"
)


def modules_after(*arguments: str) -> set[str]:
    """Modules that a command imports."""
    done = subprocess.run([sys.executable, "-c", _PROGRAM, *arguments], capture_output=True, text=True, check=True)
    return set(done.stderr.splitlines()[-1].split())


@pytest.mark.parametrize("kind", catalogues())
def test_an_entry_is_the_name_of_its_class(kind):
    catalogue: Catalogue = catalogues()[kind]
    for name, component in catalogue.items():
        assert (component.name, component.kind) == (name, kind)
        assert catalogue.find(name) is component


@pytest.mark.parametrize("command", ["run", "compare", "trial"])
def test_help_imports_no_component(command):
    unused = {
        *("control.mpc_se", "control.meal_mpc", "control.linear_mpc", "control.oref0.controller", "faults.sensor"),
        *("faults.pump", "sensors.cgm.model", "pumps.pen", "metrics.glycemia", "situations.scenario_days"),
    }
    assert not {f"glucoloop.{name}" for name in unused} & modules_after(command, "--help")


@pytest.mark.parametrize(
    "arguments", [("run", "--help"), ("list", "mpc-se"), ("run", "--nonsense"), ("run", "--noise", "-1")], ids=" ".join
)
def test_help_descriptions_and_refusals_import_no_numerical_library(arguments):
    assert not {"jax", "numpy", "scipy", "polars", "matplotlib"} & modules_after(*arguments)


def test_help_imports_no_library_of_python_that_only_results_and_errors_need():
    assert not {"concurrent.futures", "hashlib"} & modules_after("run", "--help")


def test_the_list_of_everything_imports_no_more_than_the_readers_of_records():
    assert not {"jax", "scipy", "matplotlib"} & modules_after("list")


def test_a_run_without_files_draws_nothing():
    assert not {"matplotlib", "jinja2"} & modules_after("run", "--json")
