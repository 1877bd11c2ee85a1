"""A sensor that another package brings is at home in every command, and those of this one are read by the same text."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from glucoloop.config.cases import CASES_KEY
from glucoloop.config.run import read_run
from glucoloop.config.trial import read_trial, trial_keys

from glucoloop.cohorts.engine import prepare
from glucoloop.experiments.surroundings import sensor_of
from glucoloop.parts.sensors import SENSORS
from glucoloop.sensors.protocol import site_of
from glucoloop.situations.situation import Situation

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
    alone = sensor_of(Situation(sensor=f"{name}, lag_min=10, step_mg_dl=5"))
    state = alone.init(jnp.asarray(100.0), jax.random.key(0))
    state, reading = alone.read(state, jnp.asarray(150.0), jax.random.key(1))
    assert reading.glucose_mg_dl == 5.0 * round((150.0 - 50.0 * np.exp(-0.5)) / 5.0)
    around = sensor_of(Situation(sensor=name, noise_variance=1.45, dead_time_samples=2))
    assert type(around.inner.inner) is type(alone)


def test_it_sees_the_glucose_of_the_site_that_is_asked_for(outside):
    assert site_of(sensor_of(Situation(sensor=NAME))) is None
    assert site_of(sensor_of(Situation(sensor=NAME, site="interstitial", noise_variance=1.0))) == "interstitial"


def test_runs_and_trials_keep_it_with_all_its_settings(outside):
    text = f"{NAME}, lag_min=12, step_mg_dl=1"
    run = read_run({"sensor": f"{NAME}, lag_min=12", "controller": "basal"})
    assert run.situation.sensor == text
    assert read_run(run.keys()) == run
    trial = read_trial({"sensor": f"{NAME}, lag_min=12", "controllers": ["basal"], "people": 2})
    assert trial.sensor == text
    keys = trial_keys(trial)
    assert read_trial(keys, keys.pop(CASES_KEY)) == trial


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("no_such_module:X", "no_such_module cannot be imported"),
        ("your_own_sensor:LateSensor", "your_own_sensor:LateSensor is no sensor: make it a class of SensorPart"),
        ("nothing", "unknown sensor 'nothing'"),
        (f"{NAME}, lag=1", "the sensor late-steps has no setting 'lag'; did you mean 'lag_min'?"),
        (f"{NAME}, lag_min=0", "late-steps: lag_min is 0 min; give a finite number above 0 min"),
        ("white-noise, variance=-1", "variance is -1 (mg/dl)²; give a finite number of 0 (mg/dl)² or more"),
        ("white-noise, variance=9e4", "variance of the sensor white-noise"),
        ("variance=1", "nothing names no sensor; begin with its name, like 'white-noise, variance=1.45'"),
    ],
)
def test_what_is_wrong_is_told(outside, refused, text, told):
    assert told in refused("run", "--controller", "basal", "--sensor", text)


@pytest.mark.long
def test_a_run_is_read_again_from_its_folder(outside, glucoloop):
    given = ("--controller", "basal", "--duration", "60", "--no-meal", "--sensor", f"{NAME}, step_mg_dl=20")
    first = glucoloop("run", *given, "--out", "a", "--json")
    assert first.code == 0, first.err
    assert first.json["config"]["sensor"] == f"{NAME}, lag_min=8, step_mg_dl=20"
    again = glucoloop("run", "--config", "a/run.toml", "--allow-code", "--json").json
    assert again["config"] == first.json["config"]
    assert again["metrics"] == first.json["metrics"]


@pytest.mark.parametrize(
    ("text", "by_keys"),
    [
        ("ideal", {}),
        ("white-noise, variance=1.45", {"noise_variance": 1.45}),
        ("white-noise, variance=2, bound_mg_dl=3", {"noise_variance": 2.0, "noise_bound_mg_dl": 3.0}),
        ("dead-time, samples=2", {"dead_time_samples": 2}),
    ],
)
def test_sensors_of_this_package_are_those_of_the_options(text, by_keys):
    assert sensor_of(Situation(sensor=text)) == sensor_of(Situation(**by_keys))
    assert SENSORS.choose(SENSORS.choose(text).text) == SENSORS.choose(text)


def test_a_trial_with_it_runs_in_native_code(outside):
    trial = read_trial({"sensor": NAME, "controllers": ["pid"], "people": 2, "days": 1})
    prepared = prepare(trial)
    assert prepared.engines == {"pid": {"engine": "native"}}
