"""A linear policy that doses insulin, found by the cross-entropy method in the vector environment.

    python examples/policy_search.py [--generations 20]

It sees readings, announced carbohydrate and what the pump reports, and no more. It is trained on 64 people of seed 1
and compared on 500 people of seed 2, whom it has never met, with basal-bolus therapy, PID and the constant basal rate
from a trial of the same people.

R. Y. Rubinstein, "The cross-entropy method for combinatorial and continuous optimization", Methodology and Computing
in Applied Probability 1, 127-190, 1999.
"""

import argparse
import time

import gymnasium
import numpy as np

import glucoloop.gym
from glucoloop.situations.situation import configured
from glucoloop.trials.engine import prepare, run_people
from glucoloop.trials.trial import Trial

SITUATION = {
    "patient": "hovorka-2004",
    "sensor": ["dexcom-g6"],
    "announce_meals": True,
    "meals": ["45g@7h", "70g@12h", "60g@18h"],
    "meal_time_spread_min": 20.0,
    "meal_size_spread_pct": 20.0,
}
PEOPLE, CANDIDATES, ELITE = 64, 64, 8
START = np.array([0.0, 0.0, 0.0, 0.0, 0.0])
SPREAD = np.array([0.5, 1.0, 0.5, 0.3, 3.0])


def episode(env, weights, seed):
    """Sum of rewards ``(people,)`` and glucose ``(samples + 1, people)``; weights are ``(5, people)``."""
    seen, info = env.reset(seed=seed)
    at_rest = seen[:, 2].astype(float)  # each begins at steady state under the own basal rate [U a step]
    last, on_board = seen[:, 0], np.zeros(env.num_envs)
    total, there, glucose = np.zeros(env.num_envs), np.ones(env.num_envs, bool), [info["glucose_mg_dl"]]
    for _ in range(env.people.samples):
        reading, carbs = seen[:, 0], seen[:, 3]
        on_board = 0.96 * on_board + seen[:, 2] / at_rest - 1.0  # time constant of 2 h, in basal steps
        rate = 1.0 + weights[0] + weights[1] * (reading - 110.0) / 50.0 + weights[2] * (reading - last) / 10.0
        rate = np.maximum(rate - weights[3] * on_board / 12.0, 0.0)
        bolus = np.maximum(weights[4], 0.0) * carbs * at_rest
        last = reading
        seen, reward, terminated, _, info = env.step(np.stack([12.0 * at_rest * rate, bolus], axis=-1))
        total += np.where(there, reward, 0.0)
        there &= ~terminated
        glucose.append(np.where(there, info["glucose_mg_dl"], np.nan))
    return total, np.array(glucose)


def train(generations):
    """Weights of the policy, and the mean reward of each generation's best."""
    env = gymnasium.make_vec(
        glucoloop.gym.ENVIRONMENT, num_envs=CANDIDATES * PEOPLE, people=PEOPLE, reward="magni-risk", **SITUATION
    )
    random = np.random.default_rng(0)
    mean, spread = START, SPREAD
    for generation in range(generations):
        tried = mean[:, None] + spread[:, None] * random.standard_normal((mean.size, CANDIDATES))
        total, _ = episode(env, np.repeat(tried, PEOPLE, axis=1), seed=1)
        score = total.reshape(CANDIDATES, PEOPLE).mean(axis=1)
        best = tried[:, np.argsort(score)[-ELITE:]]
        mean, spread = best.mean(axis=1), best.std(axis=1) + 0.02 * SPREAD
        print(f"generation {generation + 1}: best {score.max():.0f}, weights {np.round(mean, 2)}", flush=True)
    return mean


def row(name, glucose):
    """A line of the table; a person whose episode was terminated counts as out of range from then on."""
    shares = [(glucose >= 70.0) & (glucose <= 180.0), glucose < 70.0, glucose < 54.0, glucose > 180.0]
    ended = np.isnan(glucose).any(axis=0).sum()
    return f"| {name} | " + " | ".join(f"{100.0 * share.mean():.1f}" for share in shares) + f" | {ended} |"


def compare(weights, people=500, seed=2):
    """Lines of a table: the policy and two controllers on the same people, who are new to the policy."""
    env = gymnasium.make_vec(glucoloop.gym.ENVIRONMENT, num_envs=people, **SITUATION)
    _, glucose = episode(env, np.repeat(weights[:, None], people, axis=1), seed)
    lines = [row("linear policy", glucose)]
    cases = ["basal-bolus", "pid", "basal"]
    trial = configured(Trial, {**SITUATION, "controller": cases, "people": people, "seed": seed})
    for case in cases:
        found = run_people(prepare(trial), case, np.arange(people), traces=True)
        lines.append(row(case, found.glucose_mg_dl[:, found.feasible]))
    return lines


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--generations", type=int, default=20)
    start = time.perf_counter()
    weights = train(parser.parse_args().generations)
    print(f"trained in {time.perf_counter() - start:.0f} s")
    print("| | 70-180 mg/dl [%] | below 70 [%] | below 54 [%] | above 180 [%] | ended |")
    print("| :--- | ---: | ---: | ---: | ---: | ---: |")
    print("\n".join(compare(weights)))
