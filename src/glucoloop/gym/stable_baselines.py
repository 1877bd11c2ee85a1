"""Adapter of the vector environment to Stable-Baselines3, whose algorithms take their own kind of it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from glucoloop.refusal import Refusal, needed_for

with needed_for("an environment of Stable-Baselines3"):
    from gymnasium.vector import AutoresetMode, VectorEnv
    from stable_baselines3.common.vec_env import VecEnv


class StableBaselinesEnv(VecEnv):  # type: ignore[misc] # its base has no types where it is not installed
    """People of a vector environment of Gymnasium as a ``VecEnv``, for algorithms such as PPO.

    The people stay side by side in native code; what an algorithm learns of each is the last observation of an ended
    episode, and whether it was cut at the end of the run.

    Parameters
    ----------
    env : gymnasium.vector.VectorEnv
        The environment, perhaps within wrappers, made with ``autoreset_mode="SameStep"``.

    Raises
    ------
    Refusal
        For an environment whose places get the next person at the next step.
    """

    def __init__(self, env: VectorEnv[Any, Any, Any]) -> None:
        if env.metadata.get("autoreset_mode") is not AutoresetMode.SAME_STEP:
            raise Refusal(
                "Stable-Baselines3 wants the next person in the step in which an episode ends; make the environment "
                'with autoreset_mode="SameStep"'
            )
        self.env = env
        self._actions: npt.NDArray[Any] | None = None
        super().__init__(env.num_envs, env.single_observation_space, env.single_action_space)

    def reset(self) -> npt.NDArray[np.float32]:
        """Let the next person begin in every place; after ``seed(n)`` the first ones of that seed."""
        observation, _ = self.env.reset(seed=self._seeds[0])
        self._reset_seeds()
        self._reset_options()
        return np.asarray(observation)

    def step_async(self, actions: npt.NDArray[Any]) -> None:
        """Keep the actions of the coming step."""
        self._actions = actions

    def step_wait(self) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32], npt.NDArray[np.bool_], list[Any]]:
        """Dose everybody until the next sample."""
        observation, reward, terminated, truncated, info = self.env.step(self._actions)
        done = terminated | truncated
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for place in np.flatnonzero(done):
            infos[place]["terminal_observation"] = info["final_obs"][place]
            infos[place]["TimeLimit.truncated"] = bool(truncated[place])
        return np.asarray(observation), np.asarray(reward, np.float32), done, infos

    def close(self) -> None:
        """Close the environment."""
        self.env.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """The environment's attribute, once for each place."""
        return [getattr(self.env, attr_name) for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Refuse to change the attribute of some places, which have one environment."""
        raise Refusal(f"{attr_name} cannot be set for a place: all people are in one environment; make another one")

    def env_method(self, method_name: str, *method_args: Any, indices: Any = None, **method_kwargs: Any) -> list[Any]:
        """Refuse to call a method of some places, which have one environment."""
        raise Refusal(f"{method_name} cannot be called for a place: all people are in one environment; call env's own")

    def env_is_wrapped(self, wrapper_class: type[Any], indices: Any = None) -> Sequence[bool]:
        """Whether there is a wrapper of a class around each place alone: never."""
        return [False for _ in self._get_indices(indices)]
