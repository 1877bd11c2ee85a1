"""Families with exercise: rest and exercise in closed form, SciPy with switches and resets, and what is published."""

import itertools

import numpy as np
import pytest
import scipy.integrate

import glucoloop as gl
from glucoloop.patients.mcgill2020 import GLUCOSE_MG_DL, McGillPatient
from glucoloop.patients.roy_parker2007 import RoyParkerPatient
from glucoloop.simulation import Adaptive

FAMILIES = {"roy-parker-2007": RoyParkerPatient, "mcgill-2020": McGillPatient}


def course(patient, bouts, horizon_min, insulin_mU_min=None, integrator=None):
    """States of a patient at the basal rate, every five minutes, and glucose every minute."""
    insulin = float(patient.basal_insulin_mU_min) if insulin_mU_min is None else insulin_mU_min
    scenario = gl.Scenario([], horizon_min, exercise=[gl.Exercise(*bout) for bout in bouts])
    controller = gl.design_open_loop(insulin, gl.usual_limits(patient))
    trace = gl.simulate(patient, controller, scenario=scenario, integrator=integrator)
    return np.asarray(trace.states), np.asarray(trace.fine_glucose_mg_dl)


def integrated(rates, x, bouts, horizon_min, reset):
    """States at the ends of bouts and of the run, by SciPy; `reset` changes the state where a bout ends."""
    edges = sorted({0.0, horizon_min, *(t for u, start, lasts in bouts for t in (start, start + lasts))})
    minutes, glucose = np.arange(horizon_min + 1.0), []
    for start, end in itertools.pairwise(edges):
        u = max([level for level, begins, lasts in bouts if begins <= start < begins + lasts], default=0.0)
        x = reset(x) if u == 0.0 else x
        inside = minutes[(minutes >= start) & (minutes < end)]
        found = scipy.integrate.solve_ivp(
            lambda t, x, u=u: rates(x, u), (start, end), x, t_eval=[*inside, end], rtol=1e-10, atol=1e-11, max_step=0.2
        ).y
        glucose.append(found[0, :-1])
        x = found[:, -1]
    return np.append(np.concatenate(glucose), x[0])


def roy_parker(u_1):
    """The equations as the paper prints them, with its switch."""

    def rates(x, u):
        G, X, I, V, P, U, E, L, A = x
        I_b = 0.098 * 1000.0 / 60.0 / 0.142
        lost = (0.0108 if A >= -1.1521 * u * u + 87.471 * u else 0.0) if u > 0.0 else -L / 6.0
        return [
            -0.035 * (G - 100.0) - X * G + 70.0 / 117.0 * (P - L - U),
            -0.05 * X + 2.8e-5 * (I - I_b),
            -0.142 * I + 0.098 * u_1 - E,
            -0.8 * V + 0.8 * u,
            0.00158 * V - 0.056 * P,
            0.00195 * V - 0.0485 * U,
            0.00125 * V - 0.075 * E,
            lost,
            u,
        ]

    return rates


@pytest.mark.long
@pytest.mark.parametrize(
    "bouts",
    [[(40.0, 60.0, 60.0)], [(60.0, 30.0, 120.0)], [(30.0, 20.0, 40.0), (70.0, 75.0, 60.0)], [(90.0, 10.0, 30.0)]],
)
def test_roy_and_parker_are_the_printed_equations(bouts):
    patient = gl.patient("roy-parker-2007")
    _, glucose = course(patient, bouts, 300.0)
    x = np.asarray(patient.steady_state(patient.basal_insulin_mU_min))
    truth = integrated(roy_parker(1000.0 / 60.0), x, bouts, 300.0, lambda x: np.append(x[:-1], 0.0))
    assert np.ptp(truth) > 1.0
    np.testing.assert_allclose(glucose, truth, rtol=0.0, atol=0.01)


