"""What must hold for every patient, controller, sensor and pump, whatever is read."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from glucoloop._pytree import pytree
from glucoloop.control import (
    Status,
    design_imc,
    design_linear_mpc,
    design_mpc_se,
    design_nlqdmc_se,
    design_open_loop,
    design_pid,
    internal_model_tuning,
)
from glucoloop.control.tuning import NOISY, PARKER_1999
from glucoloop.meals import Meal, Scenario
from glucoloop.patients import OPERATING_POINTS, patient
from glucoloop.patients.capabilities import process_noise
from glucoloop.pumps import LimitedPump, with_resolution
from glucoloop.sensors import IdealSensor, Reading, dead_time, white_noise
from glucoloop.simulation import linear_model, nonlinear_model, simulate

SCENARIO = Scenario([Meal(60.0, 31.7)], 300.0)
LEAST, MOST, CHANGE = 0.0, 66.9, 16.7
BRAIN_INTERSTITIAL = 1  # falls below zero in deep hypoglycemia, because the brain's uptake is constant
NONSENSE = jnp.array([jnp.nan, jnp.inf, -jnp.inf, 0.0, -40.0, 1e9, 1e300, 20.0, 400.0, 81.1])


@pytree
class Mad:
    """A sensor that, where it is mad, reads nonsense most of the time and says at random whether it stands by it."""

    inner: object
    mad: jax.Array | bool

    def init(self, glucose_mg_dl, key):
        return self.inner.init(glucose_mg_dl, key)

    def read(self, state, glucose_mg_dl, key):
        inner, what, whether, sane = jax.random.split(key, 4)
        state, reading = self.inner.read(state, glucose_mg_dl, inner)
        sane = ~jnp.asarray(self.mad) | jax.random.bernoulli(sane, 0.2)
        return state, Reading(
            glucose_mg_dl=jnp.where(sane, reading.glucose_mg_dl, jax.random.choice(what, NONSENSE)),
            valid=reading.valid & (sane | jax.random.bernoulli(whether)),
        )


def tuned(person):
    return next(PARKER_1999[name, True] for name in OPERATING_POINTS if same(person, patient(operating_point=name)))


def same(one, other):
    return float(one.setpoint_mg_dl) == float(other.setpoint_mg_dl)


CONTROLLERS = {
    "linear MPC": lambda person, model: design_linear_mpc(model, NOISY),
    "linear MPC, exact program": lambda person, model: design_linear_mpc(model, NOISY, constraints="qp"),
    "IMC": lambda person, model: design_imc(-3.0, 80.0, 5.0),
    "MPC/SE": lambda person, model: design_mpc_se(
        linear_model(person), process_noise(person, *tuned(person).noise), tuned(person).mpc_se
    ),
    "NLQDMC/SE": lambda person, model: design_nlqdmc_se(
        nonlinear_model(person), process_noise(person, *tuned(person).noise), tuned(person).nlqdmc_se
    ),
    "PID": lambda person, model: design_pid(internal_model_tuning(-3.0, 80.0, 5.0, 30.0)),
    "open loop": lambda person, model: design_open_loop(),
}
PARTS = {
    "ideal sensor": (IdealSensor(), LimitedPump()),
    "dead time": (dead_time(2), LimitedPump()),
    "resolution": (white_noise(), with_resolution(1.0)),
}
CASES = [
    *((name, None, point) for name in CONTROLLERS for point in OPERATING_POINTS),
    *(("linear MPC", part, "setpoint-81") for part in PARTS),
]


@pytest.fixture(scope="module", params=CASES, ids=lambda case: "-".join(filter(None, case)))
def loop(request, identified_81):
    """A loop by whether its sensor is mad, and its key."""
    controller, part, point = request.param
    person = patient(operating_point=point)
    sensor, pump = PARTS[part] if part else (white_noise(), LimitedPump())
    designed = CONTROLLERS[controller](person, identified_81.model)
    traces = {}

    def run(mad, key=0, again=False):
        if again or (mad, key) not in traces:
            traces[mad, key] = simulate(person, designed, Mad(inner=sensor, mad=jnp.asarray(mad)), pump, SCENARIO, key)
        return traces[mad, key]

    run.step = pump.step_mU_min if part == "resolution" else 0.0
    return run


@pytest.mark.parametrize(("mad", "key"), [(False, 0), (True, 0), (True, 1), (True, 2)])
def test_doses_keep_the_limits_whatever_is_read(loop, mad, key):
    trace = loop(mad, key)
    doses = np.asarray(trace.insulin_mU_min)
    assert np.all((doses >= LEAST) & (doses <= MOST))
    before = np.r_[float(trace.basal_insulin_mU_min), doses]
    assert np.abs(np.diff(before)).max() < CHANGE + 2.0 * loop.step + 1e-9
    assert np.all(np.isfinite(trace.command_mU_min))
    assert np.all(np.isin(trace.status, list(Status)))


@pytest.mark.parametrize("mad", [False, True])
def test_the_patient_stays_a_patient(loop, mad):
    trace = loop(mad)
    states = np.asarray(trace.states)
    assert np.all(np.isfinite(states))
    assert np.all(np.isfinite(trace.fine_glucose_mg_dl))
    assert states[:, 8:15].min() >= 0.0  # insulin
    if not mad:  # no controller can be blamed for glucose after hours of invented readings
        concentrations = np.delete(states[:, :15], BRAIN_INTERSTITIAL, axis=1)
        assert concentrations.min() >= 0.0
        assert states[:, 17].min() >= 0.0  # glucagon


def test_a_mad_sensor_shows_in_the_status(loop):
    trace = loop(True)
    missing = ~np.asarray(trace.reading_valid) | ~np.isfinite(np.asarray(trace.reading_mg_dl))
    assert missing.sum() > 10
    if np.any(np.asarray(trace.status)):  # the open loop has no use for readings
        assert np.all(np.isin(np.asarray(trace.status)[missing], [Status.READING_MISSING, Status.NON_FINITE]))


def test_a_key_gives_one_trace(loop):
    first = jax.tree.map(np.asarray, loop(True, 1))
    jax.tree.map(np.testing.assert_array_equal, first, loop(True, 1, again=True))
