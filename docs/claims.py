"""Turn results of ``glucoloop claims`` into the tables that ``guide/claims.md`` shows.

    glucoloop claims --seed 2000 --out claims
    python docs/claims.py claims/claims.json

It rewrites ``guide/claims_figures.md``. Results of some situations each, with the same seeds, are put together:
``python docs/claims.py some/claims.json others/claims.json``.
"""

import json
import math
import sys
from pathlib import Path

from made import made

DIGITS = {"": 0, "mU/min": 1}
SHOWN = {
    "undershoot_mg_dl": "Undershoot, mg/dl",
    "overshoot_mg_dl": "Peak above setpoint, mg/dl",
    "insulin_total_variation_mU_min": "Total variation of insulin, mU/min",
}
SHARES = ("median", "p5", "p95")


def number(value, digits):
    return "–" if value is None or not math.isfinite(value) else f"{value:.{digits}f}"


def claims(told):
    titles = {situation["name"]: situation["title"] for situation in told["situations"]}
    titles |= {row["group"]: row["title"] for row in told["mismatches"]}
    controllers = list(told["claims"][0]["controllers"])
    lines = [
        f"| Situation | Claim | Unit | Bound | | {' | '.join(controllers)} | Of |",
        f"| :--- | :--- | :--- | ---: | :--- |{' ---: |' * len(controllers)} :--- |",
    ]
    last = None
    for claim in told["claims"]:
        digits = DIGITS.get(claim["unit"], 2)
        cells = [
            titles[claim["situation"]] if claim["situation"] != last else "",
            claim["what"],
            claim["unit"],
            f"{'≥' if claim['kind'] == 'at-least' else '≤'} {number(claim['bound'], digits)}",
            "holds" if claim["holds"] else "**does not hold**",
            *(number(claim["controllers"][name], digits) for name in controllers),
            claim["runs"],
        ]
        last = claim["situation"]
        lines.append(f"| {' | '.join(cells)} |")
    return lines


def cell(shares, digits, one):
    middle, low, high = (number(shares[share], digits) for share in SHARES)
    return middle if one else f"{middle} ({low} to {high})"


def numbers(told):
    columns = [*SHOWN.values(), "Distance to the bound, mg/dl"]
    lines = [f"| Situation | Controller | {' | '.join(columns)} |", f"| :--- | :--- |{' ---: |' * len(columns)}"]
    for situation in told["situations"]:
        one, title = situation["runs"] == "one run", situation["title"]
        for name, found in situation["controllers"].items():
            cells = [cell(found[key], 0 if "variation" in key else 1, one) for key in SHOWN]
            from_bound = situation["distance_to_bound_mg_dl"].get(name)
            cells.append("" if from_bound is None else cell(from_bound, 1, one))
            lines.append(f"| {title} | {name} | {' | '.join(cells)} |")
            title = ""
    return lines


def mismatches(told):
    """Undershoot where the model is wrong, and the distance of the meal-aware controller to the bound."""
    lines = []
    for row in told["mismatches"]:
        if not lines:
            names = list(row["controllers"])
            lines.append(f"| Situation | Of | {' | '.join(names)} | Bound | Distance, {names[-1]} |")
            lines.append(f"| :--- | :--- |{' ---: |' * (len(names) + 2)}")
        one = row["runs"] == "one run"
        cells = [cell(found["undershoot_mg_dl"], 1, one) for found in row["controllers"].values()]
        from_bound = row["distance_to_bound_mg_dl"].get(names[-1])
        cells += ["" if from_bound is None else number(row["bound_mg_dl"], 2)]
        cells += ["" if from_bound is None else cell(from_bound, 1, one)]
        lines.append(f"| {row['name']} | {row['runs']} | {' | '.join(cells)} |")
    return lines


def together(paths):
    """One result of several, which differ in their situations alone."""
    told, *others = (json.loads(Path(path).read_text(encoding="utf-8")) for path in paths)
    for other in others:
        if other["config"]["seed"] != told["config"]["seed"]:
            raise SystemExit("the results have other seeds; make them again with the same one")
        for part in ("claims", "situations", "mismatches"):
            told[part] += other[part]
    return told


def table(title, lines):
    """Lines of a table under its title; none for a table without a row."""
    return [title, "", *lines, ""] if len(lines) > 2 else []


def main(paths):
    told = together(paths)
    held = sum(claim["holds"] for claim in told["claims"])
    tuning, config = told["tuning"], told["config"]
    first, last = tuning["sensor_seeds"]
    text = "\n".join(
        [
            f"{held} of {len(told['claims'])} claims hold.",
            "",
            *claims(told),
            "",
            *table("Median, and 5 to 95 % of the runs:", numbers(told)),
            *table(
                "Undershoot in mg/dl where the model is wrong, at the samples, and the bound of the largest deviation:",
                mismatches(told),
            ),
            f"The tables were {made(*paths, version=told['version'])} and `--seed {config['seed']}`. The tuning was "
            f"chosen on sensor seeds {first} to {last} and on people of seed {tuning['people_seed']}.",
        ]
    )
    (Path(__file__).resolve().parent / "guide" / "claims_figures.md").write_text(text + "\n", encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main(sys.argv[1:])
