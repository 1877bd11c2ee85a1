"""Every controller: in step with the simulation, alone or in a cohort, and unshaken by any sequence of readings.

On a patient small enough that all of them take seconds: glucose, remote insulin and insulin in blood, after
R. N. Bergman et al., "Quantitative estimation of insulin sensitivity", Am. J. Physiol. 236, 1979.
"""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from designed import Designed
from glucoloop._pytree import pytree, static
from glucoloop.control import Observation, Status
from glucoloop.control.catalogue import CONTROLLERS as ENTRIES
from glucoloop.control.protocol import gives_boluses
from glucoloop.estimation.unknown_meal import MovingHorizonSettings
from glucoloop.identification import FirstOrderModel
from glucoloop.meals import Meal, Scenario, appearance_mg_min
from glucoloop.models.state_space import impulse_response
from glucoloop.models.step_response import StepResponseModel
from glucoloop.pumps import LimitedPump
from glucoloop.sensors import white_noise
from glucoloop.simulation import linear_model, simulate
from glucoloop.simulation.plant import Exogenous

SCENARIO = Scenario([Meal(40.0, 32.0)], 200.0)
SAMPLES, PEOPLE = 40, 3
LEAST, MOST, CHANGE = 0.0, 66.9, 16.7


@pytree
class Minimal:
    """Glucose, remote insulin, and insulin in blood, ``x = (G, X, I)``."""

    basal_insulin_mU_min: jax.Array
    setpoint_mg_dl: jax.Array

    def steady_state(self, insulin_mU_min):
        insulin = jnp.asarray(insulin_mU_min, float) / (0.1 * 10.0)
        remote = 5e-4 * insulin
        return jnp.stack([0.01 * 200.0 / (0.01 + remote), remote, insulin])

    def insulin_for(self, glucose_mg_dl):
        return (0.01 * 200.0 / jnp.asarray(glucose_mg_dl) - 0.01) / 5e-4

    def derivative(self, t_min, x, inputs):
        del t_min
        G, X, insulin = x
        return jnp.stack(
            [
                0.01 * (200.0 - G) - X * G + inputs.meal_mg_min / 120.0,
                0.03 * (5e-4 * insulin - X),
                inputs.insulin_mU_min / 10.0 - 0.1 * insulin,
            ]
        )

    def glucose_mg_dl(self, x):
        return x[0]


def advance_by_minutes(rates, x):
    """States after each of five minutes, by the classical Runge-Kutta method."""

    def minute(x, _):
        k1 = rates(x)
        k2 = rates(x + k1 / 2.0)
        k3 = rates(x + k2 / 2.0)
        k4 = rates(x + k3)
        x = x + (k1 + 2.0 * k2 + 2.0 * k3 + k4) / 6.0
        return x, x

    return jax.lax.scan(minute, x, None, length=5)[1]


@pytree
class MinutePlant:
    """The patient and his meal, whose appearance is held over a sample and stands where the moments would."""

    patient: Minimal

    def advance(self, x, insulin_mU_min, exogenous):
        inputs = Observed(insulin_mU_min=insulin_mU_min, meal_mg_min=exogenous.moments)
        states = advance_by_minutes(lambda x: self.patient.derivative(0.0, x, inputs), x)
        return states[-1], states[:, 0]


@pytree
class Observed:
    insulin_mU_min: jax.Array
    meal_mg_min: jax.Array


class Minutes:
    def prepare(self, patient, absorption, grid):
        rates = jax.vmap(lambda t: appearance_mg_min(t, absorption))(jnp.asarray(grid.t_min))
        return MinutePlant(patient=patient), Exogenous(t_min=jnp.asarray(grid.t_min), moments=rates)


@pytree
class Imagined:
    """The patient as the nonlinear controllers imagine him."""

    patient: Minimal
    state: jax.Array
    insulin_mU_min: jax.Array
    sample_time_min: float = static(default=5.0)

    def derivative(self, x, insulin_mU_min):
        inputs = Observed(insulin_mU_min=insulin_mU_min, meal_mg_min=jnp.zeros(()))
        return self.patient.derivative(0.0, x, inputs)

    def advance(self, x, insulin_mU_min):
        return advance_by_minutes(lambda x: self.derivative(x, insulin_mU_min), x)[-1]

    def advance_fed(self, x, insulin_mU_min, appearance_mg_min):
        inputs = Observed(insulin_mU_min=insulin_mU_min, meal_mg_min=appearance_mg_min[0])
        return advance_by_minutes(lambda x: self.patient.derivative(0.0, x, inputs), x)[-1]

    def glucose_mg_dl(self, x):
        return x[0]


