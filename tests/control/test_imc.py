"""Internal model control: the filter is the closed loop, and a wrong gain leaves no offset."""

import jax
import numpy as np
import pytest

from glucoloop.control import Status, design_imc
from glucoloop.pumps import dose_limits
from glucoloop.simulation import simulate
from observing import observing

WIDE = dose_limits(max_change_mU_min=1e5, max_mU_min=1e6)
BASAL, START = 1000.0, 100.0
GAIN, TAU = -3.0, 80.0

step = jax.jit(lambda controller, state, observation: controller.step(state, observation))
observe = observing(setpoint=START)


class FirstOrder:
    """The plant ``y_k = a y_(k-1) + b u_(k-1-d)``, in deviations."""

    def __init__(self, gain, tau_min, delay):
        self.a = np.exp(-5.0 / tau_min)
        self.b = gain * (1.0 - self.a)
        self.y, self.line = 0.0, [0.0] * delay

    def feel(self, u):
        self.line.append(u)
        self.y = self.a * self.y + self.b * self.line.pop(0)


def respond(controller, plant, samples, *, setpoint=START, disturbance=0.0, lost=()):
    """Glucose and doses from rest, after a step of the setpoint or of a disturbance on the output."""
    state, delivered = controller.init(observe(START, BASAL, setpoint)), BASAL
    glucose, doses = [], []
    for k in range(samples):
        now = START + plant.y + disturbance
        reading = np.nan if k in lost else now
        state, decision = step(controller, state, observe(reading, delivered, setpoint, valid=k not in lost))
        delivered = float(decision.insulin_mU_min)
        plant.feel(delivered - BASAL)
        glucose.append(now)
        doses.append(delivered)
    return np.array(glucose), np.array(doses)


def filtered(delay, filter_min, samples):
    """What is left of a unit step: the loop follows after the dead time and the hold, by the filter alone."""
    since = np.arange(samples) - delay
    return np.where(since > 0, np.exp(-5.0 * since / filter_min), 1.0)


@pytest.mark.parametrize("delay", [0, 1, 3])
@pytest.mark.parametrize("filter_min", [1.0, 20.0])
def test_on_a_perfect_model_the_response_is_that_of_the_filter(delay, filter_min):
    controller = design_imc(GAIN, TAU, 5.0 * delay, WIDE, filter_min=filter_min)
    followed, _ = respond(controller, FirstOrder(GAIN, TAU, delay), 60, setpoint=START - 10.0)
    np.testing.assert_allclose(followed - START + 10.0, 10.0 * filtered(delay, filter_min, 60), atol=1e-9)
    held, _ = respond(controller, FirstOrder(GAIN, TAU, delay), 60, disturbance=15.0)
    np.testing.assert_allclose(held - START, 15.0 * filtered(delay, filter_min, 60), atol=1e-9)


@pytest.mark.parametrize(
    ("gain", "tau", "delay"), [(-4.5, 80.0, 1), (-2.0, 80.0, 1), (-3.0, 50.0, 2), (-4.0, 120.0, 0)]
)
def test_a_wrong_model_leaves_no_offset(gain, tau, delay):
    controller = design_imc(GAIN, TAU, 5.0, WIDE, filter_min=30.0)
    glucose, doses = respond(controller, FirstOrder(gain, tau, delay), 400, setpoint=90.0, disturbance=12.0)
    assert glucose[-1] == pytest.approx(90.0, abs=1e-6)
    assert doses[-1] - BASAL == pytest.approx(-22.0 / gain, rel=1e-6)


def test_a_dead_time_that_is_not_known_costs_an_overshoot_and_a_known_one_none():
    told, untold = (design_imc(GAIN, TAU, 5.0 * known, WIDE, filter_min=20.0) for known in (3, 0))
    smooth, _ = respond(told, FirstOrder(GAIN, TAU, 3), 100, setpoint=90.0)
    swung, _ = respond(untold, FirstOrder(GAIN, TAU, 3), 100, setpoint=90.0)
    assert smooth.min() >= 90.0 - 1e-9
    assert swung.min() < 89.0


