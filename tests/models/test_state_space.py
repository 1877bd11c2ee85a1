import control
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate
import scipy.signal

from glucoloop.models.state_space import (
    discretise,
    halvings_of,
    impulse_response,
    linearise,
    step_response,
    zero_order_hold,
)
from glucoloop.patients import Inputs, patient

X0, U0, D0 = np.array([1.2, 0.7, 2.0]), 0.4, 0.1


def derivative(x, u, d=0.0):
    return jnp.array(
        [
            -1.3 * x[0] + 0.1 * x[1] * x[2],
            0.2 * x[0] - 0.5 * x[1] ** 2 - u * x[1],
            -0.4 * x[2] + jnp.sin(x[0]) + 2.0 * d,
        ]
    )


def output(x):
    return x[2] ** 2


A = np.array([[-1.3, 0.1 * X0[2], 0.1 * X0[1]], [0.2, -X0[1] - U0, 0.0], [np.cos(X0[0]), 0.0, -0.4]])
B = np.array([0.0, -X0[1], 0.0])
C = np.array([0.0, 0.0, 2 * X0[2]])
E = np.array([0.0, 0.0, 2.0])


@pytest.fixture(scope="module")
def continuous():
    return linearise(derivative, output, X0, U0, D0)


@pytest.fixture(scope="module")
def discrete(continuous):
    return discretise(continuous, 5.0)


@pytest.mark.long
def test_linearisation_is_the_derivative(continuous):
    for found, truth in ((continuous.A, A), (continuous.B, B), (continuous.C, C), (continuous.E, E)):
        np.testing.assert_allclose(found, truth, rtol=1e-14, atol=1e-15)
    np.testing.assert_allclose(continuous.glucose_mg_dl, 4.0)
    np.testing.assert_array_equal(continuous.state, X0)
    assert continuous.insulin_mU_min == U0


@pytest.mark.long
def test_without_a_disturbance_there_is_no_disturbance_matrix():
    model = linearise(derivative, output, X0, U0)
    assert model.E is None
    assert discretise(model, 5.0).Psi is None
    np.testing.assert_allclose(discretise(model, 5.0).Gamma, zero_order_hold(A, B, 5.0)[1], rtol=1e-13, atol=1e-14)


def test_zero_order_hold_agrees_with_scipy(discrete):
    Phi, Gamma, *_ = scipy.signal.cont2discrete((A, np.stack([B, E], axis=1), C[None], np.zeros((1, 2))), 5.0)
    np.testing.assert_allclose(discrete.Phi, Phi, rtol=1e-12, atol=1e-14)
    np.testing.assert_allclose(discrete.Gamma, Gamma[:, 0], rtol=1e-12, atol=1e-14)
    np.testing.assert_allclose(discrete.Psi, Gamma[:, 1], rtol=1e-12, atol=1e-14)


def test_a_held_input_is_integrated_exactly_though_A_is_singular():
    Phi, Gamma = zero_order_hold([[0.0, 1.0], [0.0, 0.0]], [0.0, 1.0], 3.0)
    np.testing.assert_allclose(Phi, [[1.0, 3.0], [0.0, 1.0]], atol=1e-14)
    np.testing.assert_allclose(Gamma, [4.5, 3.0], atol=1e-14)


def test_a_stiff_model_is_sampled_exactly():
    rates = np.array([-500.0, -4.68, -0.0093])
    Phi, Gamma = zero_order_hold(np.diag(rates), np.ones(3), 5.0)
    np.testing.assert_allclose(Phi, np.diag(np.exp(rates * 5.0)), rtol=1e-11, atol=1e-13)
    np.testing.assert_allclose(Gamma, np.expm1(rates * 5.0) / rates, rtol=1e-11)


def test_responses_agree_with_python_control(discrete):
    system = control.ss(discrete.Phi, np.asarray(discrete.Gamma)[:, None], np.asarray(discrete.C)[None], 0.0, 5.0)
    truth = control.step_response(system, 5.0 * np.arange(41)).outputs
    np.testing.assert_allclose(step_response(discrete, 40), truth[1:], rtol=1e-11)
    np.testing.assert_allclose(impulse_response(discrete, 40), np.diff(truth), rtol=1e-9, atol=1e-12)


def test_the_step_response_tends_to_the_gain(discrete):
    gain = -C @ np.linalg.solve(A, B)
    np.testing.assert_allclose(step_response(discrete, 2000)[-1], gain, rtol=1e-10)


def followed(model, u, d, x):
    """Glucose at the start and after each sample, by the recursion of the discrete model."""
    yield model.glucose_mg_dl + model.C @ x
    for u_k, d_k in zip(u, d, strict=True):
        x = model.Phi @ x + model.Gamma * (u_k - model.insulin_mU_min) + model.Psi * d_k
        yield model.glucose_mg_dl + model.C @ x


