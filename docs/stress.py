"""Turn stress tests into the tables that ``guide/guard.md`` shows.

    glucoloop stress --people 300 --controller imc --controller mpc --controller mpc-se --out linear
    glucoloop stress --people 300 --controller nlqdmc-se --controller meal-mpc --out nonlinear
    python docs/stress.py linear/summary.json nonlinear/summary.json

It rewrites ``guide/stress_figures.md``: the faults from the folders, and what the guard costs a day without one from
trials that it carries out.
"""

import json
import sys
from pathlib import Path

import numpy as np
from made import NAMES, made

from glucoloop.reporting.descriptions import short_names
from glucoloop.situations.situation import configured
from glucoloop.trials import engine
from glucoloop.trials.trial import Trial

PEOPLE, SEED = 1000, 0
"""Those of the day without a fault."""


def cell(bare, guarded):
    """Without the guard -> with it, and by how much more at most with it."""
    most = f" ({guarded['worst_more_pct']:.1f})" if guarded["worse"] else ""
    return f"{bare['worse']} → {guarded['worse']}{most}"


def faults(rows):
    result = {(row["controller"], row["guarded"], row["fault"]): row for row in rows}
    controllers = list(dict.fromkeys(row["controller"] for row in rows))
    names = short_names(list(dict.fromkeys(row["fault"] for row in rows if row["fault"])))
    yield f"| Fault | {' | '.join(NAMES[name] for name in controllers)} |"
    yield f"| :--- |{' ---: |' * len(controllers)}"
    for fault, name in names.items():
        cells = [cell(*(result[controller, guarded, fault] for guarded in (False, True))) for controller in controllers]
        yield f"| {name} | {' | '.join(cells)} |"


def lowest(rows):
    """How many of the cells with the guard have anybody below 54 mg/dl, and the lowest glucose of all."""
    guarded = [row for row in rows if row["guarded"]]
    low = sum(row["ever_below_54_pct"] > 0.0 for row in guarded)
    worst = min(guarded, key=lambda row: row["lowest_mg_dl"])
    under = {"": "no fault", **short_names([row["fault"] for row in guarded if row["fault"]])}[worst["fault"]]
    return (
        f"With the guard {'somebody' if low else 'nobody'} is below 54 mg/dl in {low or 'any'} of the {len(guarded)} "
        f"cells, those without a fault included; the lowest glucose is {worst['lowest_mg_dl']:.1f} mg/dl, of person "
        f"{worst['lowest_person']} under {NAMES[worst['controller']]} ({under})."
    )


def day(name, noise):
    """A day with three meals and no fault under a controller, without the guard and with it."""
    cases = [f"{name}, label=bare", f"{name}, label=guarded, guard=usual"]
    sensor = [f"white-noise, variance={noise}"] if noise else []
    trial = configured(Trial, people=PEOPLE, seed=SEED, sensor=sensor, controller=cases)
    prepared = engine.prepare(trial)
    result = [engine.run_people(prepared, case.label, np.arange(PEOPLE)).metrics for case in trial.cases]

    def pair(what, text):
        return " → ".join(format(what(metrics), text) for metrics in result)

    columns = [
        pair(lambda m: np.median(m["peak_mg_dl"]), ".0f"),
        pair(lambda m: np.quantile(m["peak_mg_dl"], 0.95), ".0f"),
        pair(lambda m: m["mean_mg_dl"].mean(), ".1f"),
        pair(lambda m: m["time_below_70_pct"].mean(), ".2f"),
        pair(lambda m: m["minimum_mg_dl"].min(), ".1f"),
        f"{100.0 * result[1]['samples_dose_limited'].mean() / trial.samples:.0f}",
    ]
    return f"| {NAMES[name]} | {noise:g} | {' | '.join(columns)} |"


def main(paths):
    summaries = [json.loads(Path(path).read_text(encoding="utf-8")) for path in paths]
    [people] = {summary["able"] for summary in summaries}
    rows = [row for summary in summaries for row in summary["rows"]]
    columns = (
        "Highest, median",
        "95 % of people",
        "Mean",
        "Below 70 mg/dl, %",
        "Lowest of all",
        "Doses cut by the guard, %",
    )
    text = "\n".join(
        [
            f"Of {people} people, those who spend more than 1 % of the time more below 60 mg/dl than without "
            "the fault, without the guard → with it; in brackets the largest such difference with it, in % of the "
            "time.",
            "",
            *faults(rows),
            "",
            lowest(rows),
            "",
            f"A day with three meals and no fault for {PEOPLE} people, glucose in mg/dl, without the guard → with it:",
            "",
            f"| Controller | Noise | {' | '.join(columns)} |",
            f"| :--- | ---: |{' ---: |' * len(columns)}",
            *(day(name, noise) for noise in (0.0, 1.45) for name in dict.fromkeys(row["controller"] for row in rows)),
            "",
            f"On `parker2000`, seed {SEED}; {made(*paths)}.",
        ]
    )
    (Path(__file__).resolve().parent / "guide" / "stress_figures.md").write_text(text + "\n", encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main(sys.argv[1:])
