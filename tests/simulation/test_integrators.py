import itertools
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate
from hypothesis import given
from hypothesis import strategies as st

from glucoloop._pytree import pytree
from glucoloop.control import MPCTuning, design_linear_mpc
from glucoloop.meals import Meal, Scenario
from glucoloop.patients import Patient, SemilinearPatient
from glucoloop.simulation import Adaptive, Exponential, simulate
from glucoloop.simulation.exponential import substeps_for
from glucoloop.simulation.plant import SampleGrid

KNOWN = {100: 96.8476163, 200: 148.431132, 300: 115.816276, 600: 82.0380888}
VARYING = 25.6 + 14.0 * np.sin(np.arange(72) / 3.0)
VARIED = Scenario([Meal(20.0, 17.3), Meal(7.0, 101.9), Meal(60.0, 190.4)], 360.0)


@pytest.mark.long
@pytest.mark.parametrize(
    ("integrator", "tolerance"),
    [(Adaptive(1e-11), 5.1e-7), (Exponential(), 1e-3)],  # the digits given; a thousandth of a mg/dl
    ids=["adaptive", "exponential"],
)
def test_a_meal_without_control(patient_81, script, integrator, tolerance):
    trace = simulate(patient_81, script(patient_81.basal_insulin_mU_min), integrator=integrator)
    found = [float(trace.fine_glucose_mg_dl[t]) for t in KNOWN]
    np.testing.assert_allclose(found, list(KNOWN.values()), rtol=0.0, atol=tolerance)


@pytest.fixture(scope="module")
def varied(patient_81, script):
    """Changing insulin and three meals, by the adaptive method."""
    return simulate(patient_81, script(VARYING), scenario=VARIED, integrator=Adaptive(1e-12))


