"""Meals that are announced before they are eaten: who hears of them when."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from glucoloop._pytree import pytree, static
from glucoloop.control import LoopLike, Oref0
from glucoloop.control.decision import MEALS, hear, no_meals_to_come
from glucoloop.control.guard import guarded
from glucoloop.control.pace import paced
from glucoloop.control.protocol import Decision, Observation, Status
from glucoloop.control.real_time import observation
from glucoloop.therapy import Profile

PROFILE = Profile(basal_mU_min=10.0, setpoint_mg_dl=110.0, carb_ratio_g_U=10.0, correction_mg_dl_U=40.0)


def told(carbs_g=0.0, in_min=0.0, glucose=110.0):
    numbers = jnp.asarray((glucose, 110.0, 10.0, carbs_g, 0.0, in_min), float)
    return Observation(
        glucose_mg_dl=numbers[0],
        valid=jnp.asarray(True),
        setpoint_mg_dl=numbers[1],
        delivered_mU_min=numbers[2],
        announced_carbs_g=numbers[3],
        delivered_bolus_mU=numbers[4],
        announced_in_min=numbers[5],
    )


heard = jax.jit(lambda to_come, seen: hear(to_come, seen, seen.announced_carbs_g, 5.0))


@pytest.mark.long
@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(st.sampled_from([0.0, 0.0, 20.0, 50.0]), st.floats(0.0, 60.0)), min_size=1, max_size=20))
def test_a_meal_begins_in_the_sample_in_which_it_is_eaten(announcements):
    """Against a list of meals and their times, which has room for all."""
    to_come, expected = no_meals_to_come(told()), np.zeros(len(announcements) + 13)
    waiting = 0
    for sample, (carbs_g, in_min) in enumerate(announcements):
        expected[sample + int(in_min // 5.0)] += carbs_g
        waiting = max(waiting, np.count_nonzero(expected[sample + 1 :]))
    begun = []
    for carbs_g, in_min in [*announcements, *[(0.0, 0.0)] * 13]:
        to_come, begins = heard(to_come, told(carbs_g, in_min))
        begun.append(float(begins))
    assert sum(begun) == pytest.approx(expected.sum())  # nothing is lost, whatever the number
    several = sum(carbs_g > 0.0 and in_min >= 5.0 for carbs_g, in_min in announcements)
    if several <= MEALS:
        np.testing.assert_allclose(begun, expected)


@settings(max_examples=30, deadline=None)
@given(st.floats(0.0, 200.0))
def test_a_meal_that_is_eaten_at_once_is_heard_to_the_bit(carbs_g):
    assert hear(None, told(carbs_g), carbs_g, 5.0) == (None, carbs_g)
    assert float(heard(no_meals_to_come(told()), told(carbs_g))[1]) == carbs_g


@pytest.mark.parametrize("word", [np.nan, np.inf, -5.0, 1e30])
def test_a_time_that_is_not_possible_is_none(word):
    to_come, begins = heard(no_meals_to_come(told()), told(30.0, word))
    assert float(begins) == 30.0
    assert not np.any(to_come.carbs_g)


@pytest.mark.parametrize("word", [np.nan, np.inf, -np.inf, -3e38, 3e38])
def test_a_memory_that_is_lost_heals(word):
    lost = jax.tree.map(lambda leaf: jnp.full_like(leaf, word), no_meals_to_come(told()))
    for _ in range(2):
        lost, begins = heard(lost, told())
        assert np.isfinite(float(begins))
    assert float(begins) == 0.0
    assert all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves(lost))


@pytree
class Told:
    """A controller whose state is what it was told last."""

    sample_time_min: float = static(default=5.0)
    gives_boluses = True

    def init(self, observation):
        return observation

    def step(self, state, observation):
        del state
        zero = jnp.zeros_like(observation.delivered_mU_min)
        return observation, Decision(insulin_mU_min=zero + 10.0, status=zero.astype(int) + Status.OK, bolus_mU=zero)


def last_told(controller, *observations):
    state = controller.init(observations[0])
    for seen in observations:
        state, _ = controller.step(state, seen)
    return state.inner


@pytest.mark.long
def test_a_guard_passes_the_time_on_and_nothing_impossible():
    controller = guarded(Told(), basal_mU_min=10.0)
    assert float(last_told(controller, told(), told(40.0, 20.0)).announced_in_min) == 20.0
    assert float(last_told(controller, told(), told(40.0, np.nan)).announced_in_min) == 0.0
    without = dataclasses.replace(told(40.0), announced_in_min=None)
    assert last_told(controller, without).announced_in_min is None


def test_a_slow_controller_is_told_when_the_first_meal_is_eaten():
    controller = paced(Told(sample_time_min=15.0), 5.0)
    since = told(), told(20.0, 12.0), told(10.0, 30.0), told()
    seen = last_told(controller, *since)
    assert (float(seen.announced_carbs_g), float(seen.announced_in_min)) == (30.0, 2.0)
    assert float(last_told(controller, *since, told(), told(), told()).announced_in_min) == 0.0


def test_the_wire_carries_the_time():
    words = {"setpoint_mg_dl": 110.0, "delivered_mU_min": 10.0, "announced_carbs_g": 30.0}
    assert observation(110.0, **words).announced_in_min is None
    assert float(observation(110.0, **words, announced_in_min=15).announced_in_min) == 15.0
    assert np.isnan(observation(110.0, **words, announced_in_min="soon").announced_in_min)


@pytest.mark.long
def test_loop_like_forecasts_a_meal_to_come_as_one_that_begins_later():
    controller = LoopLike().of_person(PROFILE)
    rises = []
    for in_min in (0.0, 30.0):
        seen = told(60.0, in_min)
        rises.append(np.asarray(controller.glucose_ahead(controller.observed(controller.init(told()), seen))))
    at_once, later = rises
    np.testing.assert_allclose(later[6:], at_once[:-6], rtol=1e-9)
    np.testing.assert_allclose(later[:8], 110.0)


@pytest.mark.long
def test_oref0_gives_the_bolus_at_the_announcement_and_knows_of_the_carbohydrate_when_it_is_eaten():
    controller = Oref0().of_person(PROFILE)
    step = jax.jit(controller.step)
    state, eaten, boluses = controller.init(told()), [], []
    for seen in (told(), told(50.0, 15.0), told(), told(), told(), told()):
        state, decision = step(state, seen)
        eaten.append(float(state.carbs_g[0]))
        boluses.append(float(decision.bolus_mU))
    assert eaten == [0.0, 0.0, 0.0, 0.0, 50.0, 0.0]
    assert boluses[1] == pytest.approx(5000.0, rel=0.01)
