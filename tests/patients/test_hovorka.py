"""Equations and interface of the Hovorka patient, against a transcription by hand."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from glucoloop.patients import Inputs, Patient, SemilinearPatient
from glucoloop.patients.hovorka import (
    HOVORKA_2004,
    STATE_NAMES,
    WILINSKA_2010,
    HovorkaParameters,
    HovorkaPatient,
    at_setpoint,
    wilinska,
)
from glucoloop.patients.hovorka.hovorka2004 import CONSTANTS
from glucoloop.simulation import linear_model
from hovorka_by_hand import ANOTHER, BY_HAND_NAMES, EVERYBODY, NOMINAL, TO_OURS, by_hand, parameters, person


@pytest.fixture(scope="module")
def nominal():
    return person(NOMINAL)


@pytest.fixture(scope="module")
def people():
    """The nominal person, another one, and the two as one record."""
    alone = [HovorkaParameters(**NOMINAL), HovorkaParameters(**ANOTHER)]
    return alone, jax.tree.map(lambda *constants: jnp.asarray(constants), *alone)


@pytest.mark.parametrize(("record", "constants"), [(HOVORKA_2004, CONSTANTS), (WILINSKA_2010, wilinska.CONSTANTS)])
def test_every_constant_is_given_once_with_unit_meaning_and_source(record, constants):
    assert sorted(constant.name for constant in constants) == sorted(field.name for field in dataclasses.fields(record))
    for constant in constants:
        assert constant.value == getattr(record, constant.name)
        assert constant.unit
        assert len(constant.meaning) > 8
        assert any(year in constant.source for year in ("2004", "2010", "2017"))


AMOUNTS = st.floats(0.0, 400.0)
STATE = st.tuples(
    *(st.floats(0.0, 5000.0),) * 2,  # S1, S2
    st.floats(0.0, 300.0),  # I
    *(st.floats(0.0, 0.5),) * 2,  # x1, x2
    st.floats(0.0, 3.0),  # x3
    *(AMOUNTS,) * 2,  # Q1, Q2
    st.floats(0.0, 40.0),  # IG
)


derivative = jax.jit(
    lambda p, x, u, meal: HovorkaPatient(
        parameters=p, basal_insulin_mU_min=jnp.asarray(0.0), setpoint_mg_dl=jnp.asarray(0.0)
    ).derivative(jnp.zeros(()), x, Inputs(insulin_mU_min=u, meal_mg_min=meal))
)


@settings(max_examples=150)
@given(STATE, st.floats(0.0, 2000.0), st.floats(0.0, 3000.0), st.sampled_from(EVERYBODY))
def test_right_hand_side_is_that_written_out_by_hand(state, u, meal, constants):
    state = np.array(state)
    found = derivative(parameters(constants), state[TO_OURS], u, meal)
    wanted = by_hand(constants, state, u, meal)[TO_OURS]
    np.testing.assert_allclose(found, wanted, rtol=1e-12, atol=1e-12 * max(1.0, np.abs(state[:2]).max()))


@settings(max_examples=60)
@given(STATE, st.floats(0.0, 2000.0), st.floats(0.0, 3000.0), st.booleans())
def test_what_leaves_one_place_arrives_at_the_next(state, u, meal, of_2010):
    """Insulin: infused is stored or cleared. Glucose: made and eaten is stored, used or excreted."""
    p, x = (WILINSKA_2010 if of_2010 else HOVORKA_2004), dict(zip(BY_HAND_NAMES, state, strict=True))
    rate = dict(zip(STATE_NAMES, map(float, derivative(p, np.array(state)[TO_OURS], u, meal)), strict=True))
    V_I, V_G = p.V_I * p.weight_kg, p.V_G * p.weight_kg
    stored = rate["S1"] + rate["S2"] + V_I * rate["I"]
    assert stored + p.k_e * V_I * x["I"] == pytest.approx(u, rel=1e-10, abs=1e-9)
    G = x["Q1"] / V_G
    made = 0.0161 * 75.0 * max(1.0 - x["x3"], 0.0) + meal / 180.16
    used = 0.0097 * 75.0 * min(G / 4.5, 1.0) + x["x2"] * x["Q2"] + 0.003 * V_G * max(G - 9.0, 0.0)
    if of_2010:
        made = 0.0169 * 74.9 * np.exp(-x["x3"]) + meal / 180.16
        used = 0.0111 * 74.9 / 0.85 * G / (G + 1.0) + x["x2"] * x["Q2"] + 0.01 * V_G * max(G - 9.0, 0.0)
    assert rate["Q1"] + rate["Q2"] == pytest.approx(made - used, rel=1e-10, abs=1e-9)


def test_amounts_cannot_become_negative(nominal):
    """Where one is zero it does not fall, whatever the others are."""
    rng = np.random.default_rng(3)
    for empty in range(9):
        x = rng.uniform(0.0, [400.0, 400.0, 30.0, 5000.0, 5000.0, 200.0, 0.4, 0.4, 3.0], (20, 9))
        x[:, empty] = 0.0
        for state in x:
            assert float(derivative(nominal.parameters, state, 0.0, 0.0)[empty]) >= 0.0


def test_patient_keeps_both_protocols_and_tells_its_sites(nominal):
    assert isinstance(nominal, Patient)
    assert isinstance(nominal, SemilinearPatient)
    assert nominal.sites == ("plasma", "interstitial")
    x = nominal.steady_state(3.0).at[STATE_NAMES.index("IG")].set(5.0)
    assert float(nominal.seen_mg_dl(x, "interstitial")) == pytest.approx(5.0 * 18.016)
    assert float(nominal.seen_mg_dl(x, "plasma")) == float(nominal.glucose_mg_dl(x))
    with pytest.raises(
        ValueError, match=r"cannot be measured at 'arterial'; the known sites are: plasma, interstitial"
    ):
        nominal.seen_mg_dl(x, "arterial")


def test_state_is_split_and_joined_without_loss(nominal):
    y, z = nominal.split(jnp.arange(9.0))
    np.testing.assert_array_equal(nominal.join(y, z), np.arange(9.0))
    assert (y.shape, z.shape) == ((3,), (6,))


def test_process_noise_is_that_of_glucose_and_insulin_in_the_units_of_each_state(nominal):
    Q = dict(zip(STATE_NAMES, nominal.process_noise(4.0, 9.0, 100.0), strict=True))
    per_infusion = np.asarray(
        nominal.steady_state(1.0)
    )  # insulin and its effects at steady state are in proportion to it
    scale = dict(zip(STATE_NAMES, per_infusion / per_infusion[STATE_NAMES.index("I")], strict=True))
    for name in ("S1", "S2", "I", "x1", "x2", "x3"):
        assert Q[name] == pytest.approx(9.0 * scale[name] ** 2)
    assert Q["IG"] == pytest.approx(4.0 / 18.016**2)
    assert Q["Q1"] == Q["Q2"] == pytest.approx(4.0 * (0.16 * 75.0 / 18.016) ** 2)


def test_a_cohort_is_its_people(people):
    alone, together = people
    cohort = at_setpoint(together, 110.0)
    rates = derivative(together, cohort.steady_state(7.0), np.array([5.0, 9.0]), np.array([0.0, 200.0]))
    for i, p in enumerate(alone):
        one = at_setpoint(p, 110.0)
        np.testing.assert_allclose(cohort.basal_insulin_mU_min[i], one.basal_insulin_mU_min, rtol=1e-13)
        np.testing.assert_allclose(cohort.steady_state(7.0)[:, i], one.steady_state(7.0), rtol=1e-13)
        rate = derivative(p, one.steady_state(7.0), [5.0, 9.0][i], [0.0, 200.0][i])
        np.testing.assert_allclose(rates[:, i], rate, rtol=1e-12, atol=1e-13)


def test_the_linear_model_has_the_gain_of_the_steady_state(nominal):
    h = 1e-4
    basal = float(nominal.basal_insulin_mU_min)
    high, low = (float(nominal.glucose_mg_dl(nominal.steady_state(basal + d))) for d in (h, -h))
    model = linear_model(nominal)
    gain = model.C @ np.linalg.solve(np.eye(9) - model.Phi, model.Gamma)
    assert float(np.squeeze(gain)) == pytest.approx((high - low) / (2.0 * h), rel=1e-6)
