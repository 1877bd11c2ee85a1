"""A pump that another package brings is at home in every command, and its limits are known to controllers."""

from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from glucoloop.config.cases import CASES_KEY
from glucoloop.config.run import overlay, read_run
from glucoloop.config.trial import read_trial, trial_keys

from glucoloop.experiments.designs import controller_of
from glucoloop.experiments.surroundings import pump_of
from glucoloop.parts.pumps import LIMITS, PUMPS, PumpPart
from glucoloop.pumps.protocol import gives_bolus
from glucoloop.situations.situation import Situation

NAME = "your_own_pump:TubePump"


@pytest.fixture
def outside(install, tmp_path):
    """A folder with the module, and an entry point that names it."""
    install("your_own_pump", "pumps", "soft-tube", "TubePump")
    return tmp_path


def in_a_file(run):
    """Keys of a run as its file has them."""
    return dict(run.given)


def limits_of(run):
    return {key: getattr(run.situation, key) for key in LIMITS}


def test_it_is_found_by_its_entry_point_and_by_its_place(outside):
    assert "soft-tube" in PUMPS.names()
    assert PUMPS.find("soft-tube") == PUMPS.find(NAME)


@pytest.mark.parametrize("name", ["soft-tube", NAME])
def test_it_delivers_with_its_settings_and_the_resolution_is_around_it(outside, name):
    pump = pump_of(Situation(pump=f"{name}, lag_min=5", max_insulin_mU_min=30.0))
    state = pump.init(jnp.asarray(20.0), jax.random.key(0))
    _, delivery = pump.deliver(state, jnp.asarray(40.0), jax.random.key(1))
    assert float(delivery.reported_mU_min) == 30.0  # the greatest rate of the run
    assert float(delivery.insulin_mU_min) == pytest.approx(30.0 - 10.0 * np.exp(-1.0))
    assert gives_bolus(pump)
    around = pump_of(Situation(pump=name, pump_resolution_mU_min=0.5))
    assert type(around.inner) is type(pump)


def test_its_limits_are_the_defaults_of_a_run_and_reach_the_controller(outside):
    run = read_run({"pump": NAME, "controller": "pid"})
    assert (run.situation.max_insulin_mU_min, run.situation.max_change_mU_min) == (50.0, 10.0)
    assert controller_of(run.situation.situation(), run.case.case()).limits.max_mU_min == 50.0
    assert limits_of(read_run({"pump": NAME, "controller": "pid", "max_insulin_mU_min": 45.0})) == {
        **limits_of(run),
        "max_insulin_mU_min": 45.0,
    }


def test_another_pump_over_a_file_brings_its_own_limits(outside):
    usual, own = read_run({"controller": "basal"}), read_run({"controller": "basal", "pump": NAME})
    assert read_run(overlay(in_a_file(usual), {"pump": NAME})) == own
    assert read_run(overlay(in_a_file(own), {"pump": "limited"})) == usual
    # what differs from the usual was given on purpose, and stays
    given = read_run({"controller": "basal", "max_insulin_mU_min": 45.0})
    assert read_run(overlay(in_a_file(given), {"pump": NAME})).situation.max_insulin_mU_min == 45.0


def test_another_patient_over_a_file_keeps_the_limits_of_the_pump(outside):
    own = read_run({"controller": "basal", "pump": NAME})
    assert limits_of(read_run(overlay(in_a_file(own), {"patient": "hovorka-2004"}))) == limits_of(
        read_run({"controller": "basal", "pump": NAME, "patient": "hovorka-2004"})
    )


def test_runs_and_trials_keep_it_with_all_its_settings(outside):
    run = read_run({"pump": NAME, "controller": "basal"})
    assert run.situation.pump == f"{NAME}, lag_min=10"
    assert read_run(run.keys()) == run
    trial = read_trial({"pump": NAME, "controllers": ["basal"], "people": 2})
    assert (trial.pump, trial.max_insulin_mU_min) == (f"{NAME}, lag_min=10", 50.0)
    keys = trial_keys(trial)
    assert read_trial(keys, keys.pop(CASES_KEY)) == trial


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("no_such_module:X", "no_such_module cannot be imported"),
        ("your_own_pump:SoftTube", "your_own_pump:SoftTube is no pump: make it a class of PumpPart"),
        ("nothing", "unknown pump 'nothing'"),
        (f"{NAME}, lag=1", "the pump soft-tube has no setting 'lag'; did you mean 'lag_min'?"),
        (f"{NAME}, lag_min=0", "soft-tube: lag_min is 0 min; give a finite number above 0 min"),
        ("resolution, step_mU_min=0.05", "step_mU_min of the pump resolution"),
        ("expiring, samples=0", "samples is 0; give a whole number of 1 or more"),
        ("samples=1", "nothing names no pump; begin with its name, like 'expiring, samples=3'"),
    ],
)
def test_what_is_wrong_is_told(outside, refused, text, told):
    assert told in refused("run", "--controller", "basal", "--pump", text)


@pytest.mark.long
def test_a_run_is_read_again_from_its_folder(outside, glucoloop):
    given = ("--controller", "basal", "--duration", "60", "--no-meal", "--pump", f"{NAME}, lag_min=20")
    first = glucoloop("run", *given, "--out", "a", "--json")
    assert first.code == 0, first.err
    assert first.json["config"]["pump"] == f"{NAME}, lag_min=20"
    again = glucoloop("run", "--config", "a/run.toml", "--allow-code", "--json").json
    assert again["config"] == first.json["config"]
    assert again["metrics"] == first.json["metrics"]


@pytest.mark.parametrize("text", ["limited", "resolution, step_mU_min=2, least_mU_min=4", "expiring, samples=3"])
def test_pumps_of_this_package_are_read_by_the_same_text(text):
    assert PUMPS.choose(PUMPS.choose(text).text) == PUMPS.choose(text)
    assert pump_of(Situation(pump=text)).init(jnp.asarray(20.0), jax.random.key(0)) is not None


def test_the_pump_with_a_resolution_is_that_of_the_option():
    assert pump_of(Situation(pump="resolution, step_mU_min=2")) == pump_of(Situation(pump_resolution_mU_min=2.0))
    assert pump_of(Situation(pump="limited")) == pump_of(Situation())


def test_an_entry_with_a_limit_that_no_run_has_is_refused():
    with pytest.raises(TypeError, match="the pump x has a limit 'max_mU'; the known ones are: max_change_mU_min"):

        class X(PumpPart, name="x"):
            limits: ClassVar = {"max_mU": 1.0}
