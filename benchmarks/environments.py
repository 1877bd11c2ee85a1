"""Measure steps a second of the environment for Gymnasium, beside that of simglucose in the same run.

    python benchmarks/environments.py [--json] [--people N ...]

Days of 5-min steps with three meals, the monitor Dexcom G6 and a constant action: people of hovorka-2004 and of
uva-padova-2008, the model of simglucose. simglucose 0.2.11 has one person at a time and 3-min steps (its environment
for Gymnasium, adult#001); it is installed from PyPI beside ours. Steps a second of all people and simulated days a
second are compared; times are those of the clock, the best of some repeats.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np

import glucoloop.gym

sys.path.append(str(Path(__file__).parents[1] / "tests/shared"))

from other_programs import answer_of

PATIENTS = ("hovorka-2004", "uva-padova-2008")
MIN_PER_DAY = 1440.0
REPEATS = 3
SIMGLUCOSE = """
import logging, time, warnings
warnings.filterwarnings("ignore")
logging.disable(logging.CRITICAL)
from datetime import datetime
from simglucose.envs.simglucose_gym_env import T1DSimGymnaisumEnv
from simglucose.simulation.scenario import CustomScenario
env = T1DSimGymnaisumEnv(
    patient_name="adult#001", custom_scenario=CustomScenario(start_time=datetime(2024, 1, 1), scenario=[(7, 45)])
)
env.reset(seed=1)
taken = []
for _ in range(asked["repeats"]):
    env.reset()
    start = time.perf_counter()
    for step in range(asked["steps"]):
        env.step(0.02)  # an array of one number is more than its integrator takes in newer versions of SciPy
    taken.append((time.perf_counter() - start) / asked["steps"])
print(json.dumps(min(taken)))
"""


def step_s(patient: str, people: int) -> float:
    """Seconds of one step of all people, the best of some repeats."""
    env = gymnasium.make_vec(
        glucoloop.gym.ENVIRONMENT,
        num_envs=people,
        patient=patient,
        sensor=["dexcom-g6"],
        announce_meals=True,
    )
    seen, _ = env.reset(seed=1)
    basal_U_h = seen[:, env.observation_names.index("insulin_U")] * 12.0
    action = np.stack([basal_U_h, np.zeros(people)], axis=-1)
    steps, taken = (20 if people > 10_000 else 95), []
    env.step(action)
    for _ in range(REPEATS):
        start = time.perf_counter()
        for _ in range(steps):
            env.step(action)
        taken.append((time.perf_counter() - start) / steps)
    return min(taken)


def measured(numbers: list[int]) -> list[dict[str, Any]]:
    """Rows of the table, simglucose first."""
    one = float(answer_of("simglucose", SIMGLUCOSE, {"steps": 100, "repeats": REPEATS}))
    rows: list[dict[str, Any]] = [
        {"environment": "simglucose 0.2.11", "people": 1, "steps_s": 1.0 / one, "days_s": 3.0 / MIN_PER_DAY / one}
    ]
    for patient in PATIENTS:
        for people in numbers:
            rate = people / step_s(patient, people)
            rows.append({"environment": patient, "people": people, "steps_s": rate, "days_s": rate * 5.0 / MIN_PER_DAY})
    return [{**row, "times": row["steps_s"] / rows[0]["steps_s"]} for row in rows]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", action="store_true", help="plain data")
    parser.add_argument("--people", type=int, nargs="+", default=[1, 1000, 100_000], metavar="N")
    asked = parser.parse_args()
    result = measured(asked.people)
    if asked.json:
        print(json.dumps(result, indent=1))
        return
    print("| environment | people | steps/s | days/s | steps/s of simglucose |\n| :--- | ---: | ---: | ---: | ---: |")
    for row in result:
        print("| {environment} | {people} | {steps_s:.0f} | {days_s:.2f} | {times:.1f} times |".format(**row))


if __name__ == "__main__":
    main()
