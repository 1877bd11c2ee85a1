"""Check each claim about the meal-aware controller, and write the tables that ``guide/claims.md`` shows.

    python docs/claims.py                                   everything: some ten minutes of a processor
    python docs/claims.py --only stomachs --only fasting    some situations, or groups of them
    python docs/claims.py --seeds 4 --people 4 --out glimpse --figures glimpse.md    a glimpse

This controller and the paper's four are simulated in the same situations with the same noise. The claims are those of
``validation/meal_aware/claims.toml``. The runs of each controller in each situation, and the bounds, are kept in
``claims_runs.json`` of the folder ``--out`` as soon as they are done; after Ctrl-C the same command goes on from there.
"""

import argparse
import dataclasses
import json
import math
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "validation"))

import numpy as np

import glucoloop
from glucoloop.cli.jax_cache import keep_compiled
from meal_aware.claims import judged, spread
from meal_aware.loops import bound_of, close_loops
from meal_aware.measures import Runs
from meal_aware.situations import (
    ALL_SITUATIONS,
    CONTROLLERS,
    GROUPS,
    MISMATCHES,
    SITUATIONS,
    TUNING_PEOPLE_SEED,
    TUNING_SEEDS,
    Extent,
)

FIGURES = Path(__file__).resolve().parent / "guide" / "claims_figures.md"
TITLES = {**{situation.name: situation.title for situation in SITUATIONS}, **GROUPS}
DIGITS = {"": 0, "mU/min": 1}
SIGNS = {"at-least": "≥", "at-most": "≤"}
SHOWN = {
    "undershoot_mg_dl": "Undershoot, mg/dl",
    "overshoot_mg_dl": "Peak above setpoint, mg/dl",
    "insulin_total_variation_mU_min": "Total variation of insulin, mU/min",
}


class Results:
    """Runs and bounds that were computed, in a file that grows with each."""

    def __init__(self, file, extent):
        self.file, self.runs, self.bounds = file, {}, {}
        self.made = {"glucoloop": glucoloop.__version__, **dataclasses.asdict(extent)}
        if not file.exists():
            return
        content = json.loads(file.read_text(encoding="utf-8"))
        if content["made"] != self.made:
            raise SystemExit(f"{file} holds runs made with {content['made']}; choose another folder with --out")
        self.bounds = content["bounds"]
        for situation, controllers in content["runs"].items():
            for controller, runs in controllers.items():
                self.put(situation, controller, Runs(**{**runs, "run": np.asarray(runs["run"]), "numbers": {
                    name: np.asarray(values, float) for name, values in runs["numbers"].items()
                }}))  # fmt: skip

    def put(self, situation, controller, runs):
        self.runs.setdefault(situation, {})[controller] = runs

    @property
    def cases(self):
        return {(situation, controller) for situation, of_each in self.runs.items() for controller in of_each}

    def write(self):
        """Write the file in one step, so that an interrupt leaves the last one."""
        runs = {name: {one: dataclasses.asdict(of) for one, of in each.items()} for name, each in self.runs.items()}
        content = {"made": self.made, "bounds": self.bounds, "runs": runs}
        part = self.file.with_suffix(".part")
        part.write_text(json.dumps(content, default=np.ndarray.tolist), encoding="utf-8")
        part.replace(self.file)


def carry_out(results, extent, rows, controllers, *, bounds):
    """Compute what is missing."""
    named, wrong = ([row for row in rows if row in kind] for kind in (SITUATIONS, MISMATCHES))
    wanted = len(rows) * len(controllers)
    for situation, controller, runs in close_loops(extent, named, wrong, controllers=controllers, done=results.cases):
        results.put(situation, controller, runs)
        results.write()
        print(f"{len(results.cases)} of {wanted}: {situation}, {controller}", flush=True)
    for row in rows if bounds else named:
        if row.name not in results.bounds:
            best = bound_of(row)
            results.bounds[row.name] = None if best is None else best.bound
            results.write()


def table(columns, lines, right):
    """A table in Markdown, some columns of which stand at the right."""
    lines = [columns, ["---:" if column in right else ":---" for column in columns], *lines]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def number(value, digits):
    return f"{value:.{digits}f}" if math.isfinite(value) else "–"


def cell(values, digits):
    """Median, and 5 to 95 % of the runs where there are several."""
    middle, low, high = (number(spread(values)[share], digits) for share in ("median", "p5", "p95"))
    return middle if values.size == 1 else f"{middle} ({low} to {high})"


