"""Nights of the meal-aware controller, which expects meals at all hours or by the time of day.

    python benchmarks/meals_by_time.py
    python benchmarks/meals_by_time.py --table '0.57@06:00 0.05@22:00' --runs 100 --carbs 15

Nights begin at 22:00. A false alarm is a rise of the probability of a meal above one half on a night without a meal;
a meal at 2:00, of 50 g if not said otherwise, is found when it rises above that for the first time afterwards.
"""

from __future__ import annotations

import argparse
import dataclasses

import jax
import jax.numpy as jnp
import numpy as np

from glucoloop.build.designs import controller_of
from glucoloop.estimation.unknown_meal.replay import replay
from glucoloop.meals import Meal, Scenario
from glucoloop.sensors import CorrelatedNoise, WhiteNoise, white_noise
from glucoloop.simulation import simulate
from glucoloop.situations.case import default_case
from glucoloop.situations.situation import Situation

EVENING, EVENING_MIN, NIGHT_MIN, MEAL_MIN = "22:00", 22 * 60.0, 480.0, 240.0
VARIANCE = 1.45


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--table", default="0.57@06:00 0.02@22:00")
    parser.add_argument("--runs", type=int, default=30)
    parser.add_argument("--carbs", type=float, default=50.0, help="g of the meal")
    asked = parser.parse_args()
    situation = Situation(sensor=(WhiteNoise(variance=VARIANCE),), start=EVENING)
    case, person = default_case("meal-mpc", situation), situation.nominal
    setpoint = float(person.setpoint_mg_dl)
    keys = jax.vmap(jax.random.key)(np.arange(asked.runs))
    for prior, by_time in (("all hours", ""), (asked.table, asked.table)):
        told = dataclasses.replace(case, controller=dataclasses.replace(case.controller, meals_by_time=by_time))
        controller = controller_of(situation, told)
        for noise, sensor in (
            ("white", white_noise(VARIANCE)),
            ("correlated", CorrelatedNoise(9.0, 0.7)),
        ):

            @jax.jit
            @jax.vmap
            def night(key, carbs_g, controller=controller, sensor=sensor):
                scenario = Scenario([Meal(carbs_g, MEAL_MIN)], NIGHT_MIN, start_min=EVENING_MIN)
                trace = simulate(person, controller, sensor, scenario=scenario, key=key)
                t_min = 5.0 * jnp.arange(trace.insulin_mU_min.size)
                estimates = replay(
                    controller.model,
                    controller.estimator,
                    t_min,
                    trace.reading_mg_dl[: t_min.size],
                    trace.insulin_mU_min,
                    jnp.zeros_like(t_min),
                    person.basal_insulin_mU_min,
                    start_min=EVENING_MIN,
                )
                return trace.glucose_mg_dl, estimates.eating

            for what, carbs_g in (("no meal", 0.0), (f"{asked.carbs:g} g at 2:00", asked.carbs)):
                glucose, eating = map(np.asarray, night(keys, np.full(asked.runs, carbs_g)))
                above = eating > 0.5
                rises = above[:, 1:] & ~above[:, :-1]
                t_min = 5.0 * np.arange(eating.shape[1])
                under = setpoint - glucose.min(axis=1)
                text = f"undershoot {np.median(under):5.2f}, 95 % {np.percentile(under, 95):5.2f}"
                if carbs_g:
                    result = above & (t_min > MEAL_MIN)
                    delay = np.where(result.any(axis=1), t_min[result.argmax(axis=1)] - MEAL_MIN, np.nan)
                    over = glucose.max(axis=1) - setpoint
                    text += f", peak {np.median(over):5.2f} mg/dl; found after {np.nanmedian(delay):3.0f} min, "
                    text += f"at most {np.nanmax(delay):3.0f}, missed {np.isnan(delay).sum()}"
                else:
                    late = glucose[:, t_min.size // 2 :].mean() - setpoint
                    text += f", rest {late:5.2f} mg/dl; false alarms {rises.sum(axis=1).mean():.2f} a night"
                print(f"{prior:24s} {noise:11s} {what:13s} {text}", flush=True)


if __name__ == "__main__":
    main()
