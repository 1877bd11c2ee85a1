"""Turn searches for the worst sensor errors into the table that ``guide/adversary.md`` shows.

    glucoloop adversary --out worst
    python docs/adversary.py worst/adversary.json

It rewrites ``guide/adversary_figures.md``; several folders are joined. Of two searches about the same, the table has
the worst errors of the one with more sequences, and the errors by chance of the one with more people.
"""

import json
import sys
from pathlib import Path

from made import made

NAMES = {"imc": "IMC", "mpc": "MPC", "mpc-se": "MPC/SE", "nlqdmc-se": "NLQDMC/SE", "meal-mpc": "Meal-aware MPC"}
HEADS = (
    *("Controller", "Errors, ±%", "Sequences tried", "Worst: min below 54", "lowest, mg/dl", "peak"),
    *("By chance: people below 54", "lowest", "No errors: lowest", "peak"),
)


def line(row):
    called = NAMES.get(row["controller"], row["controller"]) + (", guarded" if row["guarded"] else "")
    numbers = [row[name] for name in ("lowest_mg_dl", "peak_mg_dl")]
    others = [row[f"{name}_mg_dl"] for name in ("random_lowest", "lowest_without_errors", "peak_without_errors")]
    cells = [
        called,
        f"{row['error_pct']:g}",
        str(row["sequences_tried"]),
        f"{row['below_54_min']:.0f}",
        *(f"{number:.0f}" for number in numbers),
        f"{round(row['random_ever_below_54_pct'] / 100.0 * row['random_people'])} of {row['random_people']}",
        *(f"{number:.0f}" for number in others),
    ]
    return f"| {' | '.join(cells)} |"


def joined(rows):
    """One row of those about the same."""
    by_chance = max(rows, key=lambda row: row["random_people"])
    told = {key: value for key, value in by_chance.items() if key.startswith("random_")}
    return {**max(rows, key=lambda row: row["sequences_tried"]), **told}


def main(places):
    summaries = [json.loads(Path(place).read_text(encoding="utf-8")) for place in places]
    same = {}
    for row in (row for summary in summaries for row in summary["searches"]):
        same.setdefault((row["controller"], row["guarded"], row["error_pct"]), []).append(row)
    rows = [joined(of) for of in same.values()]
    order = list(NAMES)
    rows.sort(key=lambda row: (order.index(row["controller"]), row["guarded"], row["error_pct"]))
    page = Path(__file__).parent / "guide" / "adversary_figures.md"
    page.write_text(
        "\n".join([f"| {' | '.join(HEADS)} |", f"| :--- |{' ---: |' * (len(HEADS) - 1)}", *map(line, rows)])
        + f"\n\nThe table was {made(*places)}.\n",
        encoding="utf-8",
    )


if __name__ == "__main__":
    main(sys.argv[1:])
