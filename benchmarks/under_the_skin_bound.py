"""Search for the doses that keep people of `under_the_skin.py` in range for longest, of all that are possible.

    python benchmarks/under_the_skin_bound.py [--json] [--people N] [--seed N] [--patient NAME ...] [--days N]

Each sample of 5 min may have any dose, so a bolus too, and the person is known exactly. Meals are known from their
first minute (start), or all in advance (advance). The search is SciPy's L-BFGS-B over all doses at once, with the
derivatives of the simulation, for the least sum of distances from the range, of which those below cost ten times as
much, rounded off within 5 mg/dl. What it finds can be reached by who knows everything; there may be
better doses.
"""

from __future__ import annotations

import argparse
import json
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import scipy.optimize
from under_the_skin import MOST, PATIENTS, trial_of

from glucoloop.bounds.course import course_of
from glucoloop.cohorts import engine
from glucoloop.meals import Meal, Scenario
from glucoloop.simulation.varying import chosen, replaced, varying

SAMPLE_MIN = 5.0
LOW_MG_DL, HIGH_MG_DL = 72.0, 178.0
"""The range less a margin, within which nothing costs."""
DEARER_BELOW = 10.0
ROUNDED_MG_DL = 5.0


def glucose_of(basal_rates: jax.Array, basal_mU_min: Any, plant: Any, outside: Any, state: jax.Array) -> jax.Array:
    """Glucose at each minute under doses ``(samples,)`` in multiples of the basal rate."""

    def one(x: jax.Array, entry: Any) -> Any:
        return plant.advance(x, *entry)

    return jax.lax.scan(one, state, (basal_mU_min * basal_rates[:, None], outside))[1].ravel()


def cost(basal_rates: jax.Array, *run: Any) -> jax.Array:
    """Mean rounded distance of glucose from the range."""
    glucose = glucose_of(basal_rates, *run)
    above, below = jnp.maximum(glucose - HIGH_MG_DL, 0.0), jnp.maximum(LOW_MG_DL - glucose, 0.0)
    rounded = (jnp.sqrt(far * far + ROUNDED_MG_DL**2) - ROUNDED_MG_DL for far in (above, DEARER_BELOW * below))
    return jnp.mean(sum(rounded, jnp.zeros_like(glucose)))


glucose_now = jax.jit(glucose_of)
slope_now = jax.jit(jax.value_and_grad(cost))


def best(patient: Any, meals: list[Meal], horizon_min: float, *, in_advance: bool) -> np.ndarray[Any, Any]:
    """Glucose under the best doses that were found; those before a meal is known are of the plan without it."""
    count = round(horizon_min / SAMPLE_MIN)
    doses = np.ones(count)
    run: tuple[Any, ...] = ()
    for known in [len(meals)] if in_advance else range(1, len(meals) + 1):
        first = 0 if in_advance else int(np.ceil(meals[known - 1].t_min / SAMPLE_MIN - 1e-9))
        course = course_of(patient, Scenario(meals, horizon_min), SAMPLE_MIN, [meals[:known]])
        run = (course.resting_mU_min, course.plant, course.exogenous(0), jnp.asarray(course.state))
        given = doses[:first]

        def free(
            later: np.ndarray[Any, Any], given: np.ndarray[Any, Any] = given, run: tuple[Any, ...] = run
        ) -> tuple[float, np.ndarray[Any, Any]]:
            value, slope = slope_now(np.concatenate([given, later]), *run)
            return float(value), np.asarray(slope)[given.size :]

        found = scipy.optimize.minimize(
            free,
            doses[first:],
            jac=True,
            method="L-BFGS-B",
            bounds=[(0.0, None)] * (count - first),
            options={"maxiter": 400, "maxfun": 600, "ftol": 1e-9, "gtol": 1e-7},
        )
        doses = np.concatenate([given, found.x])
    return np.asarray(glucose_now(doses, *run))


def measured(family: str, people: int, seed: int, days: int) -> list[dict[str, Any]]:
    """Times in ranges of some people of a family under the best doses, by when meals are known."""
    trial = trial_of(f"{family}, announced, white", people, seed, "basal-bolus", days=days)
    number = np.arange(min(people, MOST.get(family, people)))
    drawn, lived = engine.people_of(trial, number), trial.drawn_days(number)
    varies = varying(drawn.patient, trial.nominal)
    rows = []
    for known in ("start", "advance"):
        inside, low, lowest = [], [], []
        for i in number[drawn.feasible]:
            patient = replaced(drawn.patient, varies, [leaf[..., i] for leaf in chosen(drawn.patient, varies)])
            meals = [Meal(float(lived.carbs_g[m, i]), float(lived.t_min[m, i])) for m in np.argsort(lived.t_min[:, i])]
            glucose = best(patient, meals, trial.horizon_min, in_advance=known == "advance")
            inside.append(100.0 * np.mean((glucose >= 70.0) & (glucose <= 180.0)))
            low.append(100.0 * np.mean(glucose < 70.0))
            lowest.append(glucose.min())
        rows.append(
            {
                "family": family,
                "known": known,
                "seed": seed,
                "days": days,
                "people": len(inside),
                "time_70_180_pct": float(np.mean(inside)),
                "time_below_70_pct": float(np.mean(low)),
                "ever_below_54_pct": 100.0 * float(np.mean(np.array(lowest) < 54.0)),
            }
        )
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", action="store_true", help="print the figures as JSON")
    parser.add_argument("--people", type=int, default=20)
    parser.add_argument("--seed", type=int, default=4)
    parser.add_argument("--days", type=int, default=1)
    parser.add_argument("--patient", action="append", choices=list(PATIENTS), help="by default all")
    asked = parser.parse_args()
    rows = [
        row for family in asked.patient or PATIENTS for row in measured(family, asked.people, asked.seed, asked.days)
    ]
    if asked.json:
        print(json.dumps(rows, indent=2))
        return
    print("| family | meals known | people | 70-180, % | < 70, % | ever < 54, % |")
    print("| :--- | :--- | ---: | ---: | ---: | ---: |")
    for row in rows:
        shown = [f"{row[name]:.1f}" for name in ("time_70_180_pct", "time_below_70_pct", "ever_below_54_pct")]
        print("| " + " | ".join([row["family"], row["known"], str(row["people"]), *shown]) + " |")


if __name__ == "__main__":
    main()
