"""A pump that another package brings is at home in every command, and its limits are known to controllers."""

from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from glucoloop.build.designs import controller_of
from glucoloop.build.surroundings import pump_of
from glucoloop.pumps import PUMPS, PumpComponent
from glucoloop.pumps.protocol import gives_bolus
from glucoloop.situations.run import Run
from glucoloop.situations.situation import Situation, configured
from glucoloop.trials.trial import Trial, fingerprint

NAME = "your_own_pump:TubePump"


@pytest.fixture
def outside(install, tmp_path):
    """A folder with the module, and an entry point that names it."""
    install("your_own_pump", "pumps", "soft-tube", "TubePump")
    return tmp_path


def limits_of(run):
    return (run.pump.max_insulin_mU_min, run.pump.max_change_mU_min, run.pump.min_insulin_mU_min)


def test_it_is_found_by_its_entry_point_and_by_its_place(outside):
    assert "soft-tube" in PUMPS.names()
    assert PUMPS.find("soft-tube") == PUMPS.find(NAME)


@pytest.mark.parametrize("name", ["soft-tube", NAME])
def test_it_delivers_with_its_settings_and_the_resolution_is_around_it(outside, name):
    pump = pump_of(configured(Situation, pump=f"{name}, lag_min=5, max_insulin_mU_min=30"))
    state = pump.init(jnp.asarray(20.0), jax.random.key(0))
    _, delivery = pump.deliver(state, jnp.asarray(40.0), jax.random.key(1))
    assert float(delivery.reported_mU_min) == 30.0  # the maximum rate of the run
    assert float(delivery.insulin_mU_min) == pytest.approx(30.0 - 10.0 * np.exp(-1.0))
    assert gives_bolus(pump)
    around = pump_of(configured(Situation, pump=f"{name}, resolution_mU_min=0.5"))
    assert type(around.inner) is type(pump)


def test_its_limits_are_the_defaults_of_a_run_and_reach_the_controller(outside):
    run = configured(Run, pump=NAME, controller="pid")
    assert limits_of(run) == (50.0, 10.0, 0.0)
    assert controller_of(run, run.case).limits.max_mU_min == 50.0
    assert limits_of(configured(Run, pump=f"{NAME}, max_insulin_mU_min=45", controller="pid")) == (45.0, 10.0, 0.0)
    assert limits_of(configured(Run, pump=NAME, patient="hovorka-2004")) == (50.0, 10.0, 0.0)


def test_runs_and_trials_keep_it_with_all_its_settings(outside):
    run = configured(Run, pump=NAME, controller="basal")
    assert run.tree(whole=True)["pump"]["name"] == NAME
    assert run.tree(whole=True)["pump"]["lag_min"] == 10.0
    assert configured(Run, run.tree()) == run
    trial = configured(Trial, pump=NAME, controller="basal", people=2)
    assert trial.pump.max_insulin_mU_min == 50.0
    assert fingerprint(configured(Trial, trial.tree())) == fingerprint(trial)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("no_such_module:X", "no_such_module cannot be imported"),
        ("your_own_pump:About", "your_own_pump:About is no pump: make it a class of PumpComponent"),
        ("nothing", "unknown pump 'nothing'"),
        (f"{NAME}, lag_h=1", "the pump soft-tube has no setting 'lag_h'; did you mean 'lag_min'?"),
        (f"{NAME}, lag_min=0", "soft-tube: lag_min is 0 min; give a finite number above 0 min"),
        ("resolution, step_mU_min=0.05", "--pump: resolution: step_mU_min is 0.05 mU/min; that looks like U/h"),
        ("expiring, samples=0", "samples is 0; give a whole number of 1 or more"),
        ("samples=1", "--pump: the pump limited has no setting 'samples'"),
    ],
)
def test_what_is_wrong_is_told(outside, refused, text, told):
    assert told in refused("run", "--controller", "basal", "--pump", text)


@pytest.mark.long
def test_a_run_is_read_again_from_its_folder(outside, glucoloop):
    given = ("--controller", "basal", "--duration", "60", "--meal", "none", "--pump", f"{NAME}, lag_min=20")
    first = glucoloop("run", *given, "--out", "a", "--json")
    assert first.code == 0, first.err
    assert first.json["config"]["pump"]["lag_min"] == 20.0
    again = glucoloop("run", "--config", "a/run.toml", "--allow-code", "--json").json
    assert again["config"] == first.json["config"]
    assert again["metrics"] == first.json["metrics"]


@pytest.mark.parametrize("text", ["limited", "resolution, step_mU_min=2, least_mU_min=4", "expiring, samples=3"])
def test_pumps_of_this_package_are_read_by_the_same_text(text):
    assert PUMPS.choose(PUMPS.choose(text).text) == PUMPS.choose(text)
    assert pump_of(configured(Situation, pump=text)).init(jnp.asarray(20.0), jax.random.key(0)) is not None


def test_the_pump_with_a_resolution_is_that_of_the_option():
    whole = [pump_of(configured(Situation, pump=text)) for text in ("resolution, step_mU_min=2", "resolution_mU_min=2")]
    assert jax.tree.structure(whole[0]) == jax.tree.structure(whole[1])
    assert jax.tree.leaves(whole[0]) == jax.tree.leaves(whole[1])
    assert pump_of(configured(Situation, pump="limited")) == pump_of(Situation())


def test_an_entry_with_a_limit_that_no_run_has_is_refused():
    with pytest.raises(TypeError, match="the pump x has a limit 'max_mU'; the known ones are: max_change_mU_min"):

        class X(PumpComponent, name="x"):
            own_limits: ClassVar = {"max_mU": 1.0}
