"""Numbers of NumPy and JAX in a component, as a text and as plain values."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import glucoloop as gl
from glucoloop.sensors import SENSORS


@pytest.mark.parametrize("variance", [np.float64(2.5), np.float32(2.5), jnp.asarray(2.5), np.array(2.5), 2.5])
def test_a_number_is_a_plain_number(variance):
    sensor = gl.white_noise(1.45).replaced(variance=variance)
    assert str(sensor) == "white-noise, variance=2.5, bound_mg_dl=5"
    assert SENSORS.choose(sensor.text).variance == 2.5


@pytest.mark.parametrize("made", [np.array, jnp.array])
def test_numbers_of_people_are_a_list(made):
    sensor = gl.white_noise(1.45).replaced(variance=made([1.0, 2.5]))
    assert str(sensor) == "white-noise, variance=[1, 2.5], bound_mg_dl=5"
    assert sensor.tree(whole=True)["variance"] == [1.0, 2.5]


def test_a_number_that_is_traced_has_a_text():
    texts = []
    jax.jit(lambda variance: texts.append(str(gl.white_noise(variance))) or variance)(1.0)
    assert texts[0].startswith("white-noise, variance=")
