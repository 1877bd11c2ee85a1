"""What generated code calls: each against NumPy, on random bits."""

import ctypes
import shutil
import subprocess

import numpy as np
import pytest

from glucoloop.firmware.checks import _misra_of
from glucoloop.native.targets.c.host import _FLAGS, compiler
from glucoloop.native.targets.c.numbers import FORMATS, helpers
from glucoloop.native.targets.c.records import _identifier

WANTED = {
    "gl_sqrt": np.sqrt,
    "gl_floor": np.floor,
    "gl_abs": np.abs,
    "gl_sign": np.sign,
}


@pytest.mark.skipif(compiler() is None, reason="no C compiler: install gcc")
@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_functions_are_those_of_numpy(precision, tmp_path):
    form = FORMATS[precision]
    calls = [
        f"void all_{name}({form.type} *x, int n) {{ for (int i = 0; i < n; i++) {{ x[i] = {name}(x[i]); }} }}"
        for name in WANTED
    ]
    code = ["#include <float.h>", "#include <math.h>", "#include <stdbool.h>", "#include <stdint.h>"]
    code += ["#include <string.h>", *helpers(calls, form), *calls]
    (tmp_path / "all.c").write_text("\n".join(code))
    command = [compiler(), *_FLAGS, "-O1", "-shared", "-fPIC", "-o", "all.so", "all.c"]
    subprocess.run(command, cwd=tmp_path, check=True)
    library = ctypes.CDLL(str(tmp_path / "all.so"))
    rng = np.random.default_rng(3)
    bits = rng.integers(0, 2**64, 20_000, np.uint64).astype(form.bits.removesuffix("_t"))
    of_all = bits.view(precision)
    special = np.array([0.0, -0.0, np.inf, -np.inf, np.nan, 1e-310, 1e-42, 4.0, 2.0, -2.5, 0.5, 2.0**23 + 1], precision)
    numbers = np.concatenate([special, of_all, rng.normal(0.0, 100.0, 5000).astype(precision)])
    for name, function in WANTED.items():
        found = numbers.copy()
        getattr(library, f"all_{name}")(ctypes.c_void_p(found.ctypes.data), ctypes.c_int(found.size))
        with np.errstate(all="ignore"):
            wanted = function(numbers)
        np.testing.assert_array_equal(found, wanted, err_msg=name)


@pytest.mark.long
@pytest.mark.skipif(shutil.which("cppcheck") is None, reason="needs cppcheck (Debian: apt install cppcheck)")
@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_no_required_rule_of_misra_is_broken_by_functions(precision):
    calls = [f"{name}()" for name in WANTED]
    includes = [f"#include <{name}.h>" for name in ("float", "math", "stdbool", "stdint", "string")]
    check = _misra_of({"all.c": "\n".join([*includes, *helpers(calls, FORMATS[precision])])}, "all.c")
    assert check.holds, check.finding


@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_no_digit_of_a_constant_is_lost(precision):
    rng = np.random.default_rng(1)
    for number in (*rng.normal(size=50), 0.1, 1.0, -0.0, 1e-42, 3e38):
        text = FORMATS[precision].literal(number).strip("()").removesuffix("F")
        assert np.dtype(precision).type(float.fromhex(text)) == np.dtype(precision).type(number)
    assert FORMATS[precision].literal(np.nan) == "NAN"
    assert FORMATS[precision].literal(-np.inf) == "(-INFINITY)"


def test_names_are_names_of_c():
    assert _identifier("given", "on_board") == "given_on_board"
    assert _identifier(3, "x y") == "n3_x_y"
    assert _identifier("float") == "nfloat"
