"""Glucagon that is infused: closed forms, mass balance, a published response, and nothing else changed."""

import math
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import glucoloop as gl
from given_glucagon import GivenGlucagon
from glucoloop.patients import Inputs
from glucoloop.patients.hovorka import glucagon
from glucoloop.pumps import GlucagonLimits, LimitedPump
from glucoloop.refusal import Refusal
from glucoloop.simulation import Adaptive, Explicit
from glucoloop.simulation.user_objects import goes_fast

WEIGHT_KG, TAU_MIN, CLEARANCE_L_KG_MIN = 74.9, 19.0, 0.012
MMOL_L = 18.0156
PAGE = Path(__file__).parents[2] / "docs/guide/glucagon.md"


def pump(patient, largest_ug=1e4):
    return LimitedPump(limits=gl.usual_limits(patient), glucagon=GlucagonLimits(max_ug=largest_ug, step_ug=0.01))


def course(patient, glucagon_ug, at=0, horizon_min=300.0, start_mg_dl=None, integrator=None):
    insulin = patient.basal_insulin_mU_min if start_mg_dl is None else patient.insulin_for(start_mg_dl)
    scenario = gl.Scenario([], horizon_min, initial_glucose_mg_dl=start_mg_dl, allow_unusual=True)
    controller = GivenGlucagon(insulin_mU_min=insulin, glucagon_ug=glucagon_ug, at=at)
    return gl.simulate(patient, controller, pump=pump(patient), scenario=scenario, integrator=integrator)


def plasma_pg_ml(t_min, dose_mg):
    """The sum of boluses of the McGill Diabetes Lab, over doses so small and many that they are even over 5 min."""
    begins = (np.arange(5000) + 0.5) / 1000.0
    since = np.maximum(t_min - begins, 0.0)
    each = 1e6 / (WEIGHT_KG * CLEARANCE_L_KG_MIN) * dose_mg / begins.size
    return np.sum(each * since * np.exp(-since / TAU_MIN) / TAU_MIN**2)


@pytest.fixture(scope="module")
def subcutaneous():
    return gl.patient("wilinska-2010-glucagon")


@pytest.mark.long
def test_plasma_glucagon_is_the_closed_form_of_its_source(subcutaneous):
    trace = course(subcutaneous, 100.0)
    depot_ug = np.asarray(trace.states)[:, 10]
    plasma = 1000.0 * depot_ug / (TAU_MIN * CLEARANCE_L_KG_MIN * WEIGHT_KG)
    expected = [plasma_pg_ml(t, 0.1) for t in np.append(trace.t_min, 300.0)]
    np.testing.assert_allclose(plasma, expected, rtol=2e-5, atol=1e-6 * max(expected))


@pytest.mark.parametrize("name", ["parker-1999", "wilinska-2010-glucagon"])
def test_glucagon_that_was_infused_is_in_the_body_or_was_cleared(name):
    patient, dose_ug = gl.patient(name), 40.0
    x = np.asarray(patient.steady_state(patient.basal_insulin_mU_min), float)

    @jax.jit
    def rates(x, rate):
        inputs = Inputs(insulin_mU_min=patient.basal_insulin_mU_min, meal_mg_min=jnp.asarray(0.0), glucagon_ug_min=rate)
        return patient.derivative(jnp.asarray(0.0), x, inputs)

    def released_and_cleared_ug_min(x):
        if name == "parker-1999":  # as in the table of Parker et al.: 0.91 l/min of 9.93 l, in multiples of 60 pg/ml
            whole = 9.93 * 60.0 / 1000.0
            of_insulin = 1.3102 - 0.61016 * math.tanh(1.0571 * (x[9] / 15.15 - 0.46981))
            of_glucose = 2.9285 - 2.095 * math.tanh(4.18 * (x[2] / 91.89 - 0.6191))
            return 0.0916 * whole * of_insulin * of_glucose, 0.0916 * whole * x[17]
        return 0.0, x[10] / TAU_MIN

    def held_ug(x):
        return 9.93 * 60.0 / 1000.0 * x[17] if name == "parker-1999" else x[9] + x[10]

    def both(t, state):
        released, cleared = released_and_cleared_ug_min(state[:-2])
        rate = dose_ug / 5.0 if t < 5.0 else 0.0
        return np.append(np.asarray(rates(state[:-2], rate)), [released, cleared])

    state = np.append(x, [0.0, 0.0])
    for span in ((0.0, 5.0 - 1e-12), (5.0, 120.0)):
        state = solve_ivp(both, span, state, rtol=1e-9, atol=1e-10, max_step=1.0).y[:, -1]
    released, cleared = state[-2:]
    assert cleared > 5.0
    assert held_ug(state) - held_ug(x) + cleared - released == pytest.approx(dose_ug, abs=1e-5)


@pytest.mark.long
def test_the_loop_gives_what_the_pump_says(subcutaneous):
    trace = course(subcutaneous, 33.337, at=3, horizon_min=60.0)
    given = np.asarray(trace.glucagon_ug)
    assert np.flatnonzero(given).tolist() == [3]
    assert given[3] == pytest.approx(33.33)
    assert float(trace.command_glucagon_ug[3]) == pytest.approx(33.337)
    depots = np.asarray(trace.states)[:, 9:]
    assert np.all(depots[:4] == 0.0)
    entered = depots[4].sum() + np.trapezoid(np.linspace(0.0, depots[4, 1], 50), dx=5.0 / 49.0) / TAU_MIN
    assert entered == pytest.approx(33.33, rel=0.01)
    frame = trace.to_polars()
    assert frame["glucagon_ug"].to_list() == pytest.approx(given.tolist())


