"""The adapter to Stable-Baselines3: what it returns is what the environment did."""

import importlib
import sys
import types

import gymnasium
import numpy as np
import pytest

from glucoloop.gym import ENVIRONMENT
from glucoloop.refusal import Refusal

DAY = {
    "patient": "hovorka-2004",
    "sensor": ["dexcom-g6"],
    "meals": ["45g@30min"],
    "announce_meals": True,
    "duration_min": 60.0,
}


class PlainVecEnv:
    """The base of Stable-Baselines3 as far as the adapter uses it, where that library, of gigabytes, is missing."""

    def __init__(self, num_envs, observation_space, action_space):
        self.num_envs, self.observation_space, self.action_space = num_envs, observation_space, action_space
        self.render_mode = self.get_attr("render_mode")[0]
        self._reset_seeds()

    def seed(self, seed=None):
        self._seeds = [seed + place for place in range(self.num_envs)]

    def _reset_seeds(self):
        self._seeds = [None] * self.num_envs

    def _reset_options(self):
        pass

    def _get_indices(self, indices):
        return range(self.num_envs) if indices is None else indices

    def step(self, actions):
        self.step_async(actions)
        return self.step_wait()


@pytest.fixture(scope="module")
def adapter():
    try:
        importlib.import_module("stable_baselines3.common.vec_env")
    except ModuleNotFoundError:
        for name in ("stable_baselines3", "stable_baselines3.common", "stable_baselines3.common.vec_env"):
            sys.modules[name] = types.ModuleType(name)
        sys.modules["stable_baselines3.common.vec_env"].VecEnv = PlainVecEnv
        yield importlib.import_module("glucoloop.gym.stable_baselines").StableBaselinesEnv
        for name in [*(name for name in sys.modules if name.startswith("stable_baselines3"))]:
            del sys.modules[name]
        del sys.modules["glucoloop.gym.stable_baselines"]
    else:
        yield importlib.import_module("glucoloop.gym.stable_baselines").StableBaselinesEnv


def vector(number, **changed):
    return gymnasium.make_vec(ENVIRONMENT, num_envs=number, **{**DAY, **changed})


def test_each_step_is_that_of_the_environment_and_the_next_person_begins_in_the_last_one(adapter):
    later, same = vector(3), adapter(vector(3, autoreset_mode="SameStep"))
    same.seed(5)
    seen = same.reset()
    np.testing.assert_array_equal(seen, later.reset(seed=5)[0])
    doses = np.tile(np.array([1.2, 0.1], np.float32), (3, 1))
    for sample in range(12):
        expected, reward, _, truncated, _ = later.step(doses)
        seen, rewards, done, infos = same.step(doses)
        np.testing.assert_array_equal(rewards, reward.astype(np.float32))
        np.testing.assert_array_equal(done, truncated)
        if sample < 11:
            np.testing.assert_array_equal(seen, expected)
            assert infos == [{}, {}, {}]
    assert done.all()
    for place, info in enumerate(infos):
        np.testing.assert_array_equal(info["terminal_observation"], expected[place])
        assert info["TimeLimit.truncated"] is True
    np.testing.assert_array_equal(seen, later.step(doses)[0])  # the first observation of the next people


def test_an_environment_that_waits_a_step_is_refused(adapter):
    with pytest.raises(Refusal, match='make the environment with autoreset_mode="SameStep"'):
        adapter(vector(1))
    with pytest.raises(Refusal, match="the autoreset_mode 'Disabled' is not possible; give one of NextStep, SameStep"):
        vector(1, autoreset_mode="Disabled")


def test_places_have_one_environment(adapter):
    env = adapter(vector(2, autoreset_mode="SameStep"))
    assert env.get_attr("num_envs") == [2, 2]
    assert env.env_is_wrapped(gymnasium.Wrapper) == [False, False]
    with pytest.raises(Refusal, match="speed cannot be set for a place"):
        env.set_attr("speed", 1)
    with pytest.raises(Refusal, match="render cannot be called for a place"):
        env.env_method("render")
    env.close()