def test_the_linear_states_of_roy_and_parker_are_closed_forms():
    u, since = 50.0, 5.0 * np.arange(19)
    states, _ = course(gl.patient("roy-parker-2007"), [(u, 0.0, 1440.0)], 90.0)
    V = u * (1.0 - np.exp(-0.8 * since))
    np.testing.assert_allclose(states[:, 3], V, atol=2e-3)
    for row, gain, rate in ((4, 0.00158, 0.056), (5, 0.00195, 0.0485), (6, 0.00125, 0.075)):
        answer = (
            gain
            * u
            * ((1.0 - np.exp(-rate * since)) / rate - (np.exp(-rate * since) - np.exp(-0.8 * since)) / (0.8 - rate))
        )
        np.testing.assert_allclose(states[:, row], answer, atol=2e-4)
    np.testing.assert_allclose(states[:, 8], u * since, rtol=1e-12, atol=1e-11)  # it rests at 1e-12
    begins = -1.1521 * u + 87.471  # A_TH / u
    np.testing.assert_allclose(
        states[since > begins + 2.0, 7], 0.0108 * (since[since > begins + 2.0] - begins), rtol=1e-3
    )
    assert np.all(states[since < begins - 2.0, 7] < 1e-11)


def test_roy_and_parker_rest_in_closed_form():
    for glucose in (60.0, 100.0, 120.0):
        person = RoyParkerPatient.resting_at(glucose)
        X = 0.035 * (100.0 - glucose) / glucose
        insulin = (0.098 * 1000.0 / 60.0 / 0.142) + 0.05 / 2.8e-5 * X
        assert float(person.basal_insulin_mU_min) == pytest.approx(insulin * 0.142 / 0.098, rel=1e-9)
    with pytest.raises(ValueError, match="no insulin infusion holds glucose at 130 mg/dl"):
        RoyParkerPatient.resting_at(130.0)


@pytest.mark.long
def test_moderate_exercise_lowers_glucose_and_long_exercise_depletes_the_liver():
    patient = gl.patient("roy-parker-2007")
    _, moderate = course(patient, [(40.0, 60.0, 40.0)], 360.0)
    _, long = course(patient, [(40.0, 60.0, 180.0)], 360.0)
    assert np.all(np.diff(moderate[70:100]) < 0.0)
    assert 1.0 < 100.0 - moderate.min() < 6.0
    assert abs(moderate[-1] - 100.0) < 0.5
    # the fall in the last hour of long exercise is that of production, which falls by k every minute
    slope = (long[240] - long[180]) / 60.0
    assert slope < 3.0 * (moderate[100] - moderate[60]) / 60.0 < 0.0
    states, _ = course(patient, [(60.0, 60.0, 60.0)], 120.0)
    assert states[-1, 2] < states[0, 2] - 3.0  # insulin falls in exercise


@pytest.mark.long
@pytest.mark.parametrize("name", FAMILIES)
def test_no_state_becomes_subnormal_in_days_of_rest(name):
    states, _ = course(gl.patient(name), [(60.0, 30.0, 60.0)], 2880.0)
    fading = states[-1][3:] if name == "roy-parker-2007" else states[-1][5:]
    assert np.all((fading > 1e-16) & (fading < 1e-9))


def test_no_insulin_falls_below_zero_in_exercise_without_any():
    states, _ = course(gl.patient("roy-parker-2007"), [(90.0, 60.0, 120.0)], 240.0, insulin_mU_min=0.0)
    assert states[:, 2].min() >= -1e-9
    assert states[24:, 2].max() < 1e-3


def mcgill(u_1, basal):
    """The equations in mmol/l and U, as the program writes them."""
    Ip0 = 1e3 * (basal / 60.0) / (0.02 * 70.0)
    Gb = 6.5 * (1.0 + (5e-5 / 0.075) * Ip0 / 0.001)

    def rates(x, u):
        Gp, Xa, sub, plas, dur = x
        Ip = 1e3 * plas / (0.02 * 70.0) / 70.0
        more = 1.0 + 2.0 * (u / 100.0 + dur) if u > 0.0 else 1.0
        return [
            -0.001 * (1.0 + 2.0 * u / 100.0) * Gp - Xa * Gp + 0.001 * Gb,
            -0.075 * Xa + more * 5e-5 * Ip,
            -sub / 70.0 + u_1 / 60.0,
            -plas / 70.0 + sub / 70.0,
            1.0 / 60.0 if u > 0.0 else 0.0,
        ]

    return rates


