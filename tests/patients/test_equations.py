import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from glucoloop.patients import Inputs
from glucoloop.patients.sorensen import equations as sorensen
from glucoloop.patients.sorensen.equations import Sigmoid, SorensenParameters, renal_excretion
from glucoloop.patients.sorensen.parker1999 import CONSTANTS, PARKER_1999

GLUCOSE = st.lists(st.floats(1.0, 700.0), min_size=8, max_size=8)
INSULIN = st.lists(st.floats(0.0, 200.0), min_size=7, max_size=7)
REGULATION = st.tuples(st.floats(0.0, 2.5), st.floats(0.0, 2.0), st.floats(0.0, 4.0), st.floats(-0.5, 0.9))

derivative = jax.jit(lambda x, u, meal: sorensen.derivative(PARKER_1999, x, Inputs(insulin_mU_min=u, meal_mg_min=meal)))


@settings(max_examples=200)
@given(GLUCOSE, INSULIN, REGULATION, st.floats(0.0, 70.0), st.floats(0.0, 400.0))
def test_right_hand_side_is_that_written_out_by_hand(sorensen_by_hand, glucose, insulin, regulation, u, meal):
    x = np.array([*glucose, *insulin, *regulation])
    # A balance is the difference of flows that are up to ten times the largest concentration.
    np.testing.assert_allclose(
        derivative(x, u, meal), sorensen_by_hand(x, u, meal), rtol=1e-12, atol=1e-14 * 10.0 * np.abs(x).max()
    )


def test_glucose_lost_in_urine_on_both_sides_of_the_threshold():
    assert renal_excretion(PARKER_1999, 459.0) == pytest.approx(71 + 71 * np.tanh(-0.011), rel=1e-14)
    assert renal_excretion(PARKER_1999, 460.0) == pytest.approx(-330 + 0.872 * 460, rel=1e-14)
    assert renal_excretion(PARKER_1999, 600.0) == pytest.approx(193.2, rel=1e-14)


HEALTHY = {"G_H": 91.89, "G_L": 101.0, "G_PI": 86.81, "I_H": 15.15, "I_L": 21.43, "I_PI": 5.304}


@pytest.mark.parametrize("name", ["M_IHGP", "M_IHGU", "M_GHGP", "M_GHGU", "M_IPGU", "M_IPNR", "M_GPNR"])
def test_every_multiplier_is_one_in_the_healthy_basal_state(name):
    assert float(getattr(PARKER_1999, name)(1.0)) == pytest.approx(1.0, abs=1e-3)


def test_glucagon_multiplies_hepatic_production_by_one_in_the_healthy_basal_state():
    M = float(PARKER_1999.M_NHGP(1.0))
    assert M - (M - 1.0) / 2.0 == pytest.approx(1.0, abs=1e-3)


def test_effects_are_normalised_by_the_healthy_concentrations():
    p = PARKER_1999
    for name, value in HEALTHY.items():
        assert getattr(p, f"ref_{name}") == value
    x = np.zeros(19)
    for name, value in HEALTHY.items():
        x[sorensen.STATE_NAMES.index(name)] = value
    np.testing.assert_allclose(sorensen.insulin_effects(p, x[sorensen.INSULIN]), 1.0, atol=1e-3)


def test_state_is_split_and_joined_without_loss():
    x = jnp.arange(19.0)
    y, insulin = sorensen.split(x)
    np.testing.assert_array_equal(insulin, np.arange(8.0, 15.0))
    np.testing.assert_array_equal(y, [*range(8), *range(15, 19)])
    np.testing.assert_array_equal(sorensen.join(y, insulin), x)


def test_glucose_is_carried_linearly_and_the_rest_is_linear_in_the_meal():
    rng = np.random.default_rng(1)
    y, w, effects = rng.uniform(0.5, 200.0, 12), rng.uniform(0.5, 200.0, 12), rng.uniform(0.2, 2.0, 4)

    def carried(y):
        return np.asarray(sorensen.glucose_transport(PARKER_1999, y))

    def rest(meal):
        return np.asarray(sorensen.glucose_kinetics(PARKER_1999, y, effects, meal))

    np.testing.assert_allclose(carried(2.0 * y - w), 2.0 * carried(y) - carried(w), rtol=1e-11, atol=1e-11)
    np.testing.assert_allclose(rest(300.0) - rest(0.0), 3.0 * (rest(100.0) - rest(0.0)), atol=1e-12)
    both = sorensen.glucose_balances(PARKER_1999, y, effects, 100.0)
    np.testing.assert_allclose(carried(y) + rest(100.0), both, rtol=1e-12, atol=1e-12)


def test_insulin_equations_are_linear():
    def f(z, u):
        return np.asarray(sorensen.insulin_balances(PARKER_1999, z, u))

    rng = np.random.default_rng(0)
    z, w = rng.uniform(0.0, 50.0, (2, 7))
    np.testing.assert_allclose(f(2.0 * z + w, 5.0), 2.0 * f(z, 1.0) + f(w, 3.0), rtol=1e-11)


def parameter_names():
    for field in dataclasses.fields(SorensenParameters):
        if field.type == "Sigmoid":
            yield from (f"{field.name}.{part.name}" for part in dataclasses.fields(Sigmoid))
        else:
            yield field.name


def test_every_constant_is_given_once_and_every_field_is_covered():
    assert sorted(constant.name for constant in CONSTANTS) == sorted(parameter_names())


@pytest.mark.parametrize("constant", CONSTANTS, ids=lambda constant: constant.name)
def test_every_constant_has_a_unit_a_meaning_and_a_source(constant):
    assert constant.unit
    assert len(constant.meaning) > 8
    assert any(year in constant.source for year in ("1985", "2000", "2014"))
    name, _, part = constant.name.partition(".")
    value = getattr(PARKER_1999, name)
    assert (getattr(value, part) if part else value) == constant.value


def test_units_say_what_the_names_say():
    units = {constant.name: constant.unit for constant in CONSTANTS}
    assert {units[name] for name in units if name.startswith("q_")} == {"dl/min"}
    assert {units[name] for name in units if name.startswith("Q_")} == {"l/min"}
    assert {units[name] for name in units if name.startswith("v_")} == {"dl"}
    assert {units[name] for name in units if name.startswith("V_")} == {"l"}
    assert {units[name] for name in units if name.startswith(("T_", "tau_"))} == {"min"}
    assert {units[name] for name in units if name.startswith("ref_G")} == {"mg/dl"}
    assert {units[name] for name in units if name.startswith("ref_I")} == {"mU/l"}
    assert {units[name] for name in units if name.startswith("M_")} == {"1"}
