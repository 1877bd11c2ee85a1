"""The Hovorka patient against a transcription by hand, SciPy, and what must be conserved."""

import dataclasses
import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate
import scipy.optimize
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from glucoloop.meals import Meal, Scenario
from glucoloop.patients import Inputs, Patient, SemilinearPatient
from glucoloop.patients.hovorka import (
    HOVORKA_2004,
    STATE_NAMES,
    WILINSKA_2010,
    HovorkaParameters,
    HovorkaPatient,
    WilinskaParameters,
    at_basal,
    at_setpoint,
)
from glucoloop.patients.hovorka.parameters import wilinska2010
from glucoloop.patients.hovorka.parameters.hovorka2004 import CONSTANTS
from glucoloop.patients.hovorka.rest import infusion_for, rest_at, rest_under
from glucoloop.simulation import Adaptive, Exponential, linear_model, simulate

NOMINAL = {constant.name: constant.value for constant in CONSTANTS}
ANOTHER = NOMINAL | {
    "weight_kg": 91.0,
    "t_maxI": 48.0,
    "k_e": 0.155,
    "V_I": 0.131,
    "k_a1": 0.0081,
    "k_a2": 0.041,
    "k_a3": 0.044,
    "S_IT": 38.0e-4,
    "S_ID": 11.5e-4,
    "S_IE": 410e-4,
    "V_G": 0.138,
    "k_12": 0.051,
    "EGP_0": 0.0183,
    "F_01": 0.0088,
    "t_IG": 9.0,
    "A_G": 0.95,
    "t_maxG": 52.0,
}


WILINSKA = {constant.name: constant.value for constant in wilinska2010.CONSTANTS}
OTHER_WILINSKA = WILINSKA | {
    "weight_kg": 61.0,
    "t_maxI": 48.0,
    "k_e": 0.155,
    "V_I": 0.131,
    "k_a1": 0.0051,
    "k_a2": 0.041,
    "k_a3": 0.031,
    "S_IT": 26.0e-4,
    "S_ID": 3.5e-4,
    "S_IE": 270e-4,
    "V_G": 0.138,
    "k_12": 0.051,
    "EGP_0": 0.0183,
    "F_01": 0.0098,
    "renal_threshold": 10.5,
    "renal_clearance": 0.02,
    "t_IG": 7.0,
    "A_G": 0.95,
    "t_maxG": 52.0,
}
EVERYBODY = [NOMINAL, ANOTHER, WILINSKA, OTHER_WILINSKA]


def parameters(constants):
    return (WilinskaParameters if "uptake_half" in constants else HovorkaParameters)(**constants)


def wilinska_by_hand(p, x, u, appearing_mg_min):
    """Right-hand side as the simulator of the McGill Diabetes Lab has it, per kg of weight and in umol, U and hours."""
    S1, S2, I, x1, x2, x3, Q1, Q2, IG = x
    w, ka, Vg, Vi = p["weight_kg"], 1.0 / p["t_maxI"], 1000.0 * p["V_G"], 1000.0 * p["V_I"]
    s1, s2, q1, q2 = S1 / 1000.0, S2 / 1000.0, 1000.0 * Q1 / w, 1000.0 * Q2 / w
    Um = 1000.0 * appearing_mg_min / 180.16 / w
    above = q1 > p["renal_threshold"] * Vg
    dq1 = -(1000.0 * p["F_01"] / 0.85 / (q1 + Vg) + x1) * q1 + p["k_12"] * q2 + Um
    dq1 += 1000.0 * p["EGP_0"] * np.exp(-x3) - p["renal_clearance"] * (q1 - p["renal_threshold"] * Vg) * above
    dq2 = x1 * q1 - (p["k_12"] + x2) * q2
    return np.array(
        [
            1000.0 * (u * 60.0 / 1000.0 / 60.0 - ka * s1),
            1000.0 * ka * (s1 - s2),
            1e6 * ka * s2 / (Vi * w) - p["k_e"] * I,
            -p["k_a1"] * x1 + p["k_a1"] * p["S_IT"] * I,
            -p["k_a2"] * x2 + p["k_a2"] * p["S_ID"] * I,
            -p["k_a3"] * x3 + p["k_a3"] * p["S_IE"] * I,
            dq1 * w / 1000.0,
            dq2 * w / 1000.0,
            (q1 / Vg - IG) / p["t_IG"],
        ]
    )


