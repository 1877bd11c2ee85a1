"""A sensor that another package brings is at home in every command, and those of this one are read by the same text."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from glucoloop.build.surroundings import sensor_of
from glucoloop.sensors import SENSORS, IdealSensor, dead_time, white_noise
from glucoloop.sensors.protocol import site_of
from glucoloop.situations.run import Run
from glucoloop.situations.situation import Situation, configured
from glucoloop.trials.engine import prepare
from glucoloop.trials.trial import Trial, fingerprint

NAME = "your_own_sensor:LateSteps"


@pytest.fixture
def outside(install, tmp_path):
    """A folder with the module, and an entry point that names it."""
    install("your_own_sensor", "sensors", "late-steps", "LateSteps")
    return tmp_path


def test_it_is_found_by_its_entry_point_and_by_its_place(outside):
    assert "late-steps" in SENSORS.names()
    assert SENSORS.find("late-steps") == SENSORS.find(NAME)


@pytest.mark.parametrize("name", ["late-steps", NAME])
def test_it_reads_with_its_settings_and_noise_and_dead_time_are_around_it(outside, name):
    alone = sensor_of(configured(Situation, sensor=f"{name}, lag_min=10, step_mg_dl=5"))
    state = alone.init(jnp.asarray(100.0), jax.random.key(0))
    state, reading = alone.read(state, jnp.asarray(150.0), jax.random.key(1))
    assert reading.glucose_mg_dl == 5.0 * round((150.0 - 50.0 * np.exp(-0.5)) / 5.0)
    around = sensor_of(configured(Situation, sensor=[name, "white-noise", "dead-time, minutes=10"]))
    assert type(around.inner.inner) is type(alone)


def test_it_sees_the_glucose_of_the_site_that_is_asked_for(outside):
    assert site_of(sensor_of(configured(Situation, sensor=NAME))) is None
    chain = ["ideal, site=interstitial", NAME, "white-noise"]
    assert site_of(sensor_of(configured(Situation, sensor=chain))) == "interstitial"


def test_runs_and_trials_keep_it_with_all_its_settings(outside):
    whole = [{"name": NAME, "lag_min": 12.0, "step_mg_dl": 1.0}]
    run = configured(Run, sensor=f"{NAME}, lag_min=12", controller="basal")
    assert run.tree(whole=True)["sensor"] == whole
    assert configured(Run, run.tree()) == run
    trial = configured(Trial, sensor=f"{NAME}, lag_min=12", controller="basal", people=2)
    assert trial.tree(whole=True)["sensor"] == whole
    assert fingerprint(configured(Trial, trial.tree())) == fingerprint(trial)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("no_such_module:X", "no_such_module cannot be imported"),
        ("your_own_sensor:Reading", "your_own_sensor:Reading is no sensor: make it a class of SensorComponent"),
        ("nothing", "unknown sensor 'nothing'"),
        (f"{NAME}, lag_h=1", "the sensor late-steps has no setting 'lag_h'; did you mean 'lag_min'?"),
        (f"{NAME}, lag_min=0", "late-steps: lag_min is 0 min; give a finite number above 0 min"),
        ("white-noise, variance=-1", "variance is -1 (mg/dl)²; give a number from 0 to 10000 (mg/dl)²"),
        ("white-noise, variance=9e4", "--sensor: white-noise: variance is"),
        ("variance=1", "no sensor is named; begin with its name, like 'white-noise, variance=1.45'"),
    ],
)
def test_what_is_wrong_is_told(outside, refused, text, told):
    assert told in refused("run", "--controller", "basal", "--sensor", text)


@pytest.mark.long
def test_a_run_is_read_again_from_its_folder(outside, glucoloop):
    given = ("--controller", "basal", "--duration", "60", "--meal", "none", "--sensor", f"{NAME}, step_mg_dl=20")
    first = glucoloop("run", *given, "--out", "a", "--json")
    assert first.code == 0, first.err
    assert first.json["config"]["sensor"] == [{"name": NAME, "lag_min": 8.0, "step_mg_dl": 20.0}]
    again = glucoloop("run", "--config", "a/run.toml", "--allow-code", "--json").json
    assert again["config"] == first.json["config"]
    assert again["metrics"] == first.json["metrics"]


def test_sensors_of_this_package_make_a_chain_from_the_innermost_outwards():
    late = sensor_of(configured(Situation, sensor=["white-noise, variance=2, bound_mg_dl=3", "dead-time, minutes=10"]))
    assert late == dead_time(2, white_noise(2.0, 3.0))
    assert sensor_of(configured(Situation, sensor="ideal")) == sensor_of(Situation()) == IdealSensor()
    assert sensor_of(configured(Situation, sensor="dead-time, minutes=0")) == IdealSensor()


@pytest.mark.long
def test_a_trial_with_it_runs_in_native_code(outside):
    trial = configured(Trial, sensor=NAME, controller="pid", people=2, days=1)
    prepared = prepare(trial)
    assert prepared.engines == {"pid": {"engine": "native"}}
