import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg
import scipy.optimize
from hypothesis import given, settings
from hypothesis import strategies as st

from glucoloop.patients import Inputs, Patient, SemilinearPatient, at_basal, at_setpoint, patient
from glucoloop.patients.sorensen import equations as sorensen
from glucoloop.patients.sorensen.equations import Sigmoid, SorensenParameters
from glucoloop.patients.sorensen.parker1999 import PARKER_1999
from glucoloop.patients.sorensen.rest import rest_under

STEADY = {0: 190.831408, 5: 160.002098, 20: 100.421044, 25: 83.0455178, 30: 67.8321106, 40: 23.3968922}


@pytest.fixture(scope="module")
def linear(patient_81):
    """A, B and C at the basal state."""
    x, u = patient_81.steady_state(patient_81.basal_insulin_mU_min), patient_81.basal_insulin_mU_min

    def f(x, u):
        return patient_81.derivative(jnp.zeros(()), x, Inputs(insulin_mU_min=u, meal_mg_min=jnp.zeros(())))

    A, B = jax.jit(jax.jacfwd(f, argnums=(0, 1)))(x, u)
    return np.asarray(A), np.asarray(B), np.eye(19)[2]


@pytest.fixture(scope="module")
def hold(linear):
    """Transition over five minutes, and the effect of an infusion held over them."""
    A, B, _ = linear
    E = scipy.linalg.expm(5.0 * np.block([[A, B[:, None]], [np.zeros((1, 20))]]))
    return E[:19, :19], E[:19, 19]


@pytest.mark.parametrize(("u", "glucose"), STEADY.items())
def test_glucose_at_rest(patient_81, u, glucose):
    x = patient_81.steady_state(float(u))
    assert float(patient_81.glucose_mg_dl(x)) == pytest.approx(glucose, rel=1e-8)


@pytest.mark.parametrize("u", [0.0, 1.0, 22.33, 30.0, 44.0])
def test_nothing_changes_at_rest(patient_81, sorensen_by_hand, u):
    x = np.asarray(patient_81.steady_state(u))
    np.testing.assert_allclose(sorensen_by_hand(x, u, 0.0), 0.0, atol=1e-11)


@pytest.mark.parametrize("u", [3.0, 25.6])
def test_rest_is_where_a_general_solver_finds_it(patient_81, sorensen_by_hand, u):
    solution = scipy.optimize.root(lambda x: sorensen_by_hand(x, u, 0.0), np.asarray(patient_81.steady_state(u)) * 1.03)
    np.testing.assert_allclose(patient_81.steady_state(u), solution.x, rtol=1e-7, atol=1e-7)


def test_the_two_operating_points(patient_81, patient_22):
    assert float(patient_81.basal_insulin_mU_min) == pytest.approx(25.6060573442, rel=1e-11)
    assert float(patient_81.setpoint_mg_dl) == 81.1
    assert float(patient_22.basal_insulin_mU_min) == 22.33
    assert float(patient_22.setpoint_mg_dl) == pytest.approx(92.0990681, rel=1e-8)


def test_patient_keeps_both_protocols(patient_81):
    assert isinstance(patient_81, Patient)
    assert isinstance(patient_81, SemilinearPatient)


def test_an_unknown_operating_point_is_refused_with_the_known_ones():
    known = "setpoint-81, nominal-22, fasting-81$"
    with pytest.raises(ValueError, match=rf"unknown operating point 'average' of parker-1999; .*: {known}"):
        patient(operating_point="average")
    with pytest.raises(ValueError, match=r"unknown patient 'average'; the known ones are: parker-1999, hovorka-2004"):
        patient("average")
    with pytest.raises(ValueError, match="'nominal-22' is an operating point of parker-1999 and no patient"):
        patient("nominal-22")


@pytest.mark.parametrize("u", [-1.0, -1e-9, np.nan, np.inf])
def test_an_impossible_infusion_is_refused(patient_81, u):
    with pytest.raises(ValueError, match=r"is not possible; give a finite rate of 0 or more"):
        patient_81.steady_state(u)
    with pytest.raises(ValueError, match=r"is not possible; give a finite rate of 0 or more"):
        at_basal(PARKER_1999, u)


def test_an_infusion_that_no_one_survives_is_refused_with_the_largest_one(patient_81):
    with pytest.raises(ValueError, match=r"at 1000 mU/min: .* give less than (\d+\.\d\d) mU/min") as refusal:
        patient_81.steady_state(1000.0)
    most = float(str(refusal.value).rsplit(" mU/min", 1)[0].rsplit(" ", 1)[1])
    assert 0.0 < float(patient_81.glucose_mg_dl(patient_81.steady_state(most - 0.01))) < 0.2
    with pytest.raises(ValueError, match="no physiological steady state"):
        patient_81.steady_state(most + 0.01)


@pytest.mark.parametrize("glucose", [0.0, -5.0, np.nan, 191.0, 1e6])
def test_a_glucose_that_no_infusion_holds_is_refused(patient_81, glucose):
    with pytest.raises(ValueError, match=r"no insulin infusion holds .* above 0 and at most 190\.83 mg/dl"):
        patient_81.insulin_for(glucose)
    with pytest.raises(ValueError, match="no insulin infusion holds"):
        at_setpoint(PARKER_1999, glucose)


