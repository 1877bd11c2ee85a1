"""Search for the doses that keep people of `subcutaneous.py` in range for longest, of all that are possible.

    python benchmarks/subcutaneous_bound.py [--json] [--people N] [--seed N] [--patient NAME ...] [--days N]

The search is `glucoloop.bounds.least_risk_doses`: each sample of 5 min may have any dose, so a bolus too, and the
person is known exactly. Meals are known from their first minute (start), or all in advance (advance). What it finds can
be reached by who knows everything; there may be better doses.
"""

from __future__ import annotations

import argparse
import json
from typing import Any

import numpy as np
from subcutaneous import MOST, PATIENTS, trial_of

from glucoloop.studies.league.reach import KNOWN, BestDoses


def measured(family: str, people: int, seed: int, days: int) -> list[dict[str, Any]]:
    """Times in ranges of some people of a family under the best doses, by when meals are known."""
    trial = trial_of(f"{family}, announced, white", people, seed, "basal-bolus", days=days, profile_by="table")
    search, numbers = BestDoses(), range(min(people, MOST.get(family, people)))
    result = [{known: search.of(trial, number, known) for known in KNOWN} for number in numbers]
    rows = []
    for known in KNOWN:
        able = [person[known] for person in result if person[known]["able"]]
        rows.append(
            {
                "family": family,
                "known": known,
                "seed": seed,
                "days": days,
                "people": len(able),
                **{
                    name: float(np.mean([of[name] for of in able])) for name in ("time_70_180_pct", "time_below_70_pct")
                },
                "ever_below_54_pct": 100.0 * float(np.mean([of["minimum_mg_dl"] < 54.0 for of in able])),
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
