"""The controller by the settings of therapy alone, whose gains are learned."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from glucoloop.control.protocol import computed_settings
from glucoloop.control.therapy_mpc import TherapyMPC
from glucoloop.pumps import DEFAULT_BOLUS_LIMITS, PARKER_1999_LIMITS
from glucoloop.snapshot import pack, unpack
from glucoloop.therapy import Profile
from observing import observing_meals

BASAL = 14.0
PROFILE = Profile(basal_mU_min=BASAL, setpoint_mg_dl=120.0, carb_ratio_g_U=11.0, correction_mg_dl_U=45.0)


@dataclasses.dataclass
class Case:
    """The part of a design case that the controller uses: nothing of it is a model of the patient."""

    profile: Profile = PROFILE
    limits: object = PARKER_1999_LIMITS
    bolus: object = DEFAULT_BOLUS_LIMITS
    sample_time_min: float = 5.0
    noise_variance: float = 0.0


@functools.cache
def designed(**changes):
    return TherapyMPC(**changes).designed(Case())


stepped = jax.jit(lambda controller, state, observation: controller.step(state, observation))
predicted = jax.jit(
    lambda controller, estimate, insulin: controller.filter.predict(controller.model, estimate, insulin)
)
updated = jax.jit(
    lambda controller, estimate, reading, known: controller.filter.update(controller.model, estimate, reading, known)
)


def init(observation):
    return designed().init(observation)


def step(state, observation):
    return stepped(designed(), state, observation)


def predict(estimate, insulin_mU_min):
    return predicted(designed(), estimate, insulin_mU_min)


def update(estimate, reading_mg_dl, known):
    return updated(designed(), estimate, reading_mg_dl, known)


seen = observing_meals(120.0, BASAL)


def test_the_model_has_the_numbers_of_the_profile_and_nothing_else():
    told = computed_settings(designed())
    assert told["believed_correction_mg_dl_U"] == pytest.approx(45.0)
    assert told["believed_carb_ratio_g_U"] == pytest.approx(11.0)


@pytest.mark.long
def test_rest_is_held_and_a_meal_gets_a_bolus_by_the_ratio():
    state = init(seen())
    for _ in range(3):
        state, decision = step(state, seen())
    assert float(decision.insulin_mU_min) == pytest.approx(BASAL, rel=1e-3)
    assert float(decision.bolus_mU) == 0.0
    _, decision = step(state, seen(carbs_g=55.0))
    assert 2500.0 < float(decision.bolus_mU) < 6500.0


def vector(estimate):
    """Gut, disturbance, error of the sensor, log time, glucose, reading, drift, and log gains."""
    others = estimate.disturbance_mg_min, estimate.sensor_mg_dl, estimate.log_gut_time
    states = (estimate.x[i] for i in (5, 6, 3, 4))
    return np.array([*estimate.gut_mg, *others, *states, estimate.log_meal_gain], np.float64)


@pytest.mark.long
def test_the_filter_is_an_extended_kalman_filter_of_the_equations():
    """Against one by hand in NumPy: equations in fine steps, derivatives by differences."""
    controller, model = designed(), designed().model
    gain, meal_gain = float(model.insulin_gain), float(model.meal_gain)
    effect = 45.0 * BASAL / 1000.0
    insulin = np.array([12.1527777778] * 3)

    def later(v, insulin, rate):
        """State 5 min later, by the method of Runge and Kutta in quarter minutes."""
        gut_min, u = 36.0 * np.exp(v[4]), 12.1527777778 + gain * (rate - BASAL)
        total, first, second = v[0] + v[1], v[0], v[1]
        z = 5.0 / gut_min
        after = np.exp(-z) * np.array([first, second + z * first])
        flux = meal_gain * np.exp(v[9]) * (total - after.sum()) / 5.0 + v[2]

        def slope(y):
            q_1, q_2, q_3, glucose, reading = y
            pull = v[7] - 0.0855 * np.exp(v[8]) * (q_3 - 12.1527777778)
            return np.array(
                [
                    (u - q_1) / 55.0,
                    (q_1 - q_2) / 55.0,
                    (q_2 - q_3) / 60.0,
                    0.5 * pull * (1.0 + glucose / 120.0) - 0.002 * (glucose - 120.0) + flux / 107.0,
                    (glucose - reading) / 10.0,
                ]
            )

        y = np.array([*insulin, v[5], v[6]])
        for _ in range(20):
            k_1 = slope(y)
            k_2 = slope(y + 0.125 * k_1)
            k_3 = slope(y + 0.125 * k_2)
            y = y + 0.25 * (k_1 + 2.0 * k_2 + 2.0 * k_3 + slope(y + 0.25 * k_3)) / 6.0
        v = np.array([*after, np.exp(-5.0 / 60.0) * v[2], 0.7 * v[3], v[4], y[3], y[4], *v[7:]])
        return v, y[:3]

    v = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 120.0, 120.0, 0.0, 0.0, 0.0])
    P = np.diag([0.0, 0.0, 0.0, 81.0, 0.25**2, 0.0, 0.0, (0.25 * effect) ** 2, 0.3**2, 0.3**2])
    P[5:7, 5:7] = 40.0**2
    own, walk = TherapyMPC(), 0.05**2 * 5.0 / 1440.0
    noise = [(1000.0 * own.meal_noise_g) ** 2, 0.0, own.disturbance_noise_mg_min**2, 0.51 * 81.0]
    C, R = np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]), 0.25
    estimate = controller.filter.init(model)
    np.testing.assert_allclose(estimate.covariance, P, atol=1e-9)
    for rate, carbs_g, reading in ((14.0, 0.0, 128.0), (900.0, 60.0, 131.0), (3.0, 0.0, 149.0), (0.0, 0.0, 171.0)):
        (after, chain), size = later(v, insulin, rate), np.maximum(np.abs(v), [1e4, 1e4, 10.0, 1, 1, 1, 1, 0.1, 1, 1])
        h = 1e-5 * size
        F = np.stack(
            [
                (later(v + h * e, insulin, rate)[0] - later(v - h * e, insulin, rate)[0]) / (2.0 * h[i])
                for i, e in enumerate(np.eye(10))
            ],
            axis=1,
        )
        Q = np.diag([*noise, 0.0, 0.0, 0.0, walk * effect**2, walk, walk])
        Q[5:7, 5:7] += own.glucose_noise_mg_min**2 * np.outer(F[5:7, 2], F[5:7, 2])
        v, P, insulin = after, F @ P @ F.T + Q, chain
        K = P @ C / (C @ P @ C + R)
        v, P = v + K * (reading - C @ v), P - np.outer(K, C @ P)
        v[4] = np.clip(v[4], -1.0, 0.0)
        estimate = update(predict(estimate, jnp.asarray(rate)), jnp.asarray(reading), jnp.asarray(True))
        scale = np.sqrt(np.diag(P)) + 1e-9
        np.testing.assert_allclose((vector(estimate) - v) / scale, 0.0, atol=0.02)
        np.testing.assert_allclose(
            np.asarray(estimate.covariance) / np.outer(scale, scale), P / np.outer(scale, scale), atol=0.01
        )
        v[0] += 1000.0 * carbs_g
        P[0, 0] += (300.0 * carbs_g) ** 2
        estimate = controller.filter.announce(estimate, jnp.asarray(carbs_g))


@pytest.mark.long
@pytest.mark.parametrize(("insulin", "meals"), [(1.6, 1.0), (0.7, 1.0), (1.0, 1.4)])
def test_what_a_unit_covers_is_learned_from_days_of_meals(insulin, meals):
    """A person of the same equations with another ratio than the profile has, whose meals are met by the right bolus.

    Of insulin and meals that do more by one factor the readings tell little then, and the filter need not learn it.
    """
    controller, model = designed(), designed().model
    truth, estimate = controller.filter.init(model), controller.filter.init(model)
    truth = dataclasses.replace(truth, x=truth.x.at[4].set(np.log(insulin)), log_meal_gain=jnp.asarray(np.log(meals)))
    for sample in range(3 * 288):
        bolus = 0.0
        if sample % 72 == 24:
            truth, estimate = (controller.filter.announce(one, jnp.asarray(50.0)) for one in (truth, estimate))
            bolus = 50.0 / 11.0 * meals / insulin * 1000.0 / 5.0
        truth, estimate = (predict(one, jnp.asarray(BASAL + bolus)) for one in (truth, estimate))
        estimate = update(estimate, model.reading_mg_dl(truth.x), jnp.asarray(True))
    wanted, learned = np.log(insulin / meals), float(estimate.x[4] - estimate.log_meal_gain)
    assert 0.4 < learned / wanted < 1.2


@pytest.mark.long
def test_what_is_learned_outlasts_a_restart():
    """The state as bytes and back is the same, and goes on exactly as the one that was never stored."""
    state = init(seen())
    for glucose in np.linspace(126.0, 180.0, 12):
        state, _ = step(state, seen(glucose, delivered=60.0))
    assert abs(float(state.estimate.x[4])) > 1e-3
    restored = unpack(pack(state), init(seen()))
    for one, other in zip(
        jax.tree.leaves(step(state, seen(160.0))), jax.tree.leaves(step(restored, seen(160.0))), strict=True
    ):
        np.testing.assert_array_equal(one, other)


@pytest.mark.long
@settings(max_examples=30, deadline=None)
@given(
    st.lists(
        st.tuples(
            st.floats(allow_nan=True, allow_infinity=True),
            st.floats(allow_nan=True, allow_infinity=True),
            st.floats(allow_nan=True, allow_infinity=True),
        ),
        min_size=1,
        max_size=6,
    )
)
def test_a_step_is_total(inputs):
    state = init(seen())
    for glucose, carbs_g, delivered in inputs:
        state, decision = step(state, seen(glucose, carbs_g=carbs_g, delivered=delivered))
        assert 0.0 <= float(decision.insulin_mU_min) <= PARKER_1999_LIMITS.max_mU_min
        assert 0.0 <= float(decision.bolus_mU) <= DEFAULT_BOLUS_LIMITS.max_mU
    for _ in range(2):
        state, decision = step(state, seen())
    assert all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves(state))
