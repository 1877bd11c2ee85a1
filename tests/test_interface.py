"""What `import glucoloop` and its packages show."""

import importlib
import pkgutil
import subprocess
import sys
from pathlib import Path

import pytest

import glucoloop

PACKAGE = Path(glucoloop.__file__).parent
LAZY = [
    ".".join(["glucoloop", *stub.parent.relative_to(PACKAGE).parts]) for stub in sorted(PACKAGE.rglob("__init__.pyi"))
]
LAYERS = sorted(info.name for info in pkgutil.iter_modules([str(PACKAGE)]) if not info.name.startswith("_"))


@pytest.mark.parametrize("package", LAZY)
def test_every_name_of_a_package_is_there_and_is_no_module_that_hides_it(package):
    shown = importlib.import_module(package)
    for info in pkgutil.walk_packages(shown.__path__, f"{package}.") if package != "glucoloop" else ():
        importlib.import_module(info.name)
    stub = (Path(shown.__file__).with_suffix(".pyi")).read_text(encoding="utf-8")
    modules = {line.split()[3] for line in stub.splitlines() if line.startswith("from . import")}
    assert dir(shown) == sorted(shown.__all__)
    for name in shown.__all__:
        thing = getattr(shown, name)
        assert (type(thing) is type(sys) or hasattr(thing, "__path__")) == (name in modules), name
        assert thing.__doc__, name


def test_the_interface_shows_the_modules_that_users_need_and_none_of_the_inside():
    shown = {name for name in dir(glucoloop) if name in LAYERS}
    assert shown - {"gym"} == {
        *("control", "faults", "identification", "meals", "metrics", "models", "patients", "physiology", "plugin"),
        *("pumps", "records", "sensors", "simulation", "snapshot", "units"),
    }
    assert not any(name.startswith("_") for name in dir(glucoloop))


@pytest.mark.parametrize("name", ["pumps", "units"])
def test_a_layer_is_there_where_nothing_imported_it_before(name):
    code = f"import glucoloop as gl; assert gl.{name}.__name__ == 'glucoloop.{name}'"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_importing_glucoloop_imports_no_layer():
    code = (
        "import sys, glucoloop; print(*sorted(m for m in sys.modules if m.startswith('glucoloop.'))); "
        "assert not hasattr(glucoloop, 'pump') and not hasattr(glucoloop, '_pumps')"
    )
    told = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout
    assert told.split() == ["glucoloop._lazy_jax", "glucoloop.arithmetic"]


def test_packages_with_settings_import_no_numerical_library():
    code = (
        f"import sys, importlib; [importlib.import_module(name) for name in {LAZY}]; "
        "from glucoloop.component.catalogue import catalogues; catalogues(); "
        "assert not {'jax', 'numpy', 'scipy'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
