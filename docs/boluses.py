"""Give people boluses for their meals, with the guard and without, and write the table of ``guide/patients.md``.

    python docs/boluses.py

Carbohydrate is counted rightly, with an error, ten times too much, not at all, or announced and not eaten. It takes
some minutes and rewrites ``guide/guarded_boluses.md``.
"""

from pathlib import Path

import numpy as np
from made import made

import glucoloop as gl
from glucoloop.control import BasalBolus, GuardSettings, guarded
from glucoloop.therapy import Profile

PATIENT, PEOPLE, SEED = "hovorka-2004", 200, 2
MEALS = ((50.0, 60.0), (70.0, 360.0), (80.0, 720.0))
"""Grams and minutes: breakfast, lunch and dinner."""
MIN_EATEN_G = 0.001
SITUATIONS = {
    "counted exactly": lambda carbs: (carbs, carbs),
    "counted 30 % too little": lambda carbs: (carbs, 0.7 * carbs),
    "counted 30 % too much": lambda carbs: (carbs, 1.3 * carbs),
    "counted ten times too much": lambda carbs: (carbs, 10.0 * carbs),
    "not announced": lambda carbs: (carbs, 0.0),
    "announced and not eaten": lambda carbs: (MIN_EATEN_G, carbs),
}
COLUMNS = (
    "Meals",
    "Guard",
    "Below 54 mg/dl, mean min a day",
    "Worst, min",
    "Ever below 54, % of people",
    "From 70 to 180 mg/dl, mean %",
    "Insulin, median U a day",
)


def day(eaten_and_announced):
    meals = []
    for carbs, t_min in MEALS:
        eaten, announced = eaten_and_announced(carbs)
        meals.append(gl.Meal(eaten, t_min, announced_g=announced))
    return gl.Scenario(tuple(meals), horizon_min=1440.0, announced=True)


def row(name, guard, run, feasible):
    below = run.metrics.time_below_54_pct[feasible] * 14.4
    insulin = 1e-3 * run.metrics.insulin_total_mU[feasible]
    cells = (
        name,
        "with" if guard else "without",
        f"{below.mean():.1f}",
        f"{below.max():.0f}",
        f"{100.0 * (below > 0.0).mean():.1f}",
        f"{run.metrics.time_70_180_pct[feasible].mean():.1f}",
        f"{np.median(insulin):.1f}",
    )
    return f"| {' | '.join(cells)} |"


def main():
    people = gl.virtual_people(gl.population("boiroux2017", patient=PATIENT), seed=SEED, person=range(PEOPLE))
    feasible = people.feasible
    nominal = gl.patient(PATIENT)
    profile = Profile(basal_mU_min=float(nominal.basal_insulin_mU_min), setpoint_mg_dl=nominal.setpoint_mg_dl)
    alone = BasalBolus().of_person(profile)
    inside = guarded(alone, GuardSettings.for_route("subcutaneous"))
    lines = [f"| {' | '.join(COLUMNS)} |", f"| :--- | :--- |{' ---: |' * (len(COLUMNS) - 2)}"]
    for name, situation in SITUATIONS.items():
        for controller in (alone, inside):
            run = gl.simulate_people(people, controller, scenario=day(situation))
            lines.append(row(name, controller is inside, run, feasible))
            print(lines[-1], flush=True)
    text = "\n".join([*lines, "", f"{feasible.sum()} people of seed {SEED}, {made()}.", ""])
    (Path(__file__).resolve().parent / "guide" / "guarded_boluses.md").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