def test_the_discrete_model_follows_the_differential_equation(discrete):
    rng = np.random.default_rng(0)
    u, d, z = U0 + rng.normal(size=4), rng.normal(size=4), np.array([0.1, -0.2, 0.3])
    found = list(followed(discrete, u, d, z))
    truth = [4.0 + C @ z]
    for u_k, d_k in zip(u, d, strict=True):
        slope = B * (u_k - U0) + E * d_k
        run = scipy.integrate.solve_ivp(
            lambda _, x, slope=slope: A @ x + slope, (0, 5), z, method="DOP853", rtol=1e-12, atol=1e-13
        )
        z = run.y[:, -1]
        truth.append(4.0 + C @ z)
    np.testing.assert_allclose(found, truth, rtol=1e-9)


def test_at_the_operating_point_nothing_moves(discrete):
    np.testing.assert_array_equal(list(followed(discrete, np.full(10, U0), np.zeros(10), np.zeros(3))), 4.0)


def test_a_controller_can_linearise_again_at_every_sample():
    def gamma(x, u):
        return discretise(linearise(derivative, output, x, u), 5.0).Gamma

    points = np.stack([X0, X0 + 0.1, X0 - 0.1])
    inputs = np.array([U0, 0.5, 0.3])
    together = jax.jit(jax.vmap(gamma))(points, inputs)
    for row, x, u in zip(together, points, inputs, strict=True):
        np.testing.assert_allclose(row, gamma(x, u), rtol=1e-11, atol=1e-13)


@pytest.mark.parametrize("sample_time_min", [0.0, -5.0, np.nan, np.inf])
def test_a_sample_time_that_is_none_is_refused(continuous, sample_time_min):
    with pytest.raises(ValueError, match="sample time"):
        discretise(continuous, sample_time_min)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: linearise(derivative, output, X0[:, None], U0), "state must be a vector"),
        (lambda: linearise(derivative, output, X0, [U0]), "infusion must be a scalar"),
        (lambda: linearise(derivative, output, X0, U0, [D0]), "disturbance must be a scalar"),
        (lambda: linearise(lambda x, u: x[:2] * u, output, X0, U0), "derivative must have the shape"),
        (lambda: linearise(derivative, lambda x: x, X0, U0), "output must be a scalar"),
        (lambda: zero_order_hold(A[:2], B, 5.0), "A must be square"),
        (lambda: zero_order_hold(A, B[:2], 5.0), "B must be"),
    ],
)
def test_arguments_that_do_not_fit_are_refused(call, message):
    with pytest.raises(ValueError, match=message):
        call()


def test_a_response_of_no_sample_is_refused(discrete):
    with pytest.raises(ValueError, match="at least 1 sample"):
        step_response(discrete, 0)


@pytest.mark.long
def test_the_patient_at_the_setpoint_has_its_known_dynamics():
    person = patient()
    u0 = 25.6060573442

    def flow(x, u, meal):
        return person.derivative(0.0, x, Inputs(insulin_mU_min=u, meal_mg_min=meal))

    model = discretise(linearise(flow, person.glucose_mg_dl, person.steady_state(u0), u0, 0.0), 5.0)
    np.testing.assert_allclose(np.abs(np.linalg.eigvals(model.Phi)).max(), 0.954500318, rtol=1e-9)
    known = [-0.010266601, -0.77305708, -1.741683, -2.8207981]
    np.testing.assert_allclose(step_response(model, 36)[np.array([0, 5, 11, 35])], known, rtol=1e-7)
    np.testing.assert_allclose(step_response(model, 2000)[-1], -3.17618654, rtol=1e-8)
    np.testing.assert_allclose(model.glucose_mg_dl, 81.1, rtol=1e-11)


@pytest.mark.long
@pytest.mark.parametrize("name", ["parker-1999", "hovorka-2004", "wilinska-2010", "kanderian-2009"])
@pytest.mark.parametrize("minutes", [1.0, 5.0, 15.0])
def test_the_series_of_fixed_length_is_scipys_matrix_exponential(name, minutes):
    """At rest and away from it, where the halvings were chosen for rest."""
    person = patient(name)
    basal = person.basal_insulin_mU_min
    flow = linearisable(person)
    at_rest = linearise(flow, person.glucose_mg_dl, person.steady_state(basal), basal)
    halvings = halvings_of(at_rest, minutes)
    rng = np.random.default_rng(5)
    for spread in (0.0, 0.5, 0.5):
        x = person.steady_state(basal) * (1.0 + spread * rng.uniform(-1.0, 1.0, at_rest.state.shape[0]))
        model = linearise(flow, person.glucose_mg_dl, x, 2.0 * basal)
        exact, found = discretise(model, minutes), discretise(model, minutes, halvings)
        for array in ("Phi", "Gamma"):
            expected = np.asarray(getattr(exact, array))
            np.testing.assert_allclose(
                getattr(found, array), expected, rtol=0.0, atol=1e-8 * max(1.0, np.abs(expected).max())
            )


def linearisable(person):
    return lambda x, u: person.derivative(0.0, x, Inputs(insulin_mU_min=u, meal_mg_min=jnp.zeros(())))
