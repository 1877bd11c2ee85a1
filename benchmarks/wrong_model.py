"""Control where the controller's model is wrong, for one controller and any of its settings.

    python benchmarks/wrong_model.py                            the table, of the seeds that are reported
    python benchmarks/wrong_model.py --tuning                   the same of the seeds on which defaults are chosen
    python benchmarks/wrong_model.py --controller mpc-se        of another controller
    python benchmarks/wrong_model.py --rows "late 10" --runs 1000    of a thousand people, where readings are late
    python benchmarks/wrong_model.py --set mean_carbs_g=20 --set noise_pace=0    of other settings, one table for each

The situations are those of ``validation/meal_aware/situations.py``, as in ``docs/claims.py``. Undershoot is that below
the setpoint of noise-free glucose at the samples.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "validation"))

import numpy as np

from glucoloop.control.catalogue import CONTROLLERS
from meal_aware.measures import Runs
from meal_aware.mismatched_loops import MismatchedLoops, designer
from meal_aware.situations import MISMATCH_TUNING_SEED, MISMATCHES, Mismatch

Table = dict[str, dict[str, float]]

_COLUMNS = {
    "under": "6.2f",
    "under95": "6.2f",
    "peak": "7.1f",
    "lowest": "7.1f",
    "rest": "7.2f",
    "swing": "7.2f",
    "variation": "10.1f",
}


def table_of(runs: Mapping[str, Runs]) -> Table:
    """Numbers of each situation."""
    result = {}
    for name, of_row in runs.items():
        numbers = of_row.numbers
        result[name] = {
            "under": float(np.median(numbers["undershoot_mg_dl"])),
            "under95": float(np.percentile(numbers["undershoot_mg_dl"], 95)),
            "peak": float(np.median(numbers["overshoot_mg_dl"])),
            "lowest": float(numbers["minimum_mg_dl"].min()),
            "rest": float(numbers["late_offset_mg_dl"].mean()),
            "swing": float(numbers["late_swing_mg_dl"].max()),
            "variation": float(np.median(numbers["late_variation_mU_min"])),
        }
    return result


def show(result: Table, before: Table) -> None:
    """Print the table, beside an earlier one if there is one."""
    head = " under  95 %   peak lowest   rest  swing variation"
    print(f"{'':40s}{head}{'   | before' if before else ''}")
    for name, numbers in result.items():
        told = [numbers, *([before[name]] if name in before else [])]
        line = "   |".join("".join(f"{of[key]:{form}}" for key, form in _COLUMNS.items()) for of in told)
        print(f"{name:40s}{line}")


def loops_of(rows: Sequence[Mismatch], seed: int, runs: int | None) -> list[MismatchedLoops]:
    """Loops without a guard, and with one; each row has its own number of runs if none is given."""
    parts = ([row for row in rows if row.guarded is guarded] for guarded in (False, True))
    return [MismatchedLoops(part, [runs or row.runs for row in part], seed) for part in parts if part]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--controller", default="meal-mpc")
    parser.add_argument("--tuning", action="store_true", help="other people and noises, to choose defaults on")
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="SETTINGS",
        help="a variant, like 'doubt=1' or 'estimator=(noise_pace=0.2)'; may be repeated",
    )
    parser.add_argument("--rows", nargs="*", help="parts of the names of the rows; by default all without a guard")
    parser.add_argument("--runs", type=int, help="runs of each row, in place of its own number")
    parser.add_argument("--out", type=Path, help="file for the numbers of the last variant")
    parser.add_argument("--beside", type=Path, help="file of earlier numbers")
    asked = parser.parse_args()
    start = time.perf_counter()
    rows = [
        row for row in MISMATCHES if (any(part in row.name for part in asked.rows) if asked.rows else not row.guarded)
    ]
    before = json.loads(asked.beside.read_text()) if asked.beside else {}
    seed = MISMATCH_TUNING_SEED if asked.tuning else 0
    loops = loops_of(rows, seed, asked.runs)
    result: Table = {}
    for text in asked.set or [""]:
        variant = CONTROLLERS.parse(", ".join(filter(None, (asked.controller, text))))
        design = designer(asked.controller, variant.tree())
        result = {}
        for part in loops:
            result |= table_of(part.run(design))
        result = {row.name: result[row.name] for row in rows}
        number = sum(asked.runs or row.runs for row in rows)
        print(f"{text or 'defaults'}: {number} loops, {time.perf_counter() - start:.0f} s")
        show(result, before)
        sys.stdout.flush()
        start = time.perf_counter()
    if asked.out:
        asked.out.write_text(json.dumps(result, indent=1))


if __name__ == "__main__":
    main()
