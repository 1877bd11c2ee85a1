"""What `import glucoloop` shows."""

import subprocess
import sys

import pytest

import glucoloop


def test_the_names_are_the_interface_and_nothing_else():
    shown = {name for name in dir(glucoloop) if not name.startswith("__")}
    assert shown == set(glucoloop.__all__)
    assert set(glucoloop._HOME) == set(glucoloop.__all__)
    for name in shown:
        assert getattr(glucoloop, name).__doc__, name


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
    assert told.split() == ["glucoloop.arithmetic"]
