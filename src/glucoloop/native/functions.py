"""Elementary functions as operations of a scalar program, so that a result is the same on every processor.

`exp` and `expm1` take multiples of ln 2 off their argument and a polynomial of what is left, which is at most .3466;
`tanh` is made of `expm1`, so that it is exact to rounding near zero too; `log` takes the exponent off and sums the
series of the inverse hyperbolic tangent. Against NumPy they differ by a few units in the last place.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from glucoloop.native.program import Program, Value

DOUBLE: Final = "float64"
SINGLE: Final = "float32"

_LN2: Final = math.log(2.0)
_PRODUCTS: Final = (1.0, 2.0, 3.0, 4.0)
"""Exponents for which a power is a product."""


def _beyond_linear(degree: int) -> list[float]:
    """Coefficients of ``(e^r - 1 - r) / r^2`` for ``|r| <= ln 2 / 2``, the highest power first."""

    def wanted(r: np.ndarray) -> np.ndarray:
        return sum((r**k / math.factorial(k + 2) for k in range(20)), start=np.zeros_like(r))

    half = 0.5 * _LN2 * (1.0 + 1e-6)
    found = np.polynomial.Chebyshev.interpolate(wanted, degree, [-half, half])
    return [float(c) for c in found.convert(kind=np.polynomial.Polynomial).coef[::-1]]


@dataclass(frozen=True)
class _Precision:
    """Constants of the functions in one precision."""

    ln2_high: float
    """Leading part of ln 2 with few bits, so that its multiples are exact."""
    ln2_low: float
    round_to_whole: float
    """Number which, added to another, leaves the nearest whole number in the last bits."""
    beyond_linear: Sequence[float]
    log_terms: int
    largest: float
    """Largest argument of exp."""
    saturated: float
    """Argument from which tanh is one to rounding."""


_OF: Final = {
    DOUBLE: _Precision(
        ln2_high=float.fromhex("0x1.62e42fee00000p-1"),
        ln2_low=float.fromhex("0x1.a39ef35793c76p-33"),
        round_to_whole=1.5 * 2.0**52,
        beyond_linear=_beyond_linear(10),
        log_terms=11,
        largest=708.0,
        saturated=20.0,
    ),
    SINGLE: _Precision(
        ln2_high=0.693359375,
        ln2_low=-2.12194440e-4,
        round_to_whole=1.5 * 2.0**23,
        beyond_linear=_beyond_linear(4),
        log_terms=5,
        largest=87.0,
        saturated=10.0,
    ),
}


class Functions:
    """Elementary functions in one precision."""

    def __init__(self, program: Program, precision: str) -> None:
        self._p = program
        self._of = _OF[precision]

    def _of_constant(self, function: Callable[[float], float], x: Value) -> Value:
        with np.errstate(all="ignore"):
            return self._p.constant(float(function(float(self._p.constants[x]))))

    def _polynomial(self, x: Value, coefficients: Sequence[float]) -> Value:
        """Horner's rule, the highest power first."""
        p = self._p
        total = p.constant(coefficients[0])
        for coefficient in coefficients[1:]:
            total = p.apply("add", p.apply("mul", total, x), p.constant(coefficient))
        return total

    def _limited(self, x: Value, largest: float) -> Value:
        p = self._p
        return p.apply("max", p.apply("min", x, p.constant(largest)), p.constant(-largest))

    def _reduced(self, x: Value) -> tuple[Value, Value]:
        """2^n and expm1(r) with ``x = n ln 2 + r``."""
        p, of = self._p, self._of
        magic = p.constant(of.round_to_whole)
        shifted = p.apply("add", p.apply("mul", x, p.constant(1.0 / _LN2)), magic)
        n = p.apply("exact_sub", shifted, magic)
        r = p.apply("sub", x, p.apply("mul", n, p.constant(of.ln2_high)))
        r = p.apply("sub", r, p.apply("mul", n, p.constant(of.ln2_low)))
        beyond = self._polynomial(r, of.beyond_linear)
        small = p.apply("add", p.apply("mul", p.apply("mul", r, r), beyond), r)
        return p.apply("power_of_two", shifted), small

    def exp(self, x: Value) -> Value:
        """e^x; beyond the range of numbers the largest or smallest of them."""
        p = self._p
        if x in p.constants:
            return self._of_constant(np.exp, x)
        scale, small = self._reduced(self._limited(x, self._of.largest))
        return p.apply("add", p.apply("mul", scale, small), scale)

    def expm1(self, x: Value) -> Value:
        """``e^x - 1``, exact to rounding near zero too."""
        p = self._p
        if x in p.constants:
            return self._of_constant(np.expm1, x)
        scale, small = self._reduced(self._limited(x, self._of.largest))
        return p.apply("add", p.apply("mul", scale, small), p.apply("sub", scale, p.constant(1.0)))

    def tanh(self, x: Value) -> Value:
        """``expm1(2 x) / (expm1(2 x) + 2)``."""
        p = self._p
        if x in p.constants:
            return self._of_constant(np.tanh, x)
        limited = self._limited(x, self._of.saturated)
        scale, small = self._reduced(p.apply("add", limited, limited))
        grown = p.apply("add", p.apply("mul", scale, small), p.apply("sub", scale, p.constant(1.0)))
        return p.apply("ratio", grown, p.apply("add", grown, p.constant(2.0)))

    def log(self, x: Value) -> Value:
        """Natural logarithm of a number of full precision; NaN below zero, minus infinity at zero."""
        p = self._p
        if x in p.constants:
            return self._of_constant(np.log, x)
        mantissa, exponent = p.apply("mantissa", x), p.apply("exponent", x)
        high = p.apply("lt", p.constant(math.sqrt(2.0)), mantissa)
        m = p.apply("select", high, p.apply("mul", mantissa, p.constant(0.5)), mantissa)
        e = p.apply("select", high, p.apply("add", exponent, p.constant(1.0)), exponent)
        one = p.constant(1.0)
        s = p.apply("ratio", p.apply("sub", m, one), p.apply("add", m, one))
        series = [2.0 / (2 * k + 1) for k in range(self._of.log_terms, -1, -1)]
        rest = p.apply("mul", s, self._polynomial(p.apply("mul", s, s), series))
        found = p.apply("add", p.apply("mul", e, p.constant(_LN2)), rest)
        positive = p.apply("lt", p.constant(0.0), x)
        limit = p.apply("select", p.apply("eq", x, p.constant(0.0)), p.constant(-math.inf), p.constant(math.nan))
        return p.apply("select", positive, found, limit)

    def power(self, x: Value, exponent: Value) -> Value:
        """``x^y`` for x above zero; for any x where y is known to be a small whole number."""
        y = self._p.constants.get(exponent, 0.0)
        if y in _PRODUCTS:
            return functools.reduce(functools.partial(self._p.apply, "mul"), [x] * int(y))
        return self.exp(self._p.apply("mul", exponent, self.log(x)))
