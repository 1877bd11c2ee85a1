"""Turn stress tests into the tables that ``guide/guard.md`` shows.

    glucoloop stress --people 300 --controller imc --controller mpc --controller mpc-se --out three
    glucoloop stress --people 30 --controller nlqdmc-se --out nonlinear
    glucoloop stress --people 30 --controller meal-mpc --out meal
    python docs/stress.py three/summary.json nonlinear/summary.json meal/summary.json

It rewrites ``guide/stress_figures.md``: the faults from the folders, and what the guard costs a day without one from
trials that it carries out.
"""

import json
import sys
from pathlib import Path

import numpy as np
from made import made

from glucoloop.cohorts import engine
from glucoloop.cohorts.trial import Trial
from glucoloop.report.descriptions import short_names
from glucoloop.situations.situation import configured

NAMES = {"imc": "IMC", "mpc": "MPC", "mpc-se": "MPC/SE", "nlqdmc-se": "NLQDMC/SE", "meal-mpc": "Meal-aware MPC"}
PEOPLE, SEED = {"imc": 1000, "mpc": 1000, "mpc-se": 1000, "nlqdmc-se": 100, "meal-mpc": 100}, 0
"""People of the day without a fault, fewer under controllers that take long."""


def cell(rows):
    """Without the guard -> with it, and by how much more at most with it."""
    bare, guarded = rows.get(False), rows.get(True)
    told = [str(row["worse"]) for row in (bare, guarded) if row is not None]
    most = f" ({guarded['worst_more_pct']:.1f})" if guarded is not None and guarded["worse"] else ""
    return " → ".join(told) + most


def faults(summaries):
    rows, people = {}, {}
    for summary in summaries:
        for row in summary["rows"]:
            rows.setdefault(row["fault"], {}).setdefault(row["controller"], {})[row["guarded"]] = row
            people[row["controller"]] = row["people"]
    controllers = [name for name in NAMES if any(name in of for of in rows.values())]
    names = short_names([fault for fault in rows if fault])
    lines = [f"| Fault | {' | '.join(f'{NAMES[name]}, of {people[name]}' for name in controllers)} |"]
    lines.append(f"| :--- |{' ---: |' * len(controllers)}")
    for fault, of in rows.items():
        if fault:
            lines.append(f"| {names[fault]} | {' | '.join(cell(of[name]) for name in controllers)} |")
    return "\n".join(lines)


def day(name, noise):
    """A day with three meals and no fault under a controller, without the guard and with it."""
    cases = [f"{name}, label=bare", f"{name}, label=guarded, guard=usual"]
    sensor = [f"white-noise, variance={noise}"] if noise else []
    trial = configured(Trial, people=PEOPLE[name], seed=SEED, sensor=sensor, controller=cases)
    prepared = engine.prepare(trial)
    found = [engine.run_people(prepared, case.label, np.arange(PEOPLE[name])).metrics for case in trial.cases]

    def pair(what, text):
        return " → ".join(format(what(metrics), text) for metrics in found)

    columns = [
        pair(lambda m: np.median(m["peak_mg_dl"]), ".0f"),
        pair(lambda m: np.quantile(m["peak_mg_dl"], 0.95), ".0f"),
        pair(lambda m: m["mean_mg_dl"].mean(), ".1f"),
        pair(lambda m: m["time_below_70_pct"].mean(), ".2f"),
        pair(lambda m: m["minimum_mg_dl"].min(), ".1f"),
        f"{100.0 * found[1]['samples_dose_limited'].mean() / trial.samples:.0f}",
    ]
    return f"| {NAMES[name]}, {PEOPLE[name]} | {noise:g} | {' | '.join(columns)} |"


def main(paths):
    summaries = [json.loads(Path(path).read_text(encoding="utf-8")) for path in paths]
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
            "People who spend more than 1 % of the time more below 60 mg/dl than without the fault, without the guard "
            "→ with it; in brackets the largest such difference with it, in % of the time. Where there is one number, "
            "the controller was tried with the guard alone.",
            "",
            faults(summaries),
            "",
            "A day with three meals and no fault, glucose in mg/dl, without the guard → with it:",
            "",
            f"| Controller, people | Noise | {' | '.join(columns)} |",
            f"| :--- | ---: |{' ---: |' * len(columns)}",
            *(day(name, noise) for noise in (0.0, 1.45) for name in NAMES),
            "",
            f"On `parker2000`, seed {SEED}; {made()}.",
        ]
    )
    (Path(__file__).resolve().parent / "guide" / "stress_figures.md").write_text(text + "\n", encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main(sys.argv[1:])