PATIENT = Minimal(basal_insulin_mU_min=jnp.asarray(25.0), setpoint_mg_dl=jnp.asarray(200.0 / 2.25))
LINEAR = linear_model(PATIENT)
IDENTIFIED = StepResponseModel.from_impulse_response(impulse_response(LINEAR, 60), 5.0)
Q = np.array([5.0, 1e-5, 0.1])
IMAGINED = Imagined(patient=PATIENT, state=PATIENT.steady_state(25.0), insulin_mU_min=PATIENT.basal_insulin_mU_min)


class MinimalDesign(Designed):
    def process_noise(self, glucose, other, glucagon):
        del glucose, other, glucagon
        return Q


SETTINGS = {
    "mpc": {"prediction_horizon": 12, "move_weight": 1.0},
    "mpc-se": {"prediction_horizon": 10, "move_weight": 1.0},
    "nlqdmc-se": {"move_weight": 1.0},
    "meal-mpc": {"meals_per_h": 0.1, "mean_carbs_g": 40.0, "estimator": MovingHorizonSettings(horizon=4)},
    "profile-mpc": {"sensor_lag_min": 0.0, "sensor_error_mg_dl": 0.0},
    "therapy-mpc": {"sensor_lag_min": 0.0, "sensor_error_mg_dl": 0.0},
    "imc": {"filter_min": 15.0, "delay_min": 10.0},
    "pid": {"gain": 0.5, "integral_time_min": 100.0, "derivative_time_min": 10.0},
}
"""Settings that suit this patient, where those of the catalogue do not."""
EXACT = {"offset_free": "input-disturbance", "constraints": "qp"}
VARIANTS = {
    **{name: (name, {}, 0) for name in ENTRIES},
    "mpc-se, exact program": ("mpc-se", EXACT, 1),
    "meal-mpc, known dead time": ("meal-mpc", {}, 1),
}
"""Every controller of the catalogue, and others with further settings: name, settings, known dead time in samples."""


@functools.cache
def designed(variant):
    """Controller of a variant, designed when a test first asks for it."""
    name, own, dead_time_samples = VARIANTS[variant]
    design = MinimalDesign(
        linear=LINEAR,
        imagined=IMAGINED,
        identified=IDENTIFIED,
        first=FirstOrderModel(gain=-2.0, tau_min=60.0, delay_min=10.0, residual_rms_mg_dl=0.0),
        basal_insulin_mU_min=25.0,
        setpoint_mg_dl=float(PATIENT.setpoint_mg_dl),
        dead_time_samples=dead_time_samples,
    )
    return ENTRIES[name](**{**SETTINGS.get(name, {}), **own}).designed(design)


ONE_PERSONS = {name for name, variant in VARIANTS.items() if ENTRIES[variant[0]].slow or variant[0] == "nlqdmc-se"}


def observe(reading, valid, delivered, controller):
    return Observation(
        glucose_mg_dl=jnp.asarray(reading, float),
        valid=jnp.asarray(valid),
        setpoint_mg_dl=jnp.broadcast_to(PATIENT.setpoint_mg_dl, jnp.shape(reading)),
        delivered_mU_min=jnp.asarray(delivered, float),
        announced_carbs_g=jnp.zeros(jnp.shape(reading)),
        delivered_bolus_mU=jnp.zeros(jnp.shape(reading)) if gives_boluses(controller) else None,
    )


step = jax.jit(lambda controller, state, observation: controller.step(state, observation))
keys = jax.random.split(jax.random.key(7), PEOPLE)


def loop(controller, key):
    return simulate(PATIENT, controller, white_noise(), scenario=SCENARIO, key=key, integrator=Minutes())


@pytest.fixture(scope="module", params=VARIANTS)
def variant(request):
    return request.param


@pytest.fixture(scope="module")
def controller(variant):
    return designed(variant)


@pytest.fixture(scope="module")
def alone(controller):
    return [loop(controller, key) for key in keys]


# ------------------------------------------------------------------------------------------- one, many, in real time


@pytest.mark.long
def test_a_cohort_is_each_one_alone(controller, alone):
    together = jax.vmap(lambda key: loop(controller, key))(keys)
    for i, one in enumerate(alone):
        for name in ("insulin_mU_min", "fine_glucose_mg_dl", "reading_mg_dl", "states"):
            # sums in another order, whose rounding the loop carries through all samples
            np.testing.assert_allclose(getattr(together, name)[i], getattr(one, name), rtol=1e-10, atol=1e-10)
        np.testing.assert_array_equal(together.status[i], one.status)