@pytest.mark.long
@pytest.mark.parametrize("name", ["parker-1999", "wilinska-2010-glucagon"])
def test_the_explicit_integrator_is_the_adaptive_one(name):
    patient = gl.patient(name)
    default, fine, truth = (
        np.asarray(course(patient, 20.0, at=2, horizon_min=120.0, integrator=of).fine_glucose_mg_dl)
        for of in (None, Explicit(8), Adaptive(1e-11))
    )
    assert np.abs(default - truth).max() < 0.02
    assert np.abs(fine - truth).max() < 1e-4
    assert np.ptp(truth) > 5.0


@pytest.mark.long
def test_without_glucagon_the_extension_is_the_patient_that_it_extends(subcutaneous):
    plain = gl.patient("wilinska-2010")
    scenario = gl.Scenario([gl.Meal(60.0, 50.0)], 300.0)
    both = []
    for patient in (subcutaneous, plain):
        basal = gl.design_open_loop(patient.basal_insulin_mU_min, gl.usual_limits(patient))
        both.append(np.asarray(gl.simulate(patient, basal, scenario=scenario).fine_glucose_mg_dl))
    assert goes_fast(subcutaneous)
    np.testing.assert_allclose(*both, rtol=0.0, atol=1e-9)


def rates_at(patient, x, glucagon_ug_min):
    inputs = Inputs(insulin_mU_min=jnp.asarray(9.0), meal_mg_min=jnp.asarray(2.0), glucagon_ug_min=glucagon_ug_min)
    return patient.derivative(jnp.asarray(0.0), x, inputs)


def test_no_infusion_is_an_infusion_of_zero():
    for name in ("parker-1999", "wilinska-2010-glucagon"):
        patient = gl.patient(name)
        x = patient.steady_state(patient.basal_insulin_mU_min) * 1.1
        np.testing.assert_array_equal(rates_at(patient, x, None), rates_at(patient, x, jnp.asarray(0.0)))


@pytest.mark.long
def test_a_gradient_at_no_glucagon_is_finite(subcutaneous):
    x = subcutaneous.steady_state(10.0)
    jacobian = np.asarray(jax.jacfwd(lambda x: rates_at(subcutaneous, x, None))(x))
    assert np.all(np.isfinite(jacobian))
    assert np.all(jacobian[0, 9:] == 0.0)


def test_a_patient_without_glucagon_refuses_it():
    patient = gl.patient("hovorka-2004")
    with pytest.raises(Refusal, match="have no infusion of glucagon"):
        course(patient, 10.0)


def rise_mmol_l(patient, start_mmol_l, dose_ug):
    """Largest rise of glucose above the start, and its time, and the time of the largest plasma glucagon."""
    trace = course(patient, dose_ug, start_mg_dl=start_mmol_l * MMOL_L)
    glucose, depot = np.asarray(trace.fine_glucose_mg_dl), np.asarray(trace.states)[:, 10]
    peak = int(np.argmax(glucose))
    return (glucose[peak] - glucose[0]) / MMOL_L, float(trace.fine_t_min[peak]), 5.0 * int(np.argmax(depot))


@pytest.mark.long
def test_published_responses(subcutaneous):
    """Blauw et al. (2016): the range of medians. What is outside is so by what the page says of it."""
    for start in (8.0, 6.0, 4.0):
        for dose_ug in (220.0, 440.0):
            rise, _, to_glucagon = rise_mmol_l(subcutaneous, start, dose_ug)
            assert 2.6 <= rise <= 6.2, (start, dose_ug)
            assert 10.0 <= to_glucagon <= 20.0
    lowest, _, _ = rise_mmol_l(subcutaneous, 8.0, 110.0)
    assert f"{lowest:.2f} mmol/l" in PAGE.read_text()


@pytest.mark.long
def test_rises_of_fasting_people_and_of_people_with_insulin(subcutaneous):
    """Haymond et al. (2016), means: near them for fasting people, and above them where insulin acts."""
    rows = []
    for dose_ug, (fasting, with_insulin) in {75.0: (33, 19), 150.0: (64, 24), 300.0: (95, 43)}.items():
        high, low = (rise_mmol_l(subcutaneous, start / MMOL_L, dose_ug)[0] * MMOL_L for start in (110.0, 70.0))
        rows.append(f"| {dose_ug:.0f} | {fasting} | {high:.1f} | {with_insulin} | {low:.1f} |")
        assert abs(high / fasting - 1.0) < 0.2
        assert low > 1.5 * with_insulin
    assert "\n".join(rows) in PAGE.read_text()


@pytest.mark.long
def test_production_in_an_hour(subcutaneous):
    """El Youssef et al. (2014): within the printed spread at little insulin, and not at much."""
    parts = []
    for dose_ug, (low, high) in {25.0: ((5, 68), (19, 53)), 175.0: ((112, 152), (26, 38))}.items():
        trace = course(subcutaneous, dose_ug, start_mg_dl=100.0, horizon_min=60.0)
        rates = glucagon.production(glucagon.MCGILL_2020, jnp.asarray(trace.states[:, 9:11].T))
        produced = np.trapezoid(np.asarray(rates), dx=5.0) * 10.0 * MMOL_L / WEIGHT_KG
        assert abs(produced - low[0]) <= low[1]
        assert (abs(produced - high[0]) <= high[1]) == (dose_ug == 25.0)
        parts.append(f"{produced:.0f}")
    assert f"inside with {' and '.join(parts)};" in PAGE.read_text()
