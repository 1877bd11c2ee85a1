"""The meal told sample by sample, against the one whose beginning and size are known."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from glucoloop.meals import Eaten, LehmannDeutsch, absorb, appearance_mg_min, appearance_moments
from glucoloop.meals.lehmann_deutsch import PLATEAU_MG_MIN
from glucoloop.meals.stomach import (
    FAST_GUT_MIN,
    MEALS,
    SERVED_G_PER_MIN,
    announce,
    digest,
    empty_stomach,
    gut_of,
    nothing_announced,
    serve,
)

H = 5.0


def digested(served, gut=None):
    """Moments ``(samples, 3)`` and emptying ``(samples,)`` at the end of each sample, of what is served in each."""

    def one(stomach, share):
        stomach, moments = digest(stomach, share, H, gut)
        return stomach, (moments, stomach.emptying_mg_min)

    last, told = jax.lax.scan(one, empty_stomach(jnp.zeros(()), H), jnp.asarray(served, float))
    return last, *map(np.asarray, told)


@pytest.mark.long
@pytest.mark.parametrize(("samples_served", "begins"), [(6, 0), (10, 3), (28, 10), (55, 2)])
def test_a_meal_on_the_grid_is_that_of_lehmann_and_deutsch(samples_served, begins):
    served = np.zeros(120)
    served[begins : begins + samples_served] = 1.0
    _, moments, empties = digested(served)
    size_g, begin_min = H * samples_served * SERVED_G_PER_MIN, H * begins
    eaten = Eaten(t_min=jnp.array([begin_min]), carbs_g=jnp.array([size_g]), eating_min=jnp.zeros(1))
    kinks = absorb(LehmannDeutsch(), eaten)
    truth = np.array([appearance_moments(H * k, H, kinks) for k in range(served.size)])
    # The rate is exact at the beginning, middle and end of a sample; between them a parabola stands for an exponential.
    # Of a ramp of 12 mg/min^2 its cubic part is 12 h^3 / (6 T^2), a sixtieth of which is missing of the first moment.
    cubic = 12.0 * H**3 / (360.0 * 60.0**2)
    np.testing.assert_allclose(moments[:, 0], truth[:, 0], rtol=1e-4, atol=0.01 * cubic)
    np.testing.assert_allclose(moments, truth, rtol=0, atol=2.0 * cubic)  # two ramps may begin at once
    middle = appearance_mg_min(H * begins + 32.5, kinks)
    np.testing.assert_allclose(moments[begins + 6] @ [1.0, 0.0, -2.5], middle, rtol=1e-9)
    np.testing.assert_allclose(empties.max(), PLATEAU_MG_MIN, rtol=1e-12)
    np.testing.assert_allclose(empties[begins + samples_served + 5 :], 0.0, atol=1e-9)


@pytest.mark.long
def test_a_fast_gut_is_that_of_lehmann_and_deutsch_with_half_the_ramp_and_half_the_time():
    served = np.zeros(60)
    served[3:11] = 1.0
    _, moments, _ = digested(served, gut_of(FAST_GUT_MIN, H))
    eaten = Eaten(t_min=jnp.array([15.0]), carbs_g=jnp.array([8 * H * SERVED_G_PER_MIN]), eating_min=jnp.zeros(1))
    kinks = absorb(LehmannDeutsch(ramp_min=15.0, gut_time_constant_min=30.0), eaten)
    truth = np.array([appearance_moments(H * k, H, kinks)[0] for k in range(served.size)])
    cubic = 24.0 * H**3 / (360.0 * 30.0**2)  # as above
    np.testing.assert_allclose(moments[:, 0], truth, rtol=1e-4, atol=0.01 * cubic)


def test_a_gut_between_two_is_emptied_whole_too():
    served = np.concatenate([np.random.default_rng(1).uniform(0.0, 2.0, 60), np.zeros(100)])
    last, moments, _ = digested(served, gut_of(jnp.asarray(42.0), H))
    np.testing.assert_allclose(
        H * moments[:, 0].sum() + float(last.gut_mg), H * PLATEAU_MG_MIN * served.sum(), rtol=1e-6
    )


def test_a_small_meal_empties_evenly_and_whole():
    served = np.zeros(300)
    served[[2, 3]] = 1.0  # 3.6 g, of which the other meal has ramps of ten minutes
    _, moments, empties = digested(served)
    assert empties.max() == pytest.approx(PLATEAU_MG_MIN / 3.0)
    assert H * moments[:, 0].sum() == pytest.approx(3600.0, rel=1e-6)


def test_what_is_served_appears_in_the_end():
    served = np.concatenate([np.random.default_rng(0).uniform(0.0, 2.0, 60), np.zeros(100)])
    last, moments, _ = digested(served)
    eaten_mg = H * PLATEAU_MG_MIN * served.sum()
    np.testing.assert_allclose(H * moments[:, 0].sum() + float(last.gut_mg), eaten_mg, rtol=1e-6)
    assert float(last.gut_mg) < 1e-2 * eaten_mg


@pytest.mark.parametrize("amounts", [[50.0], [3.0, 0.7], [80.0] * MEALS, [20.0] * (MEALS + 3)])
def test_an_announced_meal_is_served_whole(amounts):
    told = jnp.asarray(amounts + [0.0] * (200 - len(amounts)))
    last, served = jax.lax.scan(lambda held, g: serve(announce(held, g), H), nothing_announced(jnp.zeros(())), told)
    assert float(jnp.sum(served)) * H * SERVED_G_PER_MIN == pytest.approx(sum(amounts), rel=1e-12)
    assert float(jnp.sum(last.remaining_min)) == 0.0


@pytest.mark.parametrize("amount", [np.nan, np.inf, -np.inf, -5.0, 0.0])
def test_an_announcement_that_cannot_be_is_not_believed(amount):
    announced = announce(nothing_announced(jnp.zeros(())), jnp.asarray(amount))
    assert float(jnp.max(jnp.abs(announced.remaining_min))) == 0.0
