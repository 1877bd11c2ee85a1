"""A loop belongs to the classes of its parts, also where two of them have the same fields."""

import jax.numpy as jnp

from glucoloop._pytree import pytree
from glucoloop.simulation.parts import apart


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