@pytest.mark.long
@pytest.mark.parametrize("bouts", [[(30.0, 30.0, 90.0)], [(70.0, 60.0, 60.0), (20.0, 150.0, 30.0)]])
def test_the_person_of_mcgill_is_the_programs(bouts):
    basal = 0.53 * 70.0 * 0.48 / 24.0
    patient = gl.patient("mcgill-2020")
    assert 60e-3 * float(patient.basal_insulin_mU_min) == pytest.approx(basal, rel=1e-9)
    assert float(patient.setpoint_mg_dl) == pytest.approx(6.5 * 18.0156)
    _, glucose = course(patient, bouts, 300.0)
    x = [6.5, (5e-5 / 0.075) * 1e3 * (basal / 60.0) / 1.4, 70.0 * basal / 60.0, 70.0 * basal / 60.0, 0.0]
    truth = integrated(mcgill(basal, basal), x, bouts, 300.0, lambda x: np.append(x[:-1], 0.0))
    assert np.ptp(truth) > 1.5
    np.testing.assert_allclose(glucose / 18.0156, truth, rtol=0.0, atol=1e-3)


def test_the_person_of_mcgill_has_the_printed_therapy():
    # insulin sensitivity factor 3.0 mmol/l/u and carbohydrate ratio 9.5 g/u
    person = gl.patient("mcgill-2020")
    c = person.parameters
    correction = 1e3 / (c["MCR"] * c["weight_kg"]) * c["P_3"] / c["P_2"] * GLUCOSE_MG_DL / 18.0156
    assert correction == pytest.approx(3.0, abs=0.11)
    rise_mmol_l_per_g = c["A_G"] * 1000.0 / (c["weight_kg"] * c["V_G"]) / 18.0156
    assert correction / rise_mmol_l_per_g == pytest.approx(9.5, abs=0.31)


@pytest.mark.long
@pytest.mark.parametrize("name", FAMILIES)
def test_glucose_is_conserved_in_exercise(name):
    # a meal of 40 g beside exercise, and the same without: what appears raises the pool by as much as is not taken up
    patient = gl.patient(name)
    basal = float(patient.basal_insulin_mU_min)
    bouts = [gl.Exercise(50.0, 60.0, 45.0)]
    scenario = gl.Scenario([gl.Meal(40.0, 30.0)], 720.0, exercise=bouts)
    trace = gl.simulate(patient, gl.design_open_loop(basal, gl.usual_limits(patient)), scenario=scenario)
    fasting, _ = course(patient, [(50.0, 60.0, 45.0)], 720.0)
    more = np.asarray(trace.states)[:, 0] - fasting[:, 0]
    assert more.max() > 20.0
    c = patient.parameters
    volume = float(c["V_G"] if name == "roy-parker-2007" else c["V_G"] * c["weight_kg"])
    taken = np.asarray(trace.states)[:, 1]
    rate = c.get("p_1", c.get("P_1")) * np.ones_like(more)
    if name == "mcgill-2020":
        t = 5.0 * np.arange(more.size)
        rate = rate * (1.0 + 2.0 * 0.5 * ((t >= 60.0) & (t < 105.0)))
    left = scipy.integrate.trapezoid((rate + taken) * more, dx=5.0) * volume + more[-1] * volume
    share = 0.8 if name == "mcgill-2020" else 1.0
    assert left == pytest.approx(share * 40_000.0, rel=0.01)


@pytest.mark.long
@pytest.mark.parametrize("name", FAMILIES)
def test_the_explicit_integrator_is_the_adaptive_one(name):
    bouts = [(20.0, 10.5, 30.0), (75.0, 33.0, 60.0), (50.0, 200.0, 90.0)]
    explicit, truth = (course(gl.patient(name), bouts, 420.0, integrator=by)[1] for by in (None, Adaptive(1e-11)))
    np.testing.assert_allclose(explicit, truth, rtol=0.0, atol=1e-3)


@pytest.mark.long
@pytest.mark.parametrize("name", FAMILIES)
def test_a_controller_is_designed_and_holds_glucose_in_exercise(name):
    patient = gl.patient(name)
    controller = gl.design_linear_mpc(gl.identify(patient).model, limits=gl.usual_limits(patient))
    scenario = gl.Scenario([], 360.0, exercise=[gl.Exercise(30.0, 60.0, 30.0)])
    controlled = np.asarray(gl.simulate(patient, controller, scenario=scenario).fine_glucose_mg_dl)
    _, held = course(patient, [(30.0, 60.0, 30.0)], 360.0)
    setpoint = float(patient.setpoint_mg_dl)
    assert setpoint - held.min() > 1.0
    assert np.sum((controlled - setpoint) ** 2) < np.sum((held - setpoint) ** 2)
