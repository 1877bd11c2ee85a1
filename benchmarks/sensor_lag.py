"""Control with a sensor that lags: undershoot and peak after 50 g of a controller that is told of the lag, and is not.

python benchmarks/sensor_lag.py meal-mpc                30 runs with a lag of 10 min and noise of variance 1.45
python benchmarks/sensor_lag.py mpc-se --lag 15 --runs 100
"""

from __future__ import annotations

import argparse
import dataclasses

import jax
import numpy as np

from glucoloop.build.designs import controller_of
from glucoloop.meals import Meal, Scenario
from glucoloop.sensors import Lag, WhiteNoise, white_noise
from glucoloop.simulation import simulate
from glucoloop.situations.case import default_case
from glucoloop.situations.situation import Situation

VARIANCE = 1.45


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("controller", choices=("mpc-se", "nlqdmc-se", "meal-mpc"))
    parser.add_argument("--lag", type=float, default=10.0, help="minutes")
    parser.add_argument("--runs", type=int, default=30)
    asked = parser.parse_args()
    situation = Situation(sensor=(WhiteNoise(variance=VARIANCE),))
    case, person = default_case(asked.controller, situation), situation.nominal
    setpoint = float(person.setpoint_mg_dl)
    scenario = Scenario([Meal(50.0, 60.0)], 600.0)
    keys = jax.vmap(jax.random.key)(np.arange(asked.runs))
    prompt = white_noise(VARIANCE)
    for name, known_min, sensor in (
        ("no lag", 0.0, prompt),
        ("a lag, untold", 0.0, Lag(asked.lag, inner=prompt)),
        ("a lag, told", asked.lag, Lag(asked.lag, inner=prompt)),
    ):
        told = dataclasses.replace(case, controller=dataclasses.replace(case.controller, sensor_lag_min=known_min))
        controller = controller_of(situation, told)

        def glucose(key, controller=controller, sensor=sensor):
            return simulate(person, controller, sensor, scenario=scenario, key=key).glucose_mg_dl

        runs = np.asarray(jax.jit(jax.vmap(glucose))(keys))
        under, over = setpoint - runs.min(axis=1), runs.max(axis=1) - setpoint
        most = np.percentile(under, 95)
        numbers = f"undershoot {np.median(under):5.2f}, 95 % {most:5.2f}, peak {np.median(over):5.2f} mg/dl"
        print(f"{asked.controller:10s} {name:14s} {numbers}", flush=True)


if __name__ == "__main__":
    main()