def claims(judgements, controllers, extent):
    lines, last = [], None
    for judgement in judgements:
        claim = judgement.claim
        digits = DIGITS.get(claim.unit, 2)
        lines.append([
            TITLES[claim.situation] if claim.situation != last else "",
            claim.what,
            claim.unit,
            f"{SIGNS[claim.kind]} {number(judgement.bound, digits)}",
            "holds" if judgement.holds(controllers[-1]) else "**does not hold**",
            *(number(judgement.numbers[name], digits) for name in controllers),
            claim.runs_in_words(extent),
        ])  # fmt: skip
        last = claim.situation
    return table(["Situation", "Claim", "Unit", "Bound", "", *controllers, "Of"], lines, ["Bound", *controllers])


def alone(situations, results, controllers):
    columns, lines = [*SHOWN.values(), "Distance to the bound, mg/dl"], []
    for situation in situations:
        title, bound = situation.title, results.bounds[situation.name]
        for name in controllers:
            numbers = results.runs[situation.name][name].numbers
            cells = [cell(numbers[key], 0 if "variation" in key else 1) for key in SHOWN]
            cells.append("" if bound is None else cell(numbers["deviation_mg_dl"] - bound, 1))
            lines.append([title, name, *cells])
            title = ""
    return table(["Situation", "Controller", *columns], lines, columns)


def mismatches(rows, results, controllers, extent):
    """Undershoot where the model is wrong, and the distance of the last controller to the bound."""
    columns, lines = [*controllers, "Bound", f"Distance, {controllers[-1]}"], []
    for row in rows:
        numbers, bound = (
            {name: runs.numbers for name, runs in results.runs[row.name].items()},
            results.bounds.get(row.name),
        )
        away = ["", ""]
        if bound is not None:
            away = [number(bound, 2), cell(numbers[controllers[-1]]["deviation_mg_dl"] - bound, 1)]
        cells = [cell(numbers[name]["undershoot_mg_dl"], 1) for name in controllers]
        lines.append([row.name, row.runs_in_words(extent), *cells, *away])
    return table(["Situation", "Of", *columns], lines, columns)


def page(results, extent, rows, controllers):
    """The tables of the situations."""
    named, wrong = ([row for row in rows if row in kind] for kind in (SITUATIONS, MISMATCHES))
    runs = {row.name: {name: results.runs[row.name][name] for name in controllers} for row in rows}
    judgements = list(judged(runs))
    held = sum(judgement.holds(controllers[-1]) for judgement in judgements)
    parts = [f"{held} of {len(judgements)} claims hold.", claims(judgements, controllers, extent)]
    if named:
        parts += ["Median, and 5 to 95 % of the runs:", alone(named, results, controllers)]
    if wrong:
        parts.append(
            "Undershoot in mg/dl where the model is wrong, at the samples, and the bound of the largest deviation:"
        )
        parts.append(mismatches(wrong, results, controllers, extent))
    parts.append(
        f"Made with glucoloop {glucoloop.__version__} and `--seed {extent.seed}`. The tuning was chosen on sensor "
        f"seeds {TUNING_SEEDS.start} to {TUNING_SEEDS.stop - 1} and on people of seed {TUNING_PEOPLE_SEED}."
    )
    if extent.tuned_on:
        parts[-1] += f" Of these, {' and '.join(extent.tuned_on)} are here too: they are no independent test."
    return "\n\n".join(parts) + "\n"


def main(arguments=None):
    given = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    usual = Extent()
    given.add_argument("--seed", type=int, default=usual.seed, help="First seed of the sensor, and that of the people.")
    given.add_argument("--seeds", type=int, default=usual.seeds, help="Runs of each noisy situation.")
    given.add_argument("--people", type=int, default=usual.people)
    given.add_argument("--only", action="append", choices=list(TITLES), help="All, unless some are given.")
    given.add_argument("--controller", action="append", help="All, unless some are given; the last is claimed of.")
    given.add_argument("--no-bounds", action="store_true", help="No best possible doses where a model is wrong.")
    given.add_argument("--out", type=Path, default=Path("claims"), help="Folder of the runs.")
    given.add_argument("--figures", type=Path, default=FIGURES, help="File of the tables.")
    asked = given.parse_args(arguments)
    extent = Extent(seed=asked.seed, seeds=asked.seeds, people=asked.people)
    controllers = asked.controller or list(CONTROLLERS)
    rows = [row for row in ALL_SITUATIONS if not asked.only or getattr(row, "group", row.name) in asked.only]
    keep_compiled()
    asked.out.mkdir(parents=True, exist_ok=True)
    results = Results(asked.out / "claims_runs.json", extent)
    carry_out(results, extent, rows, controllers, bounds=not asked.no_bounds)
    text = page(results, extent, rows, controllers)
    asked.figures.write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
