"""Turn searches for the worst sensor errors into the table that ``guide/adversary.md`` shows.

    glucoloop adversary --out worst
    python docs/adversary.py worst/adversary.json

It rewrites ``guide/adversary_figures.md``.
"""

import json
import sys
from pathlib import Path

from made import NAMES, made

HEADS = (
    *("Controller", "Errors, ±%", "Sequences tried", "Worst: min below 54", "lowest, mg/dl", "peak"),
    *("By chance: people below 54", "lowest", "No errors: lowest", "peak"),
)


def line(row):
    called = NAMES[row["controller"]] + (", guarded" if row["guarded"] else "")
    cells = [
        called,
        f"{row['error_pct']:g}",
        str(row["sequences_tried"]),
        f"{row['below_54_min']:.0f}",
        f"{row['lowest_mg_dl']:.1f}",
        f"{row['peak_mg_dl']:.0f}",
        f"{round(row['random_ever_below_54_pct'] / 100.0 * row['random_people'])} of {row['random_people']}",
        f"{row['random_lowest_mg_dl']:.1f}",
        f"{row['lowest_without_errors_mg_dl']:.1f}",
        f"{row['peak_without_errors_mg_dl']:.0f}",
    ]
    return f"| {' | '.join(cells)} |"


def main(place):
    summary = json.loads(Path(place).read_text(encoding="utf-8"))
    page = Path(__file__).parent / "guide" / "adversary_figures.md"
    page.write_text(
        "\n".join(
            [f"| {' | '.join(HEADS)} |", f"| :--- |{' ---: |' * (len(HEADS) - 1)}", *map(line, summary["searches"])]
        )
        + f"\n\nThe table was {made(place)}.\n",
        encoding="utf-8",
    )


if __name__ == "__main__":
    main(*sys.argv[1:])
