"""Sums of float64 on a chip without a unit for it, which libgcc rounds wrongly where exponents are 33 apart."""

import ctypes
import subprocess

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from glucoloop.firmware.chips import CHIPS, LINK, template
from glucoloop.native.targets.c.host import compiler

CHIP = CHIPS["cortex-m4f"]
BITS = st.integers(0, 2**64 - 1)
FOUND = (0xBDE6CCD767315130, 0x3FF0000000000000)
"""A sum near 1 of a controller, of which libgcc of GCC 12 gives the neighbour."""
ON_THIS_COMPUTER = """
uint64_t __real___aeabi_dadd(uint64_t a, uint64_t b)
{
  union { uint64_t bits; double number; } x = {a}, y = {b}, sum;
  sum.number = x.number + y.number;
  return sum.bits;
}
"""
ON_THE_CHIP = """
#include "chip.h"
static volatile union {{ uint64_t bits; double number; }} a, b, found;
static const uint64_t cases[][4] = {{{cases}}};
int main(void)
{{
  for (uint32_t i = 0; i < sizeof(cases) / sizeof(cases[0]); i++)
  {{
    a.bits = cases[i][0];
    b.bits = cases[i][1];
    found.number = a.number + b.number;
    chip_say((found.bits == cases[i][2]) ? "right " : "wrong ");
    found.number = a.number - b.number;
    chip_say((found.bits == cases[i][3]) ? "right " : "wrong ");
  }}
  return 0;
}}
"""


def sum_and_difference(a, b):
    x, y = np.array([a, b], np.uint64).view(np.float64)
    with np.errstate(all="ignore"):
        return [int(bits) for bits in np.array([x + y, x - y]).view(np.uint64)]


def apart(exponent, by, fractions, signs):
    """Bits of two numbers whose exponents differ by so much; a smaller one than any is subnormal."""
    a, b = (max(of, 0) << 52 | fraction for of, fraction in zip((exponent, exponent - by), fractions, strict=True))
    return a | signs[0] << 63, b | signs[1] << 63


FRACTION = st.integers(0, 2**52 - 1) | st.sampled_from([0, 1, 2**19, 2**20 - 1, 2**51, 2**52 - 1])
NEAR = st.builds(
    apart, st.integers(1, 2046), st.integers(31, 35), st.tuples(FRACTION, FRACTION), st.tuples(*[st.integers(0, 1)] * 2)
)


@pytest.fixture(scope="module")
def here(tmp_path_factory):
    """The functions compiled for this computer, whose own addition takes the place of libgcc's."""
    if compiler() is None:
        pytest.skip("no C compiler: install gcc")
    folder = tmp_path_factory.mktemp("double")
    (folder / "double.c").write_text(template("double.c") + ON_THIS_COMPUTER)
    command = [
        compiler(),
        "-std=c99",
        "-Wall",
        "-Wextra",
        "-Wconversion",
        "-shared",
        "-fPIC",
        "-o",
        "double.so",
        "double.c",
    ]
    subprocess.run([*command, "-Werror"], cwd=folder, check=True)
    library = ctypes.CDLL(str(folder / "double.so"))
    functions = [getattr(library, f"__wrap___aeabi_{name}") for name in ("dadd", "dsub")]
    for function in functions:
        function.argtypes, function.restype = [ctypes.c_uint64] * 2, ctypes.c_uint64
    return functions


@given(NEAR | st.tuples(BITS, BITS))
@example(FOUND)
@example((0x3FF0000000000000, 0x3DEFFFFFFFFFFFFF))
@example((0x0210000000000000, 0x000FFFFFFFFFFFFF))
def test_every_sum_is_rounded_to_the_nearest_number(here, numbers):
    for pair in (numbers, numbers[::-1]):
        for function, expected in zip(here, sum_and_difference(*pair), strict=True):
            if (
                expected & 0x7FFFFFFFFFFFFFFF <= 0x7FF0000000000000
            ):  # processors differ in the bits of what is no number
                assert function(*pair) == expected


@pytest.mark.skipif(bool(CHIP.missing), reason=CHIP.missing)
def test_an_emulated_chip_rounds_as_this_computer(tmp_path):
    rng = np.random.default_rng(0)
    pairs = [FOUND, FOUND[::-1]]
    for _ in range(2000):
        fractions = (int(rng.integers(2**19)), int(rng.integers(2**52)))
        pairs.append(
            apart(
                int(rng.integers(40, 2046)),
                int(rng.integers(32, 36)),
                fractions,
                tuple(map(int, rng.integers(2, size=2))),
            )
        )
    cases = ", ".join(
        "{" + ", ".join(f"{bits}U" for bits in (*pair, *sum_and_difference(*pair))) + "}" for pair in pairs
    )
    support, told = CHIP.support("float64")
    for name in ("chip.c", "chip.h", *support):
        (tmp_path / name).write_text(template(name))
    (tmp_path / "chip.ld").write_text(template("chip.ld").replace("@FLASH@", CHIP.flash).replace("@RAM@", CHIP.ram))
    (tmp_path / "main.c").write_text(ON_THE_CHIP.format(cases=cases))
    command = [CHIP.compiler, "-std=c99", "-Os", *CHIP.flags, *LINK, *told, "-fno-tree-loop-distribute-patterns"]
    subprocess.run([*command, "-o", "sums.elf", "main.c", "chip.c", *support, "-lgcc"], cwd=tmp_path, check=True)
    run = [CHIP.emulator, *CHIP.machine, "-kernel", "sums.elf"]
    done = subprocess.run(run, cwd=tmp_path, check=True, capture_output=True, text=True)
    assert (done.stdout + done.stderr).split() == ["right"] * (2 * len(pairs))