@pytest.mark.long
def test_adaptive_is_scipys_solver_from_kink_to_kink(patient_81, varied, sorensen_by_hand, meal_by_hand):
    def eaten(t):
        small = [0.0, 7000.0 / 360.0, 2 * 7000.0 / 360.0]  # two ramps of 19.4 min, no plateau
        gut = [60.0 * max(z, 0.0) - 3600.0 * -np.expm1(-max(z, 0.0) / 60.0) for z in (t - 101.9 - k for k in small)]
        triangle = 360.0 / small[1] / 60.0 * (gut[0] - 2.0 * gut[1] + gut[2])
        return meal_by_hand(t, 20.0, 17.3) + triangle

    kinks = [17.3, 47.3, 17.3 + 20000 / 360, 47.3 + 20000 / 360, 101.9, 101.9 + 7000 / 360, 101.9 + 14000 / 360]
    x = np.asarray(patient_81.steady_state(patient_81.basal_insulin_mU_min))
    for start, end in itertools.pairwise(np.unique(np.r_[kinks, np.arange(0.0, 155.0, 5.0)])):
        u = VARYING[int(start // 5.0)]
        x = scipy.integrate.solve_ivp(
            lambda t, x, u=u: sorensen_by_hand(x, u, eaten(t)), (start, end), x, method="DOP853", rtol=1e-10, atol=1e-10
        ).y[:, -1]
    np.testing.assert_allclose(varied.states[30], x, rtol=2e-8)


@pytest.mark.long
def test_exponential_is_of_fourth_order(patient_81, script):
    rates, scenario = 25.6 + 5.0 * np.sin(np.arange(72) / 12.0), Scenario([Meal(20.0, 17.3)], 360.0)
    reference = simulate(patient_81, script(rates), scenario=scenario, integrator=Adaptive(1e-12))
    errors = []
    for substeps in (1, 2, 4, 8):
        integrator = Exponential(substeps=substeps, near_rest=True)
        trace = simulate(patient_81, script(rates), scenario=scenario, integrator=integrator)
        errors.append(np.abs(np.asarray(trace.glucose_mg_dl - reference.glucose_mg_dl)).max())
    orders = np.log2(np.array(errors[:-1]) / np.array(errors[1:]))
    assert np.all(orders >= 3.5), (errors, orders)


@pytest.mark.long
def test_exponential_is_exact_enough_when_insulin_jumps(patient_81, script, varied):
    """Insulin peaks within a minute of a jump, so that the order is only reached with short steps."""
    errors = []
    for substeps in (1, 4, 8):
        integrator = Exponential(substeps=substeps, near_rest=True)
        trace = simulate(patient_81, script(VARYING), scenario=VARIED, integrator=integrator)
        errors.append(np.abs(np.asarray(trace.glucose_mg_dl - varied.glucose_mg_dl)).max())
    assert errors[0] < 1e-3
    assert errors[1] < 1e-5
    assert errors[1] / errors[2] > 2.0**3.5


@pytest.mark.parametrize(("sample_time_min", "steps"), [(1.0, 1), (5.0, 1), (10.0, 2), (15.0, 3), (30.0, 6)])
def test_steps_of_a_sample_are_chosen_from_its_length(sample_time_min, steps):
    grid = SampleGrid(sample_time_min=sample_time_min, samples=1)
    assert Exponential().steps_of(grid) == steps
    assert Exponential(substeps=5).steps_of(grid) == 5


@given(sample_time_min=st.floats(0.5, 60.0), accuracy_mg_dl=st.floats(1e-4, 1.0))
def test_a_finer_accuracy_or_a_longer_sample_takes_more_steps(sample_time_min, accuracy_mg_dl):
    steps = substeps_for(sample_time_min, accuracy_mg_dl)
    assert 1 <= steps <= substeps_for(sample_time_min, accuracy_mg_dl / 2.0)
    assert steps <= substeps_for(2.0 * sample_time_min, accuracy_mg_dl)


@pytest.mark.parametrize("accuracy_mg_dl", [0.0, -1.0, np.inf, np.nan])
def test_an_accuracy_that_is_not_possible_is_refused(accuracy_mg_dl):
    with pytest.raises(ValueError, match="give a finite number above 0"):
        Exponential(accuracy_mg_dl=accuracy_mg_dl)


@pytest.mark.long
def test_rough_insulin_is_carried_as_accurately_as_asked(patient_81, script):
    rates = np.where(np.random.default_rng(3).random(24) < 0.5, 0.0, 50.0)
    scenario = Scenario([Meal(20.0, 17.3)], 360.0)
    every_15_min = replace(script(rates), sample_time_min=15.0)
    truth = simulate(patient_81, every_15_min, scenario=scenario, integrator=Adaptive(1e-10))
    errors = {}
    for integrator in (Exponential(substeps=1), Exponential(), Exponential(accuracy_mg_dl=1e-3)):
        trace = simulate(patient_81, every_15_min, scenario=scenario, integrator=integrator)
        errors[integrator] = float(np.abs(np.asarray(trace.glucose_mg_dl - truth.glucose_mg_dl)).max())
    one, usual, fine = errors.values()
    assert one > 0.1
    assert usual < 0.06
    assert fine < 1e-3


@pytest.mark.long
def test_glucose_between_samples_is_as_good_as_at_them(patient_81, script, varied):
    trace = simulate(patient_81, script(VARYING), scenario=VARIED, integrator=Exponential(substeps=4))
    np.testing.assert_allclose(trace.fine_glucose_mg_dl, varied.fine_glucose_mg_dl, rtol=0.0, atol=1e-3)


@pytest.mark.long
def test_exponential_carries_insulin_exactly(patient_81, script, varied):
    trace = simulate(patient_81, script(VARYING), scenario=VARIED)
    np.testing.assert_allclose(trace.states[:, 8:15], varied.states[:, 8:15], rtol=1e-9)


@pytest.mark.parametrize("tuning", [MPCTuning(2, 8, 1.0, 0.0), MPCTuning(2, 10, 3.0, 1.0)], ids=["noise-free", "noisy"])
@pytest.mark.long
def test_a_day_under_control(patient_81, identified_81, tuning):
    """Large meals, so that insulin is at its limit for hours and glucose falls to 60 mg/dl."""
    controller = design_linear_mpc(identified_81.model, tuning)
    day = Scenario([Meal(60.0, 407.3), Meal(80.0, 733.1), Meal(70.0, 1080.7)], 1440.0)
    fast = simulate(patient_81, controller, scenario=day)
    reference = simulate(patient_81, controller, scenario=day, integrator=Adaptive(1e-10))
    assert np.ptp(np.asarray(reference.insulin_mU_min)) > 20.0
    np.testing.assert_allclose(fast.fine_glucose_mg_dl, reference.fine_glucose_mg_dl, rtol=0.0, atol=1e-3)


@pytree
class OneCompartment:
    """``G' = -k (G - 100) - s (u - 20) + meal / V``; nothing but what `Patient` asks for."""

    k: float = 0.02
    s: float = 0.1
    V: float = 50.0

    @property
    def basal_insulin_mU_min(self):
        return jnp.asarray(20.0)

    @property
    def setpoint_mg_dl(self):
        return jnp.asarray(100.0)

    def steady_state(self, insulin_mU_min):
        return jnp.asarray([100.0 - self.s / self.k * (insulin_mU_min - 20.0)])

    def insulin_for(self, glucose_mg_dl):
        return 20.0 - self.k / self.s * (glucose_mg_dl - 100.0)

    def derivative(self, t_min, x, inputs):
        del t_min
        return -self.k * (x - 100.0) - self.s * (inputs.insulin_mU_min - 20.0) + inputs.meal_mg_min / self.V

    def glucose_mg_dl(self, x):
        return x[0]


def test_a_patient_without_a_linear_block_runs_and_matches_his_closed_form(script):
    person = OneCompartment()
    assert isinstance(person, Patient)
    assert not isinstance(person, SemilinearPatient)
    trace = simulate(person, script([20.0, 30.0, 14.0]), scenario=Scenario([], 60.0))

    G, truth = 100.0, [100.0]
    for u in (20.0, 30.0, *[14.0] * 10):
        rest = 100.0 - 5.0 * (u - 20.0)
        truth += [rest + (G - rest) * np.exp(-0.02 * t) for t in (1.0, 2.0, 3.0, 4.0, 5.0)]
        G = truth[-1]
    np.testing.assert_allclose(trace.fine_glucose_mg_dl, truth, rtol=1e-8)


@pytest.mark.long
def test_his_meal_is_its_convolution(script, meal_by_hand):
    trace = simulate(OneCompartment(), script(20.0), scenario=Scenario([Meal(15.0, 11.7)], 150.0))
    kinks = [11.7, 41.7, 11.7 + 15000 / 360, 41.7 + 15000 / 360]
    for end in (60.0, 150.0):
        rise, _ = scipy.integrate.quad(
            lambda t, end=end: np.exp(-0.02 * (end - t)) * meal_by_hand(t, 15.0, 11.7) / 50.0,
            0.0,
            end,
            points=[kink for kink in kinks if kink < end],
        )
        assert float(trace.fine_glucose_mg_dl[int(end)]) == pytest.approx(100.0 + rise, rel=1e-8)


def test_the_exponential_integrator_refuses_him(script):
    with pytest.raises(TypeError, match=r"OneCompartment has no linear driven block; use Explicit\(\) or Adaptive\(\)"):
        simulate(OneCompartment(), script(20.0), integrator=Exponential())