@pytest.mark.long
def test_stepping_in_real_time_is_the_simulation(controller, alone):
    trace, pump, plant = alone[0], LimitedPump(), MinutePlant(patient=PATIENT)
    advance, meal = jax.jit(plant.advance), SCENARIO.absorbed_by(PATIENT)
    x, delivered, in_pump, state = trace.states[0], trace.basal_insulin_mU_min, trace.basal_insulin_mU_min, None
    bolus = jnp.zeros(()) if gives_boluses(controller) else None
    for k in range(SAMPLES):
        np.testing.assert_allclose(x, trace.states[k], rtol=1e-12, atol=1e-12)
        # the noise is what the sensor added; everything else happens here again
        reading = x[0] + (trace.reading_mg_dl[k] - trace.glucose_mg_dl[k])
        seen = dataclasses.replace(observe(reading, True, delivered, controller), delivered_bolus_mU=bolus)
        before = controller.init(seen) if state is None else state
        state, decision = step(controller, before, seen)
        assert jax.tree.map(jax.typeof, state) == jax.tree.map(jax.typeof, before)  # so that it is compiled once
        in_pump, delivery = pump.deliver(in_pump, decision.insulin_mU_min, keys[0], decision.bolus_mU)
        delivered, bolus = delivery.reported_mU_min, delivery.reported_bolus_mU
        np.testing.assert_allclose(delivered, trace.insulin_mU_min[k], rtol=1e-12, atol=1e-12)
        assert int(decision.status) == int(trace.status[k])
        infused = delivered if bolus is None else delivered + bolus / 5.0
        x, _ = advance(x, infused, Exogenous(t_min=jnp.asarray(5.0 * k), moments=appearance_mg_min(5.0 * k, meal)))


@pytest.mark.long
def test_a_key_gives_one_trace_and_another_key_another(controller, alone):
    jax.tree.map(np.testing.assert_array_equal, loop(controller, keys[0]), alone[0])
    assert np.all(np.asarray(alone[0].reading_mg_dl) != np.asarray(alone[1].reading_mg_dl))


@pytest.mark.long
def test_the_loop_is_worth_closing(variant, controller, alone):
    """A meal raises glucose less than without a controller; so what is compared above is at work."""
    peak = float(alone[0].fine_glucose_mg_dl.max())
    highest = float(loop(designed("basal"), keys[0]).fine_glucose_mg_dl.max())
    assert highest > float(PATIENT.setpoint_mg_dl) + 20.0
    if gives_boluses(controller):  # this one acts on announced meals
        told = dataclasses.replace(
            observe(jnp.asarray(100.0), True, 25.0, controller), announced_carbs_g=jnp.asarray(40.0)
        )
        assert controller.step(controller.init(told), told)[1].bolus_mU > 1000.0
    elif variant != "basal":
        assert peak < highest - 5.0
        assert np.ptp(alone[0].insulin_mU_min) > 5.0


# ------------------------------------------------------------------------------------------- any readings

READING = st.tuples(
    st.one_of(
        st.floats(40.0, 400.0), st.floats(), st.sampled_from([np.nan, np.inf, -np.inf, 0.0, 1e9, 1e300, -1.7e308])
    ),
    st.booleans(),
)
ROWS = 16


@jax.jit
def follow(controller, readings, valid, start):
    """Doses, decisions and states over a row of readings; people may trail."""

    def sample(carry, entry):
        state, delivered = carry
        state, decision = controller.step(state, observe(*entry, delivered, controller))
        delivered, _ = LimitedPump().deliver(delivered, decision.insulin_mU_min, keys[0])
        return (state, delivered), (delivered, decision, state)

    first = controller.init(observe(readings[0], valid[0], start, controller))
    return jax.lax.scan(sample, (first, start), (readings, valid))[1]


@pytest.mark.long
@settings(max_examples=60)
@given(st.lists(READING, min_size=ROWS, max_size=ROWS), st.floats(LEAST, MOST))
def test_whatever_is_read_doses_keep_the_limits_and_states_stay_finite(controller, rows, start):
    glucose, valid = np.array([g for g, _ in rows]), np.array([v for _, v in rows])
    doses, decision, states = follow(controller, glucose, valid, jnp.asarray(start))
    for rates in (np.asarray(doses), np.asarray(decision.insulin_mU_min)):
        assert np.all((rates >= LEAST) & (rates <= MOST))
    assert np.abs(np.diff(np.r_[start, doses])).max() <= CHANGE + 1e-12
    for leaf in jax.tree.leaves(states):
        assert np.all(np.isfinite(leaf))
    status, missing = np.asarray(decision.status), ~valid | ~np.isfinite(glucose)
    assert np.all(np.isin(status[missing], [Status.READING_MISSING, Status.NON_FINITE]))
    assert np.all(status[~missing] != Status.READING_MISSING)


