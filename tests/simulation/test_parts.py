"""A loop belongs to the classes of its parts, also where two of them have the same fields."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import glucoloop as gl
from glucoloop._pytree import pytree
from glucoloop.arguments import ArgumentTypeError
from glucoloop.control.protocol import Decision
from glucoloop.simulation.user_objects import apart


@pytree
class One:
    x: float = 1.0

    def value(self):
        return self.x


@pytree
class Other:
    x: float = 1.0

    def value(self):
        return 2.0 * self.x


def test_two_classes_with_the_same_fields_are_two_loops():
    (numbers, one), (_, other) = apart((One(), jnp.ones(2))), apart((Other(), jnp.ones(2)))
    assert one != other
    assert one == apart((One(x=3.0), jnp.zeros(2)))[1]
    assert other.joined(numbers)[0].value() == 2.0 * one.joined(numbers)[0].value()


class Plain:
    sample_time_min = 5.0

    def init(self, observation):
        return observation.delivered_mU_min


@jax.tree_util.register_static
@dataclasses.dataclass(frozen=True)
class BranchesOnAReading(Plain):
    def step(self, state, observation):
        rate = 10.0
        if observation.glucose_mg_dl > 90.0:
            rate = 30.0
        return state, Decision(insulin_mU_min=rate + 0.0 * state, status=jnp.asarray(0))


@jax.tree_util.register_static
@dataclasses.dataclass(frozen=True)
class TakesNumPy(Plain):
    def step(self, state, observation):
        return state, Decision(insulin_mU_min=np.log(observation.glucose_mg_dl), status=jnp.asarray(0))


@pytest.mark.parametrize("kind", [BranchesOnAReading, TakesNumPy])
def test_a_controller_that_asks_for_a_value_is_told_what_to_write(kind):
    with pytest.raises(ArgumentTypeError, match=rf"{kind.__name__} asks .*test_parts\.py.*jnp\.where.*jax\.lax\.cond"):
        gl.simulate(gl.patient(), kind(), scenario=gl.Scenario([], 10.0))
