import jax
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from glucoloop.patients import at_basal
from glucoloop.patients.sorensen.parker1999 import PARKER_1999
from glucoloop.patients.sorensen.varying import basal_glucose, with_fasting_glucose

P = PARKER_1999


def balances(fasting_mg_dl):
    """Basal glucose by a general solver: seven balances with every rate at its basal value, arterial glucose given."""
    # Unknown: G_BV, G_BI, G_G, G_L, G_K, G_PV, G_PI.
    A, b = np.zeros((7, 7)), np.zeros(7)
    brain, periphery = P.v_BI / P.T_B, P.v_PI / P.T_P
    A[0, :2], b[0] = (P.q_B + brain, -brain), P.q_B * fasting_mg_dl
    A[1, :2], b[1] = (brain, -brain), P.brain_uptake
    A[2, 2], b[2] = P.q_G, P.q_G * fasting_mg_dl - P.gut_uptake
    A[3, [0, 3, 4, 5]] = P.q_B, P.q_L, P.q_K, P.q_P
    b[3] = P.q_H * fasting_mg_dl + P.red_cell_uptake
    A[4, 4], b[4] = P.q_K, P.q_K * fasting_mg_dl
    A[5, 5:], b[5] = (P.q_P + periphery, -periphery), P.q_P * fasting_mg_dl
    A[6, 5:], b[6] = (periphery, -periphery), P.basal_peripheral_uptake
    return np.linalg.solve(A, b)


@given(st.floats(60.0, 200.0))
def test_basal_glucose_satisfies_every_balance(fasting):
    _, _, G_G, G_L, _, _, G_PI = balances(fasting)
    heart, liver, periphery = basal_glucose(P, fasting)
    assert heart == fasting
    assert (liver, periphery) == pytest.approx((G_L, G_PI), rel=1e-12)
    # The balance that was not used, that of the liver: what it makes is what all organs take up.
    made = P.basal_hepatic_production - P.basal_hepatic_uptake
    assert P.q_L * liver - P.q_A * fasting - P.q_G * G_G == pytest.approx(made, abs=1e-9)


def test_the_printed_references_are_those_of_the_balances_but_for_rounding():
    _, liver, periphery = basal_glucose(P, P.ref_G_H)
    assert P.ref_G_L == pytest.approx(liver, abs=0.02)
    assert P.ref_G_PI == pytest.approx(periphery, abs=0.17)


@given(st.floats(20.0, 200.0))
def test_all_references_move_as_the_balances_ask(fasting):
    shifted = with_fasting_glucose(P, fasting)
    here = np.array(basal_glucose(P, fasting)) - basal_glucose(P, P.ref_G_H)
    there = np.subtract((shifted.ref_G_H, shifted.ref_G_L, shifted.ref_G_PI), (P.ref_G_H, P.ref_G_L, P.ref_G_PI))
    np.testing.assert_allclose(there, here, atol=1e-12)


def test_the_same_fasting_glucose_changes_nothing():
    assert jax.tree.leaves(with_fasting_glucose(P, P.ref_G_H)) == jax.tree.leaves(P)


@settings(max_examples=20)
@given(st.floats(70.0, 140.0))
def test_the_nominal_rate_holds_nearly_the_fasting_glucose(fasting):
    # 22.33 mU/min into the blood acts more on the periphery and less on the liver than a healthy person's insulin does,
    # and the two effects nearly cancel at the healthy fasting glucose, whatever that is.
    assert float(at_basal(with_fasting_glucose(P, fasting), 22.33).setpoint_mg_dl) == pytest.approx(fasting, rel=5e-3)


def test_both_printed_numbers_hold_at_once(patient_fasting_81):
    assert float(patient_fasting_81.basal_insulin_mU_min) == 22.33
    assert round(float(patient_fasting_81.setpoint_mg_dl)) == 81


@pytest.mark.parametrize("fasting", [5.08, 0.0, -1.0, float("nan")])
def test_a_fasting_glucose_that_leaves_nothing_is_refused(fasting):
    with pytest.raises(ValueError, match=r"leaves the peripheral tissue none; give more than 5\.08 mg/dl"):
        with_fasting_glucose(P, fasting)
