"""Train a policy by PPO of Stable-Baselines3 on 256 people side by side, and measure it on people it never met.

The policy sees the reading, its change, insulin on board and announced carbohydrate, and scales what basal-bolus
therapy would give: the person's basal rate by 0 to 2, and the bolus of the rule of 500 by 0 to 2. Training takes some
minutes on two cores; the same seed gives the same weights.

    pip install 'glucoloop[rl]'
    python examples/train_ppo.py [ROUNDS]
"""

import sys

import gymnasium
import numpy as np
import torch
from gymnasium.spaces import Box
from stable_baselines3 import PPO
from stable_baselines3.common.utils import set_random_seed

import glucoloop.gym

ROUNDS = int(sys.argv[1]) if len(sys.argv) > 1 else 24
PEOPLE, STEPS, UNSEEN = 256, 288, 500
SITUATION = {
    "patient": "hovorka-2004",
    "sensor": ["dexcom-g6"],
    "meals": ["45g@7h", "70g@12h", "60g@18h"],
    "meal_size_spread_pct": 20.0,
    "meal_time_spread_min": 30.0,
    "announce_meals": True,
}
DECAY = np.exp(-5.0 / 90.0)
"""Part of the insulin on board that is left after a step of 5 min."""


class AroundTherapy(gymnasium.vector.VectorWrapper):
    """Actions from -1 to 1 around basal-bolus therapy, and observations of about the size of 1."""

    def __init__(self, env):
        super().__init__(env)
        self.single_action_space = Box(-1.0, 1.0, (2,), np.float32)
        self.single_observation_space = Box(-10.0, 10.0, (6,), np.float32)
        names = ("reading_mg_dl", "insulin_U", "announced_g", "time_of_day_min")
        self.columns = [env.unwrapped.observation_names.index(name) for name in names]

    def reset(self, **options):
        seen, info = self.env.reset(**options)
        self.reading, self.on_board = np.zeros((2, self.num_envs))
        self.basal_U, self.carbs_g = np.ones((2, self.num_envs))
        return self.features(seen, np.ones(self.num_envs, bool)), info

    def step(self, actions):
        bolus_U = self.carbs_g * 288 * 2 * self.basal_U / 500  # rule of 500, half of the daily dose being basal
        scale = 1.0 + np.clip(actions, -1.0, 1.0)
        doses = np.stack([12 * self.basal_U * scale[:, 0], bolus_U * scale[:, 1]], axis=-1)
        seen, reward, terminated, truncated, info = self.env.step(doses)
        ended = terminated | truncated
        if ended.any():
            last = np.array([seen[i] if of_end is None else of_end for i, of_end in enumerate(info["final_obs"])])
            last = self.features(last, np.zeros(self.num_envs, bool), keep=False)
            for place in np.flatnonzero(ended):
                info["final_obs"][place] = last[place]
        return self.features(seen, ended), reward, terminated, truncated, info

    def features(self, seen, begins, keep=True):
        """What the policy sees; the insulin of a person who begins is the basal rate."""
        reading, insulin, carbs, time = seen[:, self.columns].T.astype(float)
        basal = np.where(begins, insulin, self.basal_U)
        change = np.where(begins, 0.0, reading - self.reading)
        on_board = np.where(begins, 0.0, DECAY * self.on_board + insulin - basal)
        if keep:
            self.reading, self.basal_U, self.on_board, self.carbs_g = reading, basal, on_board, carbs
        day = 2.0 * np.pi * time / 1440.0
        rows = (
            (reading - 120.0) / 80.0,
            change / 10.0,
            on_board / (20.0 * basal),
            carbs / 50.0,
            np.sin(day),
            np.cos(day),
        )
        return np.clip(np.stack(rows, axis=-1), -10.0, 10.0).astype(np.float32)


def world(first_person, people):
    """People of a seed, side by side."""
    made = gymnasium.make_vec(
        glucoloop.gym.ENVIRONMENT,
        num_envs=people,
        autoreset_mode="SameStep",
        first_person=first_person,
        **SITUATION,
    )
    return AroundTherapy(made)


def measure(name, policy):
    """One day of people who took no part in the training, under a policy of observations."""
    env = world(1_000_000, UNSEEN)
    seen, _ = env.reset(seed=2)
    glucose = []
    for _ in range(STEPS):
        seen, _, _, _, info = env.step(policy(seen))
        glucose.append(info.get("final_info", info)["glucose_mg_dl"])
    glucose = np.array(glucose)
    inside, low = (glucose >= 70) & (glucose <= 180), glucose.min(axis=0)
    print(
        f"{name:<16} 70-180 mg/dl {100 * inside.mean():.1f} %, below 70 {100 * (glucose < 70).mean():.2f} %, "
        f"above 180 {100 * (glucose > 180).mean():.1f} %, people ever below 54 {100 * (low < 54).mean():.1f} %"
    )


set_random_seed(1)
torch.set_num_threads(1)
agent = PPO(
    "MlpPolicy",
    glucoloop.gym.StableBaselinesEnv(world(0, PEOPLE)),
    n_steps=STEPS,
    batch_size=PEOPLE * STEPS // 16,
    n_epochs=6,
    learning_rate=2e-3,
    gamma=0.98,
    gae_lambda=0.98,
    policy_kwargs={"net_arch": [32, 32], "log_std_init": -0.5},
    seed=1,
    device="cpu",
)
agent.learn(total_timesteps=ROUNDS * PEOPLE * STEPS)
measure("PPO", lambda seen: agent.predict(seen, deterministic=True)[0])
measure("basal-bolus", lambda seen: np.zeros((len(seen), 2)))