def test_on_a_perfect_model_lost_readings_change_nothing():
    controller = design_imc(GAIN, TAU, 5.0, WIDE, filter_min=20.0)
    whole, _ = respond(controller, FirstOrder(GAIN, TAU, 1), 40, disturbance=15.0)
    gaps, _ = respond(controller, FirstOrder(GAIN, TAU, 1), 40, disturbance=15.0, lost={2, 3, 4, 9, 20})
    np.testing.assert_allclose(gaps, whole, rtol=1e-12)


def test_what_the_pump_cuts_does_not_wind_up():
    """The internal model feels what was delivered: at the limit it is still the plant."""
    limits = dose_limits(max_change_mU_min=3.0, min_mU_min=BASAL - 5.0, max_mU_min=BASAL + 5.0)
    controller, plant = design_imc(GAIN, TAU, 10.0, limits), FirstOrder(GAIN, TAU, 2)
    state, delivered = controller.init(observe(START, BASAL)), BASAL
    for _ in range(60):
        state, decision = step(controller, state, observe(START + plant.y + 40.0, delivered))
        assert float(state.model_mg_dl) == pytest.approx(plant.y, abs=1e-9)
        delivered = float(decision.insulin_mU_min)
        plant.feel(delivered - BASAL)
    assert int(decision.status) == Status.SATURATED
    assert delivered == BASAL + 5.0
    # The disturbance goes: the first answer is already down, at the full rate.
    _, decision = step(controller, state, observe(START + plant.y, delivered))
    assert float(decision.insulin_mU_min) == BASAL + 2.0


def test_it_wakes_at_rest_under_whatever_is_delivered():
    controller = design_imc(GAIN, TAU, 5.0)
    state = controller.init(observe(START, 40.0))
    for _ in range(5):
        state, decision = step(controller, state, observe(START, 40.0))
        assert float(decision.insulin_mU_min) == 40.0
        assert int(decision.status) == Status.OK


def test_table_i(patient_81, undershoot_and_settling):
    # as fitted to the answer to a lasting step of 11.165 mU/min
    controller = design_imc(-3.450035, 89.1459, 5.0, filter_min=1.0)
    undershoot, settling = undershoot_and_settling(simulate(patient_81, controller).fine_glucose_mg_dl, 81.1, 0.02)
    assert undershoot == pytest.approx(8.7, abs=0.3)
    assert settling == pytest.approx(386, abs=12)


@pytest.mark.parametrize(
    ("changed", "sentence"),
    [
        ({"gain": 0.0}, r"gain of 0 mg/dl per mU/min is not possible; insulin lowers glucose"),
        ({"gain": np.nan}, "gain of nan"),
        ({"gain": -np.inf}, "gain of -inf"),
        ({"tau_min": 0.0}, "lag of 0 min is not possible; give a finite value above 0"),
        ({"tau_min": -80.0}, "lag of -80 min"),
        ({"gain": 3.0}, r"gain of 3 mg/dl per mU/min is not possible; insulin lowers glucose.*below 0"),
        ({"tau_min": np.inf}, "lag of inf min"),
        ({"filter_min": 0.0}, "filter of 0 min is not possible; give a finite value above 0"),
        ({"filter_min": np.nan}, "filter of nan min"),
        ({"delay_min": 7.0}, "dead time of 7 min is not possible; give a multiple of the sample time, 5 min"),
        ({"delay_min": -5.0}, "dead time of -5 min"),
        ({"delay_min": np.nan}, "dead time of nan min"),
        ({"delay_min": np.inf}, "dead time of inf min"),
        ({"sample_time_min": 0.0}, "sample time of 0 min is not possible; give a finite value above 0"),
        ({"sample_time_min": -5.0}, "sample time of -5 min"),
        ({"sample_time_min": np.nan}, "sample time of nan min"),
    ],
)
def test_what_cannot_be_designed_is_refused(changed, sentence):
    with pytest.raises(ValueError, match=sentence):
        design_imc(**{"gain": GAIN, "tau_min": TAU, "delay_min": 5.0, **changed})