def without_covariance(states, sample):
    """State at a sample with the covariance of the estimate left out, and that covariance."""
    state = jax.tree.map(lambda leaf: np.asarray(leaf[sample]), states)
    covariance = state.estimate.covariance
    estimate = dataclasses.replace(state.estimate, covariance=0.0 * covariance)
    return dataclasses.replace(state, estimate=estimate), covariance


@pytest.mark.long
@settings(max_examples=5)
@given(st.lists(st.sampled_from([np.nan, np.inf, -np.inf]), min_size=ROWS // 2, max_size=ROWS // 2))
def test_after_readings_that_are_no_numbers_it_works_as_before(variant, controller, nonsense):
    """At rest nothing is lost by not being read, so the answer to the next reading is the same."""
    rest = float(PATIENT.setpoint_mg_dl)
    ordinary = np.r_[rest + 2.0, rest + 4.0, np.full(6, rest + 3.0)]
    readings = np.r_[rest, nonsense[1:], ordinary]
    doses, decision, states = follow(controller, readings, np.isfinite(readings), jnp.asarray(25.0))
    whole = np.where(np.isfinite(readings), readings, rest)
    expected, _, known_states = follow(controller, whole, np.ones(ROWS, bool), jnp.asarray(25.0))
    if VARIANTS[variant][0] == "meal-mpc":
        # a sudden rise tells of a meal, and one after a gap of a meal or of less: it need not answer alike
        np.testing.assert_allclose(doses[:8], 25.0, atol=1.0)
        assert np.all(np.asarray(doses[8:]) > 26.0)
        assert np.all(np.asarray(doses[8:]) <= np.asarray(expected[8:]) + 5.0)
    elif VARIANTS[variant][0] in ("profile-mpc", "therapy-mpc"):
        # What may have been eaten meanwhile makes the first readings count for more, and nothing else does: when the
        # gap ends the state is the same but for the covariance, which is larger.
        np.testing.assert_allclose(doses[:8], 25.0, atol=1e-3)
        known, unknown = (without_covariance(state, 7) for state in (known_states, states))
        for one, other in zip(jax.tree.leaves(known[0]), jax.tree.leaves(unknown[0]), strict=True):
            np.testing.assert_allclose(one, other, atol=1e-3)
        assert np.linalg.eigvalsh(unknown[1] - known[1]).min() > -1e-9 * np.linalg.norm(unknown[1])
    elif VARIANTS[variant][0] == "oref0":
        # it doses by the change of glucose, of which the first reading after a gap tells nothing
        np.testing.assert_array_equal(doses[:8], expected[:8])
        np.testing.assert_array_equal(doses[-4:], expected[-4:])
    else:
        np.testing.assert_allclose(doses, expected, atol=1e-3)
    assert np.all(np.isin(decision.status[-8:], [Status.OK, Status.SATURATED]))


@pytest.mark.long
def test_it_starts_without_a_rate_and_goes_on_after_a_missing_setpoint(controller):
    rest = float(PATIENT.setpoint_mg_dl)
    ordinary = observe(rest + 2.0, True, np.nan, controller)
    lost = dataclasses.replace(ordinary, setpoint_mg_dl=jnp.asarray(np.nan))
    state, doses, statuses = controller.init(ordinary), [], []
    for observation in (ordinary, ordinary, lost, ordinary, ordinary, ordinary):
        state, decision = step(controller, state, observation)
        doses.append(float(decision.insulin_mU_min))
        statuses.append(int(decision.status))
    assert np.all((np.array(doses) >= LEAST) & (np.array(doses) <= MOST))
    assert set(statuses[:2] + statuses[-2:]) <= {Status.OK, Status.SATURATED}
    for leaf in jax.tree.leaves(state):
        assert np.all(np.isfinite(leaf))


@pytest.mark.long
def test_people_may_trail(variant, controller):
    """All but the nonlinear ones, which are one person's, serve a cohort without being mapped."""
    if variant in ONE_PERSONS:
        pytest.skip("one person's")
    rng = np.random.default_rng(0)
    readings, valid = rng.uniform(60.0, 200.0, (ROWS, PEOPLE)), rng.random((ROWS, PEOPLE)) < 0.8
    start = np.array([20.0, 25.0, 40.0])
    doses, decision, _ = follow(controller, readings, valid, jnp.asarray(start))
    for i in range(PEOPLE):
        one, alone, _ = follow(controller, readings[:, i], valid[:, i], jnp.asarray(start[i]))
        np.testing.assert_allclose(doses[:, i], one, rtol=1e-12, atol=1e-11)
        np.testing.assert_array_equal(decision.status[:, i], alone.status)