def by_hand(p, x, u, appearing_mg_min):
    return (wilinska_by_hand if "uptake_half" in p else hovorka_by_hand)(p, x, u, appearing_mg_min)


def hovorka_by_hand(p, x, u, appearing_mg_min):
    """Right-hand side as the paper prints it, one scalar at a time: S1, S2, I, x1, x2, x3, Q1, Q2, IG."""
    S1, S2, I, x1, x2, x3, Q1, Q2, IG = x
    BW = p["weight_kg"]
    V_I, V_G = p["V_I"] * BW, p["V_G"] * BW
    k_b1, k_b2, k_b3 = p["S_IT"] * p["k_a1"], p["S_ID"] * p["k_a2"], p["S_IE"] * p["k_a3"]
    G = Q1 / V_G
    F_01c = p["F_01"] * BW if G >= 4.5 else p["F_01"] * BW * G / 4.5
    F_R = 0.003 * (G - 9.0) * V_G if G >= 9.0 else 0.0
    EGP = p["EGP_0"] * BW * (1.0 - x3) if x3 < 1.0 else 0.0
    U_G = appearing_mg_min / 180.16
    return np.array(
        [
            u - S1 / p["t_maxI"],
            S1 / p["t_maxI"] - S2 / p["t_maxI"],
            S2 / p["t_maxI"] / V_I - p["k_e"] * I,
            -p["k_a1"] * x1 + k_b1 * I,
            -p["k_a2"] * x2 + k_b2 * I,
            -p["k_a3"] * x3 + k_b3 * I,
            -F_01c - x1 * Q1 + p["k_12"] * Q2 - F_R + U_G + EGP,
            x1 * Q1 - (p["k_12"] + x2) * Q2,
            (G - IG) / p["t_IG"],
        ]
    )


BY_HAND_NAMES = ("S1", "S2", "I", "x1", "x2", "x3", "Q1", "Q2", "IG")
TO_OURS = [BY_HAND_NAMES.index(name) for name in STATE_NAMES]
TO_HAND = [STATE_NAMES.index(name) for name in BY_HAND_NAMES]


def person(constants, setpoint=120.0):
    return at_setpoint(parameters(constants), setpoint)


@pytest.fixture(scope="module")
def nominal():
    return person(NOMINAL)


@pytest.fixture(scope="module")
def people():
    """The nominal person, another one, and the two as one record."""
    alone = [HovorkaParameters(**NOMINAL), HovorkaParameters(**ANOTHER)]
    return alone, jax.tree.map(lambda *constants: jnp.asarray(constants), *alone)


# constants and equations


@pytest.mark.parametrize(("record", "constants"), [(HOVORKA_2004, CONSTANTS), (WILINSKA_2010, wilinska2010.CONSTANTS)])
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


# rest


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
    """At glucose on both sides of each threshold, the balance of plasma glucose with Q2 at rest."""
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


# the patient


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
    per_infusion = np.asarray(nominal.steady_state(1.0))  # insulin and its effects at rest are in proportion to it
    scale = dict(zip(STATE_NAMES, per_infusion / per_infusion[STATE_NAMES.index("I")], strict=True))
    for name in ("S1", "S2", "I", "x1", "x2", "x3"):
        assert Q[name] == pytest.approx(9.0 * scale[name] ** 2)
    assert Q["IG"] == pytest.approx(4.0 / 18.016**2)
    assert Q["Q1"] == Q["Q2"] == pytest.approx(4.0 * (0.16 * 75.0 / 18.016) ** 2)


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


# a day


DAY = Scenario([Meal(45.0, 407.3, 15.0), Meal(70.0, 733.1, 25.0), Meal(60.0, 1080.7, 20.0)], 1440.0)