@settings(max_examples=60)
@given(st.floats(0.0, 44.0))
def test_an_infusion_is_found_again_from_the_glucose_that_it_holds(patient_81, u):
    glucose = patient_81.glucose_mg_dl(patient_81.steady_state(u))
    assert float(patient_81.insulin_for(glucose)) == pytest.approx(u, rel=1e-9, abs=1e-9)


@settings(max_examples=20)
@given(st.floats(20.0, 190.0))
def test_a_setpoint_and_its_basal_rate_make_the_same_patient(glucose):
    by_setpoint = at_setpoint(PARKER_1999, glucose)
    by_rate = at_basal(PARKER_1999, float(by_setpoint.basal_insulin_mU_min))
    assert float(by_rate.setpoint_mg_dl) == pytest.approx(glucose, rel=1e-11)


def test_glucose_falls_as_insulin_rises(patient_81):
    glucose = patient_81.glucose_mg_dl(patient_81.steady_state(np.linspace(0.0, 44.0, 100)))
    assert np.all(np.diff(glucose) < 0.0)


@pytest.mark.long
def test_gain_of_the_steady_state(patient_81, linear):
    def glucose(u):
        return patient_81.glucose_mg_dl(rest_under(patient_81.parameters, u))

    A, B, C = linear
    assert float(jax.grad(glucose)(patient_81.basal_insulin_mU_min)) == pytest.approx(-3.17618654, rel=1e-8)
    assert -C @ np.linalg.solve(A, B) == pytest.approx(-3.17618654, rel=1e-8)


def test_eigenvalues(linear):
    real = np.sort(np.linalg.eigvals(linear[0]).real)
    assert real[0] == pytest.approx(-4.68, abs=5e-3)
    assert real[-1] == pytest.approx(-0.0093135, abs=5e-8)


def test_transition_over_a_sample(hold):
    assert np.abs(np.linalg.eigvals(hold[0])).max() == pytest.approx(0.954500318, rel=1e-8)


def test_step_response(hold):
    Phi, Gamma = hold
    x, S = np.zeros(19), []
    for _ in range(36):
        x = Phi @ x + Gamma
        S.append(x[2])
    found = [S[i - 1] for i in (1, 6, 12, 36)]
    np.testing.assert_allclose(found, [-0.010266601, -0.77305708, -1.741683, -2.8207981], rtol=1e-7)


@pytest.fixture(scope="module")
def cohort():
    """Five people whose constants lie within 10 % of the published ones, and each of them alone."""
    rng = np.random.default_rng(4)
    of_glucose, of_insulin = rng.uniform(0.9, 1.1, (2, 5))  # flows meet in the organs, so they vary together
    constants = {}
    for field in dataclasses.fields(PARKER_1999):
        constant = getattr(PARKER_1999, field.name)
        if isinstance(constant, Sigmoid):  # so do the parts of an effect
            constants[field.name] = jax.tree.map(lambda part: jnp.full(5, part), constant)
        else:
            factor = {"q": of_glucose, "Q": of_insulin}.get(field.name[0], rng.uniform(0.9, 1.1, 5))
            constants[field.name] = jnp.asarray(constant * factor)
    together = SorensenParameters(**constants)
    return together, [jax.tree.map(lambda leaf, i=i: leaf[i], together) for i in range(5)]


@pytest.mark.long
def test_a_cohort_is_its_people(cohort):
    together, alone = cohort
    u = np.linspace(5.0, 25.0, 5)
    people = at_basal(together, u)
    x = people.steady_state(u)
    inputs = Inputs(insulin_mU_min=u + 3.0, meal_mg_min=np.full(5, 100.0))
    derivative = jax.jit(lambda person, x, inputs: person.derivative(0.0, x, inputs))
    rates = derivative(people, x, inputs)
    assert x.shape == rates.shape == (19, 5)
    for i, p in enumerate(alone):
        one = at_basal(p, float(u[i]))
        np.testing.assert_allclose(people.setpoint_mg_dl[i], one.setpoint_mg_dl, rtol=1e-12)
        np.testing.assert_allclose(x[:, i], one.steady_state(u[i]), rtol=1e-11, atol=1e-12)
        rate = derivative(one, x[:, i], Inputs(insulin_mU_min=u[i] + 3.0, meal_mg_min=100.0))
        np.testing.assert_allclose(rates[:, i], rate, rtol=1e-11, atol=1e-11)
    np.testing.assert_allclose(people.insulin_for(people.setpoint_mg_dl), u, rtol=1e-9)


def test_one_infusion_per_person_or_one_for_all(patient_81):
    many = patient_81.steady_state(np.array([0.0, 5.0, 20.0]))
    np.testing.assert_allclose(many[sorensen.ARTERIAL_GLUCOSE], [STEADY[0], STEADY[5], STEADY[20]], rtol=1e-8)
    with pytest.raises(ValueError, match=r"infusion of -2 mU/min"):
        patient_81.steady_state(np.array([0.0, -2.0, 20.0]))
