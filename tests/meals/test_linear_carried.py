"""Moments of meals of people, each jump taken once, against the sum over all jumps."""

import jax.numpy as jnp
import numpy as np
import pytest

from glucoloop.meals import Eaten, HovorkaGut, LehmannDeutsch, absorb
from glucoloop.meals.linear import carried_moments

PEOPLE = 4


@pytest.mark.long
@pytest.mark.parametrize("gut", [HovorkaGut, LehmannDeutsch])
def test_carried_moments_are_those_of_the_sum_over_all_jumps(gut):
    model = gut()
    if gut is HovorkaGut:
        model = HovorkaGut(
            time_to_maximum_min=jnp.array([30.0, 40.0, 55.0, 70.0]), bioavailability=jnp.array([0.7, 0.8, 1.0, 0.9])
        )
    eaten = Eaten(
        t_min=np.tile(np.array([[3.3], [61.0], [400.0]]), PEOPLE),  # the last one after the end
        carbs_g=np.tile(np.array([[50.0], [0.0], [40.0]]), PEOPLE),
        eating_min=np.zeros((3, PEOPLE)),
    )
    absorption = absorb(model, eaten)
    carried = carried_moments(absorption, 60, 2, 2.5)
    assert carried.shape == (60, 2, 3, PEOPLE)
    summed = np.broadcast_to(absorption.moments(60, 2, 2.5), carried.shape)
    assert np.asarray(carried) == pytest.approx(summed, abs=1e-9 * np.abs(summed).max())
