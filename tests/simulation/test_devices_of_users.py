"""Sensors, pumps and metrics of users that a loop cannot use: a sentence in place of an error of JAX."""

import jax.numpy as jnp
import pytest

import glucoloop as gl
from glucoloop.metrics import Metric
from glucoloop.metrics.metric import Result
from glucoloop.pumps.limits import PumpAround
from glucoloop.pumps.protocol import Delivery
from glucoloop.sensors import Reading
from glucoloop.sensors.protocol import SensorAround
from glucoloop.simulation.user_objects import wrong_with_pump, wrong_with_sensor
from naming import naming


def sensor(read=None, init=lambda self, glucose, key: glucose):
    """A class of sensors with these methods."""
    return type("Mine", (SensorAround,), {"init": init, **({"read": read} if read else {})})


def reading(glucose, **other):
    return Reading(**{"glucose_mg_dl": glucose, "valid": jnp.isfinite(glucose), **other})


def pump(deliver):
    """A class of pumps with this method."""
    return type("Mine", (PumpAround,), {"init": lambda self, rate, key: rate, "deliver": deliver})


def delivery(rate, **other):
    return Delivery(**{"insulin_mU_min": rate, "reported_mU_min": rate, **other})


def loop(**parts):
    controller = gl.design_pid(gl.PIDTuning(0.5, 150.0))
    return gl.simulate(gl.patient(), controller, scenario=gl.Scenario([], 60.0), **parts)


def test_sensors_that_cannot_be_read_are_refused_in_a_sentence():
    for message, read in {
        "^Mine.read is called as read.state, glucose_mg_dl, key.*too many": lambda self, state, glucose: None,
        "^Mine.read has to return its new state and a Reading, .state, reading., and": lambda self, s, g, key: reading(
            g
        ),
        "^Mine.read has to return its new state and a Reading": lambda self, s, g, key: (s, g),
        "^glucose_mg_dl of the Reading of Mine has shape .1,. for one": lambda self, s, g, key: (s, reading(g[None])),
        "^valid of the Reading of Mine is a float64": lambda self, s, g, key: (s, reading(g, valid=g)),
        "^the state of Mine changes its structure": lambda self, s, g, key: ((s,), reading(g)),
        "^the state of Mine changes its type.*read makes float32": lambda self, s, g, key: (
            s.astype("float32"),
            reading(g),
        ),
        "^Mine asks for the value of a number .line": lambda self, s, g, key: (s, reading(g)) if g > 0 else None,
    }.items():
        made = sensor(read)()
        for whole in (made, gl.sensors.Lag(inner=made)):
            with naming(message), pytest.raises(TypeError, match=message):
                loop(sensor=whole)


def test_methods_that_a_device_lacks_are_named():
    lacks = "Mine has no method read; write read(state, glucose_mg_dl, key)"
    assert wrong_with_sensor(sensor()(), jnp.array(100.0)) == lacks
    assert wrong_with_pump(pump(None)(), jnp.array(20.0)) == (
        "Mine has no method deliver; write deliver(state, command_mU_min, key)"
    )


def test_pumps_that_cannot_deliver_are_refused_in_a_sentence():
    for message, deliver in {
        "^Mine.deliver is called as deliver.state, command_mU_min, key": lambda self, state: None,
        "^Mine.deliver has to return its new state and a Delivery, .state, delivery.": lambda self, s, rate, key: rate,
        "^insulin_mU_min of the Delivery of Mine has shape .1,.": lambda self, s, rate, key: (s, delivery(rate[None])),
        "^the state of Mine changes its structure": lambda self, s, rate, key: ((s,), delivery(rate)),
    }.items():
        with naming(message), pytest.raises(TypeError, match=message):
            loop(pump=pump(deliver)())


def test_an_error_within_a_device_is_its_own():
    def read(self, state, glucose, key):
        raise KeyError("of the user")

    with pytest.raises(KeyError, match="of the user"):
        loop(sensor=sensor(read)())


class Odd(Metric, name="odd"):
    """A metric of which each test has its own methods."""

    numbers = (Result("odd_pct", "Odd.", "Odd", "%"),)

    def init(self, trajectory, glucose_mg_dl, insulin_mU_min):
        return jnp.zeros_like(glucose_mg_dl)

    def finish(self, trajectory, state, ended):
        return {"odd_pct": state}


def test_metrics_that_give_no_numbers_are_refused_in_a_sentence():
    trace = loop()
    for message, methods in {
        "^the metric odd has no method finish; write": {"finish": Metric.finish},
        "^the metric odd has no method init; write": {"init": Metric.init},
        "^finish of the metric odd returns NoneType": {"finish": lambda *of: None},
        "^odd_pct of the metric odd has shape .3,.; it has to be one number": {
            "finish": lambda *of: {"odd_pct": jnp.ones(3)}
        },
        "^odd_pct of the metric odd is 'x'": {"finish": lambda *of: {"odd_pct": "x"}},
        "^the metric .*Odd.* asks for the value of a number": {
            "point": lambda self, trajectory, state, g, t: state + 1 if g > 0 else state
        },
    }.items():
        with naming(message), pytest.MonkeyPatch.context() as patch:
            for name, method in methods.items():
                patch.setattr(Odd, name, method, raising=False)
            with pytest.raises(ValueError, match=message):
                gl.summarise(trace, metrics=[f"{__name__}:Odd"])


def test_a_declaration_that_is_not_one_is_refused_in_a_sentence(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    head = "from glucoloop.plugin import ControllerComponent\nclass Mine(ControllerComponent, name='mine'):\n    "
    for number, (line, message) in enumerate(
        {
            "gain: float = 1.0": "the setting gain does not say what it means; annotate it",
            "gain: float": "the setting gain of Mine has no default; give it one",
        }.items()
    ):
        (tmp_path / f"declared_{number}.py").write_text(head + line)
        with naming(line), pytest.raises(gl.Refusal, match=f"declared_{number}:Mine is no controller: {message}"):
            gl.run(controller=f"declared_{number}:Mine", duration=60)