def day_of_doses(patient):
    """Basal, a bolus over a sample for each meal, the last one much too large, and an hour without insulin."""
    rates = np.full(288, float(patient.basal_insulin_mU_min))
    for t, bolus in ((405, 0.8), (730, 1.5), (1080, 9.0)):
        rates[t // 5] += bolus * 1000.0 / 5.0
    rates[240:252] = 0.0
    return rates


@pytest.fixture(scope="module", params=EVERYBODY, ids=["nominal", "another", "nominal of 2010", "another of 2010"])
def day(request, script, open_pump):
    """A person, and the day by the adaptive integrator."""
    patient = person(request.param)
    doses = day_of_doses(patient)

    def live(integrator):
        return simulate(patient, script(doses), pump=open_pump, scenario=DAY, integrator=integrator)

    return request.param, patient, doses, live, live(Adaptive(1e-11))


def gut_by_hand(p, D, eaten_mg_min):
    """Rates of change of the two compartments in mmol, and the appearance in mg/min."""
    D1, D2 = D
    rates = p["A_G"] * eaten_mg_min / 180.16 - D1 / p["t_maxG"], D1 / p["t_maxG"] - D2 / p["t_maxG"]
    return np.array(rates), D2 / p["t_maxG"] * 180.16


@pytest.mark.long
def test_a_day_is_that_of_the_transcription_by_scipy(day):
    """Eleven states: those of the person and the two compartments of the gut."""
    constants, patient, doses, _, trace = day
    changes = [meal.t_min + after for meal in DAY.meals for after in (0.0, meal.eating_min)]
    x = np.append(np.asarray(patient.steady_state(patient.basal_insulin_mU_min))[TO_HAND], [0.0, 0.0])
    glucose = [120.0]
    for start, end in itertools.pairwise(np.unique(np.r_[changes, np.arange(0.0, 1445.0, 5.0)])):
        u = doses[int(start // 5.0)]
        eaten = sum(
            1000.0 * meal.carbs_g / meal.eating_min
            for meal in DAY.meals
            if meal.t_min <= start < meal.t_min + meal.eating_min - 1e-9
        )

        def rates(t, x, u=u, eaten=eaten):
            of_gut, appearing = gut_by_hand(constants, x[9:], eaten)
            return np.append(by_hand(constants, x[:9], u, appearing), of_gut)

        x = scipy.integrate.solve_ivp(rates, (start, end), x, method="DOP853", rtol=1e-10, atol=1e-10).y[:, -1]
        if end % 5.0 == 0.0:
            glucose.append(x[6] / (constants["V_G"] * constants["weight_kg"]) * 18.016)
    ours = np.append(trace.glucose_mg_dl, patient.glucose_mg_dl(trace.states[-1]))
    np.testing.assert_allclose(ours, glucose, rtol=0.0, atol=1e-6)
    np.testing.assert_allclose(np.asarray(trace.states[-1])[TO_HAND], x[:9], rtol=1e-7)
    assert constants["renal_threshold"] * 18.1 < max(glucose)
    if "uptake_half" not in constants:
        assert min(glucose) < 4.5 * 18.0  # both thresholds are crossed
        assert np.max(trace.states[:, STATE_NAMES.index("x3")]) > 1.0  # and production stops


@pytest.mark.long
@pytest.mark.parametrize(("substeps", "tolerance"), [(1, 0.05), (6, 1e-3)])
def test_the_exponential_integrator_is_as_exact_as_told(day, substeps, tolerance):
    """Glucose that crosses a threshold within a step limits the order to the second."""
    *_, live, reference = day
    trace = live(Exponential(substeps=substeps))
    np.testing.assert_allclose(trace.fine_glucose_mg_dl, reference.fine_glucose_mg_dl, rtol=0.0, atol=tolerance)
    np.testing.assert_allclose(trace.states[:, 3:], reference.states[:, 3:], rtol=1e-8, atol=1e-12)
