"""The Hovorka patient at steady state: basal rates against published numbers and roots by SciPy."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate
import scipy.optimize
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from glucoloop.patients.hovorka import (
    HOVORKA_2004,
    STATE_NAMES,
    WILINSKA_2010,
    at_basal,
    at_setpoint,
)
from glucoloop.patients.hovorka.equations import infusion_for, rest_at, rest_under
from hovorka_by_hand import EVERYBODY, NOMINAL, TO_HAND, TO_OURS, WILINSKA, by_hand, hovorka_by_hand, parameters, person


@pytest.fixture(scope="module")
def nominal():
    return person(NOMINAL)


def test_the_basal_rate_of_the_nominal_person_is_the_published_one(nominal):
    assert float(nominal.basal_insulin_mU_min) * 60.0 / 1000.0 == pytest.approx(0.4037258203, abs=1e-10)
    assert float(nominal.glucose_mg_dl(nominal.steady_state(nominal.basal_insulin_mU_min))) == pytest.approx(
        120.0, rel=1e-14
    )


def test_the_basal_rate_of_2010_is_the_root_of_its_balance():
    """Root found by SciPy; there is no printed one."""
    p, Q1 = WILINSKA, 120.0 / 18.016 * 0.16
    loss = 0.0111 / 0.85 * (120.0 / 18.016) / (120.0 / 18.016 + 1.0)

    def balance(I):
        kept = p["S_IT"] * I * p["S_ID"] * I / (p["k_12"] + p["S_ID"] * I) * Q1
        return p["EGP_0"] * np.exp(-p["S_IE"] * I) - loss - kept

    U_h = scipy.optimize.brentq(balance, 0.0, 50.0, xtol=1e-14) * 0.14 * 0.12 * 74.9 * 60.0 / 1000.0
    assert float(at_setpoint(WILINSKA_2010, 120.0).basal_insulin_mU_min) * 0.06 == pytest.approx(U_h, abs=1e-12)
    assert U_h == pytest.approx(0.89848, abs=1e-5)


def test_in_2010_no_infusion_takes_all_glucose_away():
    person = at_setpoint(WILINSKA_2010, 120.0)
    glucose = np.asarray(person.glucose_mg_dl(person.steady_state(np.linspace(0.0, 200.0, 300))))
    assert np.all(np.diff(glucose) < 0.0)
    assert 0.0 < glucose[-1] < 10.0
    assert float(person.insulin_for(glucose[0])) == pytest.approx(0.0, abs=1e-9)
    with pytest.raises(ValueError, match=r"no insulin infusion holds glucose at 250 mg/dl; .* at most 216\.68 mg/dl"):
        person.insulin_for(250.0)


@settings(max_examples=100)
@given(st.floats(0.0, 23.5), st.sampled_from(EVERYBODY))
def test_nothing_changes_at_rest_and_the_rate_is_found_again(u, constants):
    p = parameters(constants)
    x = np.asarray(rest_under(p, u))
    assert np.all(x >= 0.0)
    np.testing.assert_allclose(by_hand(constants, x[TO_HAND], u, 0.0), 0.0, atol=1e-11)
    assert float(infusion_for(p, x[STATE_NAMES.index("IG")] * 18.016)) == pytest.approx(u, rel=1e-9, abs=1e-9)


@settings(max_examples=60)
@given(st.floats(0.01, 400.0), st.sampled_from(EVERYBODY))
def test_the_rate_for_a_glucose_is_the_root_that_scipy_finds(glucose, constants):
    """At glucose on both sides of each threshold, the balance of plasma glucose with Q2 at steady state."""
    p = constants
    assume(glucose < 200.0 or "uptake_half" not in p)  # where those of 2010 rest without insulin is not far above
    V_G, V_I = p["V_G"] * p["weight_kg"], p["V_I"] * p["weight_kg"]

    def balance(u):
        I = u / (p["k_e"] * V_I)
        x1, x2, x3 = p["S_IT"] * I, p["S_ID"] * I, p["S_IE"] * I
        Q1 = glucose / 18.016 * V_G
        Q2 = x1 * Q1 / (p["k_12"] + x2)
        return by_hand(p, [0.0, 0.0, I, x1, x2, x3, Q1, Q2, 0.0], u, 0.0)[6]

    u, x = rest_at(parameters(p), glucose)
    assert float(u) == pytest.approx(scipy.optimize.brentq(balance, 0.0, 2000.0, xtol=1e-13), rel=1e-9, abs=1e-10)
    np.testing.assert_allclose(by_hand(p, np.asarray(x)[TO_HAND], float(u), 0.0), 0.0, atol=1e-11)


def test_a_person_left_alone_comes_to_the_rest_that_is_told(nominal):
    start = np.asarray(nominal.steady_state(2.0))[TO_HAND]
    late = scipy.integrate.solve_ivp(
        lambda t, x: hovorka_by_hand(NOMINAL, x, 8.0, 0.0), (0.0, 5000.0), start, method="LSODA", rtol=1e-10, atol=1e-10
    ).y[:, -1]
    np.testing.assert_allclose(nominal.steady_state(8.0), late[TO_OURS], rtol=1e-7)


def test_glucose_at_rest_falls_to_zero_as_insulin_rises(nominal):
    rates = np.linspace(0.0, 23.88, 400)
    glucose = np.asarray(nominal.glucose_mg_dl(nominal.steady_state(rates)))
    assert np.all(np.diff(glucose) < 0.0)
    assert glucose[0] == pytest.approx((9.0 + 0.0064 / (0.003 * 0.16)) * 18.016, rel=1e-12)
    assert 0.0 < glucose[-1] < 0.1


def test_a_person_who_makes_less_glucose_than_is_used_without_insulin_rests_low():
    p = dataclasses.replace(HOVORKA_2004, EGP_0=0.009)
    glucose = 4.5 * 0.009 / 0.0097 * 18.016
    assert float(rest_under(p, 0.0)[STATE_NAMES.index("IG")]) * 18.016 == pytest.approx(glucose, rel=1e-13)
    assert np.isnan(infusion_for(p, 120.0))
    with pytest.raises(ValueError, match=r"no insulin infusion holds glucose at 120 mg/dl; .* at most 75\.22 mg/dl"):
        at_setpoint(p, 120.0)


def test_people_without_a_rate_are_not_a_number_among_those_who_have_one():
    p = dataclasses.replace(HOVORKA_2004, EGP_0=jnp.asarray([0.0161, 0.009, 0.02]))
    u, x = rest_at(p, 120.0)
    assert list(np.isfinite(u)) == [True, False, True]
    assert list(np.isfinite(x).all(axis=0)) == [True, False, True]
    assert np.isnan(x[:, 1]).all()


def test_rest_can_be_differentiated(nominal):
    """Also without insulin, where what insulin disposes of is zero."""

    def glucose(u):
        return rest_under(nominal.parameters, u)[2]

    for u in (0.0, 3.0, 6.0, 12.0, 20.0):
        h = 1e-5
        low, high = (float(glucose(max(u + d, 0.0))) for d in (-h, h))
        slope = (high - low) / (2.0 * h if u else h)
        assert float(jax.grad(glucose)(u)) == pytest.approx(slope, rel=1e-3)


@pytest.mark.parametrize("u", [-1.0, np.nan, np.inf])
def test_an_impossible_infusion_is_refused(nominal, u):
    with pytest.raises(ValueError, match=r"is not possible; give a finite rate of 0 or more"):
        nominal.steady_state(u)
    with pytest.raises(ValueError, match=r"is not possible; give a finite rate of 0 or more"):
        at_basal(HOVORKA_2004, u)


def test_an_infusion_under_which_glucose_vanishes_is_refused_with_the_largest_one(nominal):
    with pytest.raises(ValueError, match=r"at 30 mU/min: .* give less than 23\.88 mU/min"):
        nominal.steady_state(30.0)
    nominal.steady_state(23.88)
    with pytest.raises(ValueError, match="no physiological steady state"):
        nominal.steady_state(np.array([1.0, 24.0]))


@pytest.mark.parametrize("glucose", [0.0, -5.0, np.nan, 403.0])
def test_a_glucose_that_no_infusion_holds_is_refused(nominal, glucose):
    with pytest.raises(ValueError, match=r"no insulin infusion holds .* above 0 and at most 402\.36 mg/dl"):
        nominal.insulin_for(glucose)
    with pytest.raises(ValueError, match="no insulin infusion holds"):
        at_setpoint(HOVORKA_2004, glucose)


@settings(max_examples=30)
@given(st.floats(20.0, 400.0))
def test_a_setpoint_and_its_basal_rate_make_the_same_patient(glucose):
    by_setpoint = at_setpoint(HOVORKA_2004, glucose)
    by_rate = at_basal(HOVORKA_2004, float(by_setpoint.basal_insulin_mU_min))
    assert float(by_rate.setpoint_mg_dl) == pytest.approx(glucose, rel=1e-10)
