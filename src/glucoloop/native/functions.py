"""Elementary functions as operations of a scalar program, so that a result is the same on every processor.

`exp` and `expm1` take multiples of ln 2 off their argument and a polynomial of what is left, which is at most .3466;
`tanh` and `sinh` are made of `expm1`, so that they are exact to rounding near zero too; `log` takes the exponent off
and sums the series of the inverse hyperbolic tangent. `sin` and `cos` take multiples of pi/2 off by products without
rounding, `atan2` is a polynomial up to the tangent of pi/8, and `cbrt` two steps of Newton's method. Against NumPy they
differ by a few units in the last place. `rem` and what makes numbers whole are exact.

Arguments so large that more digits would be needed give NaN: `sin`, `cos` and `tan` beyond 2.2e14
(4.1e5 in single precision), and `rem` with a quotient beyond 2^50 (2^21).

References
----------
T. J. Dekker, "A floating-point technique for extending the available precision", Numer. Math. 18, 1971.
M. Giles, "Approximating the erfinv function", in GPU Computing Gems, Jade Edition, 2011 (`erf_inv`, as JAX has it).
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from glucoloop.native.program import Program, Value

DOUBLE: Final = "float64"
SINGLE: Final = "float32"

_LN2: Final = math.log(2.0)
SMALL_POWERS: Final = (1.0, 2.0, 3.0, 4.0)
"""Exponents for which a power is a product."""
FURTHEST_WHOLE: Final = 2.0**30
"""Bound on whole numbers that are made from real ones."""


def _polynomial(function: Callable[[np.ndarray], np.ndarray], degree: int, low: float, high: float) -> list[float]:
    """Coefficients of a polynomial near a function between two bounds, the highest power first."""
    result = np.polynomial.Chebyshev.interpolate(function, degree, [low, high])
    return [float(c) for c in result.convert(kind=np.polynomial.Polynomial).coef[::-1]]


def _factorials(first: int, step: int) -> np.polynomial.Polynomial:
    """The series ``1 / first! +- x / (first + |step|)! + ...``, whose signs alternate where the step is below zero."""
    signs = [1.0 if step > 0 else (-1.0) ** k for k in range(20)]
    return np.polynomial.Polynomial([sign / math.factorial(first + k * abs(step)) for k, sign in enumerate(signs)])


_ATAN: Final = np.polynomial.Polynomial([(-1.0) ** (k + 1) / (2 * k + 3) for k in range(40)])
"""The series ``(atan(t) / t - 1) / t^2`` of ``t^2``."""
_TAN_EIGHTH: Final = math.sqrt(2.0) - 1.0
"""Tangent of pi/8, the largest number whose inverse tangent is the polynomial."""

_ERF_INV_CENTRE: Final = (
    -3.6444120640178196996e-21, -1.685059138182016589e-19, 1.2858480715256400167e-18, 1.115787767802518096e-17,
    -1.333171662854620906e-16, 2.0972767875968561637e-17, 6.6376381343583238325e-15, -4.0545662729752068639e-14,
    -8.1519341976054721522e-14, 2.6335093153082322977e-12, -1.2975133253453532498e-11, -5.4154120542946279317e-11,
    1.051212273321532285e-09, -4.1126339803469836976e-09, -2.9070369957882005086e-08, 4.2347877827932403518e-07,
    -1.3654692000834678645e-06, -1.3882523362786468719e-05, 0.0001867342080340571352, -0.00074070253416626697512,
    -0.0060336708714301490533, 0.24015818242558961693, 1.6536545626831027356,
)  # fmt: skip
_ERF_INV_SIDE: Final = (
    2.2137376921775787049e-09, 9.0756561938885390979e-08, -2.7517406297064545428e-07, 1.8239629214389227755e-08,
    1.5027403968909827627e-06, -4.013867526981545969e-06, 2.9234449089955446044e-06, 1.2475304481671778723e-05,
    -4.7318229009055733981e-05, 6.8284851459573175448e-05, 2.4031110387097893999e-05, -0.0003550375203628474796,
    0.00095328937973738049703, -0.0016882755560235047313, 0.0024914420961078508066, -0.0037512085075692412107,
    0.005370914553590063617, 1.0052589676941592334, 3.0838856104922207635,
)  # fmt: skip
_ERF_INV_TAIL: Final = (
    -2.7109920616438573243e-11, -2.5556418169965252055e-10, 1.5076572693500548083e-09, -3.7894654401267369937e-09,
    7.6157012080783393804e-09, -1.4960026627149240478e-08, 2.9147953450901080826e-08, -6.7711997758452339498e-08,
    2.2900482228026654717e-07, -9.9298272942317002539e-07, 4.5260625972231537039e-06, -1.9681778105531670567e-05,
    7.5995277030017761139e-05, -0.00021503011930044477347, -0.00013871931833623122026, 1.0103004648645343977,
    4.8499064014085844221,
)  # fmt: skip
"""Coefficients of erfinv(x) / x, the highest power first, of ``w - 3.125``, ``sqrt(w) - 3.25`` and ``sqrt(w) - 5``."""


@dataclass(frozen=True)
class _Precision:
    """Constants of the functions in one precision."""

    ln2_high: float
    """Leading part of ln 2 with few bits, so that its multiples are exact."""
    ln2_low: float
    bits: int
    """Bits of a mantissa after its first."""
    degrees: tuple[int, int, int]
    """Degrees of the polynomials of exponential, sine, and inverse tangent."""
    log_terms: int
    largest: float
    """Largest argument of exp."""
    saturated: float
    """Argument from which tanh is one to rounding."""
    half_pi: tuple[str, str, str]
    """pi/2 as a sum."""

    @property
    def round_to_whole(self) -> float:
        """Number which, added to another, leaves the nearest whole number in the last bits."""
        return 1.5 * 2.0**self.bits

    @functools.cached_property
    def polynomials(self) -> dict[str, list[float]]:
        """Coefficients of the polynomials that the functions are made of, the highest power first."""
        half, eighth = 0.5 * _LN2 * (1.0 + 1e-6), (1.05 * math.pi / 4.0) ** 2
        of_exp, of_sin, of_atan = self.degrees
        return {
            "exp": _polynomial(_factorials(2, 1), of_exp, -half, half),
            "sin": [-c for c in _polynomial(_factorials(3, -2), of_sin, 0.0, eighth)],
            "cos": _polynomial(_factorials(4, -2), of_sin, 0.0, eighth),
            "atan": _polynomial(_ATAN, of_atan, 0.0, _TAN_EIGHTH**2),
            "cbrt": _polynomial(np.cbrt, 4, 1.0, 2.0),
        }


_OF: Final = {
    DOUBLE: _Precision(
        ln2_high=float.fromhex("0x1.62e42fee00000p-1"),
        ln2_low=float.fromhex("0x1.a39ef35793c76p-33"),
        bits=52,
        degrees=(10, 6, 11),
        log_terms=11,
        largest=708.0,
        saturated=20.0,
        half_pi=("0x1.921fb54442d18p+0", "0x1.1a62633145c07p-54", "-0x1.f1976b7ed8fbcp-110"),
    ),
    SINGLE: _Precision(
        ln2_high=0.693359375,
        ln2_low=-2.12194440e-4,
        bits=23,
        degrees=(4, 3, 5),
        log_terms=5,
        largest=87.0,
        saturated=10.0,
        half_pi=("0x1.921fb6p+0", "-0x1.777a5cp-25", "-0x1.ee59dap-50"),
    ),
}

_OF_CONSTANTS: Final[dict[str, Callable[..., Any]]] = {
    **{name: getattr(np, name) for name in ("exp", "expm1", "tanh", "log", "sin", "cos", "tan", "sinh", "cosh")},
    "atan2": np.arctan2,
    "cbrt": np.cbrt,
    "rem": np.fmod,
    "ceil": np.ceil,
    "round_even": np.rint,
}


class Functions:
    """Elementary functions in one precision."""

    def __init__(self, program: Program, precision: str) -> None:
        self._p = program
        self._constants = _OF[precision]
        self._number = np.dtype(precision).type

    def __call__(self, name: str, *arguments: Value) -> Value:
        """The value of a function by name; of constants it is computed here."""
        constants = self._p.constants
        if name in _OF_CONSTANTS and all(a in constants for a in arguments):
            with np.errstate(all="ignore"):
                return self._p.constant(float(_OF_CONSTANTS[name](*(np.float64(constants[a]) for a in arguments))))
        value: Value = getattr(self, name)(*arguments)
        return value

    def _do(self, operation: str, *arguments: Value | float) -> Value:
        """An operation on values and constants; a whole number among them is a value."""
        operands = (self._p.constant(a) if isinstance(a, float) else a for a in arguments)
        return self._p.apply(operation, *operands)

    def _polynomial(self, x: Value, coefficients: Sequence[float]) -> Value:
        """Horner's rule, the highest power first."""
        total = self._p.constant(coefficients[0])
        for coefficient in coefficients[1:]:
            total = self._do("add", self._do("mul", total, x), coefficient)
        return total

    def _limited(self, x: Value, largest: float) -> Value:
        return self._do("max", self._do("min", x, largest), -largest)

    def _reduced(self, x: Value) -> tuple[Value, Value]:
        """2^n and expm1(r) with ``x = n ln 2 + r``."""
        do, constants = self._do, self._constants
        shifted = do("add", do("mul", x, 1.0 / _LN2), constants.round_to_whole)
        n = do("exact_sub", shifted, constants.round_to_whole)
        r = do("sub", x, do("mul", n, constants.ln2_high))
        r = do("sub", r, do("mul", n, constants.ln2_low))
        small = do("add", do("mul", do("mul", r, r), self._polynomial(r, constants.polynomials["exp"])), r)
        return do("power_of_two", shifted), small

    def exp(self, x: Value) -> Value:
        """e^x; beyond the range of numbers the largest or smallest of them."""
        scale, small = self._reduced(self._limited(x, self._constants.largest))
        return self._do("add", self._do("mul", scale, small), scale)

    def _grown(self, x: Value) -> Value:
        scale, small = self._reduced(x)
        return self._do("add", self._do("mul", scale, small), self._do("sub", scale, 1.0))

    def expm1(self, x: Value) -> Value:
        """exp(x) - 1, exact to rounding near zero too."""
        return self._grown(self._limited(x, self._constants.largest))

    def tanh(self, x: Value) -> Value:
        """The hyperbolic tangent."""
        limited = self._limited(x, self._constants.saturated)
        grown = self._grown(self._do("add", limited, limited))
        return self._do("ratio", grown, self._do("add", grown, 2.0))

    def sinh(self, x: Value) -> Value:
        """The hyperbolic sine."""
        e = self("expm1", self._do("abs", x))
        half = self._do("mul", self._do("add", e, self._do("div", e, self._do("add", e, 1.0))), 0.5)
        return self._do("copy_sign", half, x)

    def cosh(self, x: Value) -> Value:
        """The hyperbolic cosine."""
        e = self("exp", self._do("abs", x))
        return self._do("mul", self._do("add", e, self._do("div", 1.0, e)), 0.5)

    def logistic(self, x: Value) -> Value:
        """1 / (1 + exp(-x))."""
        return self._do("div", 1.0, self._do("add", self("exp", self._do("neg", x)), 1.0))

    def log(self, x: Value) -> Value:
        """The natural logarithm; minus infinity at zero, NaN below."""
        do = self._do
        mantissa, exponent = do("mantissa", x), do("exponent", x)
        high = do("lt", math.sqrt(2.0), mantissa)
        m = do("select", high, do("mul", mantissa, 0.5), mantissa)
        e = do("select", high, do("add", exponent, 1.0), exponent)
        s = do("ratio", do("sub", m, 1.0), do("add", m, 1.0))
        series = [2.0 / (2 * k + 1) for k in range(self._constants.log_terms, -1, -1)]
        rest = do("mul", s, self._polynomial(do("mul", s, s), series))
        result = do("add", do("mul", e, _LN2), rest)
        limit = do("select", do("eq", x, 0.0), -math.inf, math.nan)
        return do("select", do("lt", 0.0, x), result, limit)

    def erf_inv(self, x: Value) -> Value:
        """Inverse of the error function, in double precision."""
        do = self._do
        w = do("neg", self("log", do("exact_sub", 1.0, do("mul", x, x))))
        s = do("sqrt", w)
        centre = self._polynomial(do("sub", w, 3.125), _ERF_INV_CENTRE)
        side = self._polynomial(do("sub", s, 3.25), _ERF_INV_SIDE)
        tail = self._polynomial(do("sub", s, 5.0), _ERF_INV_TAIL)
        far = do("select", do("lt", w, 16.0), side, tail)
        return do("mul", x, do("select", do("lt", w, 6.25), centre, far))

    def power(self, x: Value, exponent: Value) -> Value:
        """``x^y`` for x above zero; for any x where y is known to be a small whole number."""
        y = self._p.constants.get(exponent, 0.0)
        if y in SMALL_POWERS:
            return functools.reduce(functools.partial(self._p.apply, "mul"), [x] * int(y))
        return self("exp", self._do("mul", exponent, self("log", x)))

    def _nearest(self, x: Value) -> Value:
        """The whole number nearest to an x that is not below zero nor too large for this."""
        return self._do("exact_sub", self._do("add", x, 2.0**self._constants.bits), 2.0**self._constants.bits)

    def _rounded(self, x: Value, size: Value) -> Value:
        """A whole number with the sign of x; x itself where all its bits are of whole numbers."""
        fraction = self._do("lt", self._do("abs", x), 2.0**self._constants.bits)
        return self._do("select", fraction, self._do("copy_sign", size, x), x)

    def round_even(self, x: Value) -> Value:
        """The nearest whole number; of two, the even one."""
        return self._rounded(x, self._nearest(self._do("abs", x)))

    def round_away(self, x: Value) -> Value:
        """The nearest whole number; of two, that further from zero."""
        size = self._do("abs", x)
        below = self._do("floor", size)
        up = self._do("number", self._do("le", 0.5, self._do("exact_sub", size, below)))
        return self._rounded(x, self._do("add", below, up))

    def sign(self, x: Value) -> Value:
        """1 or -1, or x itself if it is zero or NaN."""
        low = self._do("select", self._do("lt", x, 0.0), -1.0, x)
        return self._do("select", self._do("lt", 0.0, x), 1.0, low)

    def ceil(self, x: Value) -> Value:
        """The smallest whole number that is not below x."""
        return self._do("neg", self._do("floor", self._do("neg", x)))

    def whole(self, x: Value) -> Value:
        """The whole number next to x towards zero, within `FURTHEST_WHOLE`; zero for NaN."""
        near = self._do("select", self._do("eq", x, x), self._limited(x, FURTHEST_WHOLE), 0.0)
        below = self._do("floor", near)
        cut = self._do("and", self._do("lt", near, 0.0), self._do("ne", below, near))
        return self._do("add", below, self._do("number", cut))

    def _halves(self, x: Value) -> tuple[Value, Value]:
        """Two numbers of half as many bits, whose sum is x (Dekker)."""
        factor = 2.0 ** ((self._constants.bits + 2) // 2) + 1.0
        if x in self._p.constants:  # in the precision of the target
            number = self._number(self._p.constants[x])
            high = self._number(factor) * number - (self._number(factor) * number - number)
            return self._p.constant(float(high)), self._p.constant(float(number - high))
        scaled = self._do("mul", x, factor)
        first = self._do("exact_sub", scaled, self._do("exact_sub", scaled, x))
        return first, self._do("exact_sub", x, first)

    def _less(self, x: Value, n: Value, y: Value) -> Value:
        """``x - n y``, without rounding of the product."""
        do, (n1, n2), (y1, y2) = self._do, self._halves(n), self._halves(y)
        product = do("mul", n, y)
        lost = do("exact_sub", do("mul", n1, y1), product)
        for a, b in ((n1, y2), (n2, y1), (n2, y2)):
            lost = do("add", lost, do("mul", a, b))
        return do("exact_sub", do("exact_sub", x, product), lost)

    def rem(self, x: Value, y: Value) -> Value:
        """The remainder of x / y, exact, with the sign of x."""
        do, a, b = self._do, self._do("abs", x), self._do("abs", y)
        n = self._nearest(do("div", a, b))
        rest = self._less(a, n, b)
        rest = do("select", do("lt", rest, 0.0), do("add", rest, b), rest)
        rest = do("select", do("lt", a, b), a, rest)
        exact = do("lt", n, 2.0 ** (self._constants.bits - 2))
        return do("copy_sign", do("select", exact, rest, math.nan), x)

    def whole_rem(self, x: Value, y: Value) -> Value:
        """Remainder of whole numbers; x where y is zero."""
        return self._do("select", self._do("eq", y, 0.0), x, self("rem", x, y))

    def whole_div(self, x: Value, y: Value) -> Value:
        """Quotient of whole numbers, towards zero; -1 where y is zero."""
        exact = self._do("div", self._do("sub", x, self("rem", x, y)), y)
        return self._do("select", self._do("eq", y, 0.0), -1.0, self("round_even", exact))

    def _turned(self, x: Value) -> tuple[Value, Value, Value]:
        """Sine and cosine of x without its multiples n of pi/2, and n modulo four; x not below zero."""
        do, constants = self._do, self._constants
        first, second, third = (self._p.constant(float.fromhex(part)) for part in constants.half_pi)
        n = self._nearest(do("mul", x, 2.0 / math.pi))
        r = self._less(self._less(x, n, first), n, second)
        r = do("sub", r, do("mul", n, third))
        r = do("select", do("lt", n, 2.0 ** (constants.bits - 5)), r, math.nan)
        u = do("mul", r, r)
        sine = do("add", r, do("mul", do("mul", r, u), self._polynomial(u, constants.polynomials["sin"])))
        cosine = do("mul", do("mul", u, u), self._polynomial(u, constants.polynomials["cos"]))
        cosine = do("add", do("sub", 1.0, do("mul", u, 0.5)), cosine)
        turns = do("mul", do("floor", do("mul", n, 0.25)), 4.0)
        return sine, cosine, do("exact_sub", n, turns)

    def sin(self, x: Value) -> Value:
        """The sine; NaN where x is too large for it."""
        do, (sine, cosine, n) = self._do, self._turned(self._do("abs", x))
        size = do("select", do("or", do("eq", n, 1.0), do("eq", n, 3.0)), cosine, sine)
        size = do("select", do("lt", n, 2.0), size, do("neg", size))
        return do("mul", size, do("copy_sign", 1.0, x))

    def cos(self, x: Value) -> Value:
        """The cosine; NaN where x is too large for it."""
        do, (sine, cosine, n) = self._do, self._turned(self._do("abs", x))
        size = do("select", do("or", do("eq", n, 1.0), do("eq", n, 3.0)), sine, cosine)
        return do("select", do("or", do("eq", n, 1.0), do("eq", n, 2.0)), do("neg", size), size)

    def tan(self, x: Value) -> Value:
        """The tangent; NaN where x is too large for it."""
        return self._do("div", self("sin", x), self("cos", x))

    def atan2(self, y: Value, x: Value) -> Value:
        """The angle of the point whose second coordinate is x and whose first is y."""
        do, a, b = self._do, self._do("abs", x), self._do("abs", y)
        large, small = do("max", a, b), do("min", a, b)
        t = do("select", do("eq", large, small), 1.0, do("div", small, large))  # infinite ones as well
        t = do("select", do("eq", large, 0.0), 0.0, t)
        far = do("lt", _TAN_EIGHTH, t)
        s = do("select", far, do("div", do("sub", t, 1.0), do("add", t, 1.0)), t)
        u = do("mul", s, s)
        angle = do("add", s, do("mul", do("mul", s, u), self._polynomial(u, self._constants.polynomials["atan"])))
        angle = do("select", far, do("add", angle, math.pi / 4.0), angle)
        angle = do("select", do("lt", a, b), do("sub", math.pi / 2.0, angle), angle)
        negative = do("lt", do("copy_sign", 1.0, x), 0.0)
        return do("copy_sign", do("select", negative, do("sub", math.pi, angle), angle), y)

    def cbrt(self, x: Value) -> Value:
        """The cube root."""
        do, constants, size = self._do, self._constants, self._do("abs", x)
        tiny = do("lt", size, float(np.finfo(self._number).tiny))
        size = do("select", tiny, do("mul", size, 2.0**54), size)
        e, m = do("exponent", size), do("mantissa", size)
        thirds = do("floor", do("mul", do("add", e, 0.5), 1.0 / 3.0))
        rest = do("exact_sub", e, do("mul", thirds, 3.0))
        root = self._polynomial(m, constants.polynomials["cbrt"])
        for k, of_k in ((1.0, 2.0), (2.0, 4.0)):
            matches = do("eq", rest, k)
            m = do("select", matches, do("mul", m, of_k), m)
            root = do("select", matches, do("mul", root, of_k ** (1.0 / 3.0)), root)
        for _ in range(2):
            square = do("mul", root, root)
            wrong = do("sub", do("mul", square, root), m)
            root = do("sub", root, do("ratio", wrong, do("mul", square, 3.0)))
        scale = do("power_of_two", do("add", thirds, constants.round_to_whole))
        root = do("mul", root, do("mul", scale, do("select", tiny, 2.0**-18, 1.0)))
        ordinary = do("and", do("is_finite", x), do("ne", x, 0.0))
        return do("select", ordinary, do("copy_sign", root, x), x)
