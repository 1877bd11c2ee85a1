"""What jumps of meals add to steps: piece by piece of a run, and by a gut that native code lacks."""

import jax.numpy as jnp
import numpy as np
import pytest

from glucoloop._pytree import pytree
from glucoloop.meals import Eaten, HovorkaGut, LehmannDeutsch, absorb
from glucoloop.meals.absorption import JumpsInSteps

RNG = np.random.default_rng(4)
PEOPLE, STEPS, STEP_MIN = 9, 96, 2.5
MEALS = Eaten(
    t_min=RNG.uniform(0.0, 260.0, (5, PEOPLE)),
    carbs_g=RNG.choice([0.0, 0.4, 30.0, 90.0], (5, PEOPLE)),
    eating_min=RNG.choice([0.0, 25.0], (5, PEOPLE)),
)


@pytest.mark.parametrize("gut", [LehmannDeutsch(), HovorkaGut()])
@pytest.mark.parametrize("cut", [1, 40, 95])
def test_pieces_of_a_run_are_the_whole(gut, cut):
    jumps = JumpsInSteps(absorb(gut, MEALS), STEP_MIN)
    whole = jumps.table(0, STEPS).dense()
    pieces = [jumps.table(0, cut).dense(), jumps.table(cut, STEPS - cut).dense()]
    np.testing.assert_array_equal(np.concatenate(pieces), whole)
    assert np.count_nonzero(whole)


@pytree
class SortingGut(LehmannDeutsch):
    """The same gut, by way of a sort, which native code does not have."""

    def propagator(self, z_min):
        return super().propagator(jnp.sort(jnp.stack([z_min, z_min]), axis=0)[0])


def test_a_gut_that_native_code_lacks_is_left_to_jax():
    known, sorting = (
        JumpsInSteps(absorb(gut, MEALS), STEP_MIN).table(0, STEPS).dense() for gut in (LehmannDeutsch(), SortingGut())
    )
    np.testing.assert_allclose(sorting, known, rtol=1e-11, atol=1e-9)
