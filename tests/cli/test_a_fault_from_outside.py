"""A fault that another package brings is at home in every command."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from glucoloop.build.surroundings import surroundings_of
from glucoloop.faults import FAULTS
from glucoloop.situations.situation import Situation, configured

NAME = "your_own_fault:Coarse"


@pytest.fixture
def outside(install, tmp_path):
    """A folder with the module, and an entry point that names it."""
    install("your_own_fault", "faults", "coarse", "Coarse")
    return tmp_path


def test_it_is_found_by_its_entry_point_and_by_its_place(outside):
    assert "coarse" in FAULTS.names()
    assert FAULTS.find("coarse") == FAULTS.find(NAME)


@pytest.mark.parametrize("name", ["coarse", NAME])
def test_it_is_around_the_sensor_while_it_is_there(outside, name):
    sensor = surroundings_of(configured(Situation, faults=[f"{name}, step_mg_dl=20, start_min=5"])).sensor
    glucose = jnp.asarray(87.0)
    state, told = sensor.init(glucose, jax.random.key(0)), []
    for sample in range(3):
        state, reading = sensor.read(state, glucose, jax.random.key(sample))
        told.append(float(reading.glucose_mg_dl))
    np.testing.assert_array_equal(told, [87.0, 80.0, 80.0])


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("no_such_module:X", "no_such_module cannot be imported"),
        ("your_own_fault:Reading", "your_own_fault:Reading is no fault: make it a class of FaultComponent"),
        ("nobody", "unknown fault 'nobody'"),
        (f"{NAME}, steps=1", "has no setting 'steps'; the known ones are: start_min, latest_min"),
        (f"{NAME}, step_mg_dl=0", "step_mg_dl is 0 mg/dl; give a finite number above 0 mg/dl"),
    ],
)
def test_what_is_wrong_is_told(outside, refused, text, told):
    assert told in refused("run", "--controller", "basal", "--fault", text)


@pytest.mark.long
def test_a_run_is_read_again_from_its_folder(outside, glucoloop):
    given = ("--controller", "basal", "--duration", "60", "--meal", "none", "--fault", f"{NAME}, start_min=20")
    first = glucoloop("run", *given, "--out", "a", "--json")
    assert first.code == 0, first.err
    assert first.json["config"]["faults"][0]["step_mg_dl"] == 10.0
    assert glucoloop("run", "--config", "a/run.toml", "--allow-code", "--json").json["config"] == first.json["config"]
