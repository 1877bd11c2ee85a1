"""Elementary functions against those of NumPy in a higher precision, in units in the last place."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from glucoloop.native.functions import Functions
from glucoloop.native.program import SAMPLE, Program

PRECISIONS = ["float64", "float32"]
NAMES = ("exp", "expm1", "log", "tanh", "power")
MAX_ULPS = {"exp": 2.0, "expm1": 4.0, "tanh": 6.0, "log": 6.0}
ANGLES = ("sin", "cos", "tan")
FURTHEST = {"float64": 2.2e14, "float32": 4.1e5}
MAX_ULPS |= {
    "sin": 2.0,
    "cos": 2.0,
    "tan": 4.0,
    "sinh": 4.0,
    "cosh": 2.0,
    "cbrt": 1.0,
    "arctan2": 3.0,
    "logistic": 3.0,
}
LARGEST = {"float64": 708.0, "float32": 87.0}


def all_of_them(x, y):
    return jnp.exp(x), jnp.expm1(x), jnp.log(x), jnp.tanh(x), x**y


@pytest.fixture(scope="module")
def functions(native):
    """All functions of x (power of y too) by name, in a precision."""
    compiled = {p: native(all_of_them, np.zeros(1), np.zeros(1), precision=p) for p in PRECISIONS}

    def evaluate(precision, x, y=1.0):
        x, y = np.broadcast_arrays(np.atleast_1d(np.asarray(x, precision)), np.asarray(y, precision))
        return dict(zip(NAMES, compiled[precision](x, y), strict=True))

    return evaluate


def ulps(found, truth):
    """Distance from the truth, in units in the last place of what was found."""
    nearest = truth.astype(found.dtype)
    exact = (found == nearest) | (np.isnan(found) & np.isnan(nearest))
    with np.errstate(invalid="ignore"):
        return np.where(exact, 0.0, np.abs(found.astype(truth.dtype) - truth) / np.spacing(np.abs(nearest)))


def wider(x):
    return x.astype(np.longdouble if x.dtype == np.float64 else np.float64)


@pytest.mark.parametrize("precision", PRECISIONS)
def test_functions_are_exact_to_a_few_units_in_the_last_place(functions, precision):
    rng = np.random.default_rng(0)
    n, largest = 20_000, LARGEST[precision]
    wide = rng.uniform(-largest, largest, n)
    tiny = np.concatenate([10.0 ** rng.uniform(-30, 0, n // 2), -(10.0 ** rng.uniform(-30, 0, n // 2))])
    near = np.concatenate([rng.uniform(-3.0, 3.0, n), np.log(2.0) * np.arange(-40.5, 41.0, 0.5), tiny])
    for x in (wide, near):
        x = x.astype(precision)
        found = functions(precision, x)
        for name in ("exp", "expm1", "tanh"):
            assert ulps(found[name], getattr(np, name)(wider(x))).max() < MAX_ULPS[name]
    positive = np.concatenate([10.0 ** rng.uniform(-30, 30, n), 1.0 + rng.uniform(-0.4, 0.6, n), 1.0 + tiny * 1e-3])
    positive = positive.astype(precision)
    assert ulps(functions(precision, positive)["log"], np.log(wider(positive))).max() < MAX_ULPS["log"]


def angles_and_roots(x, y):
    return {
        **{name: getattr(jnp, name)(x) for name in (*ANGLES, "sinh", "cosh", "cbrt")},
        "arctan2": jnp.arctan2(y, x),
        "logistic": jax.nn.sigmoid(x),
    }


@pytest.mark.parametrize("products", ["fused", "strict"])
@pytest.mark.parametrize("precision", PRECISIONS)
def test_angles_and_roots_are_exact_to_a_few_units_in_the_last_place(native, precision, products):
    rng = np.random.default_rng(2)
    n, largest, furthest = 20_000, LARGEST[precision], FURTHEST[precision]
    sign, decades = rng.choice([-1.0, 1.0], n), np.log10(float(np.finfo(precision).max)) - 1.0
    turns = rng.integers(0, int(0.6 * furthest), n).astype(np.longdouble) * (np.arctan(np.longdouble(1.0)) * 2.0)
    numbers = {
        "tan": [sign * 10.0 ** rng.uniform(-30, np.log10(furthest), n), turns, rng.uniform(-7.0, 7.0, n)],
        "cosh": [rng.uniform(-largest, largest, n), sign * 10.0 ** rng.uniform(-30, 0, n)],
        "cbrt": [sign * 10.0 ** rng.uniform(-decades, decades, n), rng.uniform(-9.0, 9.0, n)],
    }
    numbers = {name: np.concatenate(parts).astype(precision) for name, parts in numbers.items()}
    numbers["tan"] = numbers["tan"][np.abs(numbers["tan"]) < furthest]
    of = {**dict.fromkeys(ANGLES, "tan"), **dict.fromkeys(("sinh", "cosh", "logistic"), "cosh")}
    compiled = native(angles_and_roots, np.zeros(1), np.zeros(1), precision=precision, products=products)
    with np.errstate(all="ignore"):
        for name in ("sin", "cos", "tan", "sinh", "cosh", "cbrt", "logistic", "arctan2"):
            x = numbers[of.get(name, "cbrt")]
            y = x[::-1] * np.where(np.abs(x) < 10.0, x[::-1], 1.0).astype(precision)
            wide = wider(x)
            if name == "arctan2":
                truth = np.arctan2(wider(y), wide)
            else:
                truth = 1.0 / (1.0 + np.exp(-wide)) if name == "logistic" else getattr(np, name)(wide)
            found = compiled(x, y)[name]
            ordinary = np.abs(truth) >= np.finfo(precision).tiny  # the last digits of smaller ones are lost
            assert ulps(found, truth)[ordinary].max() < MAX_ULPS[name], name


@pytest.mark.parametrize("precision", PRECISIONS)
def test_angles_and_roots_of_extremes(native, precision):
    kinds = np.array([0.0, -0.0, 1.0, -1.0, np.inf, -np.inf, np.nan], precision)
    x, y = (of.ravel() for of in np.meshgrid(kinds, kinds))
    found = native(angles_and_roots, x, y, precision=precision)(x, y)
    with np.errstate(all="ignore"):
        for name in (*ANGLES, "cbrt", "arctan2"):
            truth = np.arctan2(y, x) if name == "arctan2" else getattr(np, name)(x)
            np.testing.assert_allclose(found[name], truth, rtol=3.0 * np.finfo(precision).eps)
            some = ~np.isnan(truth)
            np.testing.assert_array_equal(np.signbit(found[name])[some], np.signbit(truth)[some])
    far = np.full(1, 10.0 * FURTHEST[precision], precision)
    assert np.isnan(native(angles_and_roots, far, far, precision=precision)(far, far)["sin"])
    limits = np.finfo(precision)
    small = np.array([limits.smallest_subnormal, limits.tiny / 8, limits.max], precision)
    np.testing.assert_allclose(native(jnp.cbrt, small, precision=precision)(small), np.cbrt(small), rtol=limits.eps)


SHARING = {"tanh": jnp.tanh, "log": jnp.log, "cbrt": jnp.cbrt, "power": lambda x: x**1.7}


def test_functions_that_share_divisions_are_known():
    def shares(function):
        p = Program()
        arguments = [p.input(i, SAMPLE) for i in range(function.__code__.co_argcount - 1)]
        function(Functions(p, "float64"), *arguments)
        return any(operation == "ratio" for operation, _ in p.operations)

    everything = {name: of for name, of in vars(Functions).items() if not name.startswith("_")}
    assert {name for name, of in everything.items() if shares(of)} == {
        *SHARING,
        "erf_inv",
    }  # the last in drawings alone


@pytest.mark.parametrize("products", ["fused", "strict"])
@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("name", SHARING)
def test_no_number_spoils_functions_of_another_number(native, name, precision, products):
    limits = np.finfo(precision)
    size = [0.0, 1.0, 0.5, 30.0, limits.tiny, limits.smallest_subnormal, limits.max, np.inf, np.nan]
    x = np.array([*size, *np.negative(size)], precision)
    y = np.full_like(x, 0.3)

    def of_both(x, y):
        return SHARING[name](x), {other: of(y) for other, of in SHARING.items()}

    own, others = native(of_both, x, y, precision=precision, products=products)(x, y)
    for other, found in others.items():  # a shared quotient loses a unit or two
        np.testing.assert_allclose(found, SHARING[other](y), rtol=8.0 * limits.eps, err_msg=other)
    assert np.isnan(own[np.isnan(x)]).all()


@pytest.mark.parametrize("precision", PRECISIONS)
def test_powers_lose_what_their_logarithm_loses(functions, precision):
    rng = np.random.default_rng(1)
    x, y = (rng.uniform(*bounds, 20_000).astype(precision) for bounds in ((1e-3, 700.0), (-3.0, 3.0)))
    truth = wider(x) ** wider(y)
    scale = 4.0 + 4.0 * np.abs(y * np.log(x))
    assert np.all(ulps(functions(precision, x, y)["power"], truth) < scale)


@pytest.mark.parametrize("precision", PRECISIONS)
def test_extremes(functions, precision):
    largest, least = LARGEST[precision], np.finfo(precision).tiny
    x = np.array([np.nan, np.inf, -np.inf, 1e30, -1e30, 0.0, -0.0])
    found = functions(precision, x, 2.5)
    for name in NAMES:
        assert np.isnan(found[name][0])
    most = np.exp(largest)
    np.testing.assert_allclose(found["exp"], [np.nan, most, 1 / most, most, 1 / most, 1.0, 1.0], rtol=1e-4)
    assert np.all(found["exp"][1:] > 0.0)
    np.testing.assert_allclose(found["expm1"], [np.nan, most, -1.0, most, -1.0, 0.0, 0.0], rtol=1e-4)
    np.testing.assert_allclose(
        found["tanh"], [np.nan, 1.0, -1.0, 1.0, -1.0, 0.0, 0.0], rtol=2.0 * np.finfo(precision).eps
    )
    assert np.isnan(found["log"][[2, 4]]).all()
    np.testing.assert_array_equal(found["log"][5:], -np.inf)
    assert functions(precision, least)["log"][0] == pytest.approx(np.log(float(least)), rel=1e-6)
    assert np.isnan(found["power"][[2, 4]]).all()
    np.testing.assert_allclose(found["power"][5:], 0.0, atol=1e-37)


def test_powers_of_anything_by_a_small_whole_number_are_products(native):
    x = np.array([-3.0, -0.5, 0.0, 2.0, np.nan])
    power = native(lambda x: (x**2.0, jnp.power(x, 3.0), x**-2, x**0), x)
    for found, exponent in zip(power(x), (2, 3, -2, 0), strict=True):
        with np.errstate(divide="ignore"):
            np.testing.assert_array_equal(found, x**exponent if exponent else np.ones(5))


@pytest.mark.parametrize("precision", PRECISIONS)
def test_functions_of_constants_are_carried_out_beforehand(native, precision):
    x = np.array([1.0, 2.0])

    def of_constants(x):
        a = jnp.asarray(-0.7)
        return x * jnp.exp(a), x * jnp.expm1(a), x * jnp.log(-a), x * jnp.tanh(a), x * (-a) ** jnp.asarray(1.3)

    of = native(of_constants, x, precision=precision)
    truth = [np.exp(-0.7), np.expm1(-0.7), np.log(0.7), np.tanh(-0.7), 0.7**1.3]
    for found, value in zip(of(x), truth, strict=True):
        np.testing.assert_allclose(found, x * value, rtol=4.0 * np.finfo(precision).eps)
    assert "call" not in of.kernel.text


@settings(max_examples=60)
@given(st.lists(st.floats(-1e4, 1e4), min_size=1, max_size=20))
def test_functions_grow_and_keep_their_bounds(functions, numbers):
    x = np.sort(np.array(numbers))
    found = functions("float64", x)
    for name in ("exp", "expm1", "tanh"):
        slack = 4.0 * np.spacing(np.abs(found[name]))[1:]
        assert np.all(np.diff(found[name]) >= -slack)
    assert np.all(np.abs(found["tanh"]) <= 1.0 + 1e-15)
    assert np.all(found["exp"] > 0.0)
    assert np.all(found["expm1"] >= -1.0)
    np.testing.assert_allclose(functions("float64", -x)["tanh"], -found["tanh"], rtol=2e-15)
