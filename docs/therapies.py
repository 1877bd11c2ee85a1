"""Let 100 people live three days on each therapy, and write the table of ``guide/therapies.md``.

    python docs/therapies.py

Each row is one `glucoloop trial` without rescue carbohydrate and one with it. It takes some minutes and rewrites
``guide/therapies_figures.md``.
"""

import json
import subprocess
import sys
import tempfile
from pathlib import Path

from made import made

TRIAL = (
    *("--patient", "hovorka-2004", "--population", "boiroux2017", "--people", "100", "--days", "3"),
    *("--sensor", "dexcom-g6", "--seed", "1"),
)
LIVED = (
    *("--habit", "unannounced, probability=0.15", "--habit", "announced-late, minutes=15, spread=15"),
    *("--carb-error", "20"),
)
TOLD = "--announce-meals"
THERAPIES = {
    "Pump, boluses for all meals": ("basal-bolus", TOLD),
    "Pump, as people live": ("basal-bolus", TOLD, *LIVED),
    "Pens, glargine once a day": ("basal-bolus", TOLD, "--pump", "pen"),
    "Pens, degludec once a day": ("basal-bolus", TOLD, "--pump", "pen, insulin=degludec"),
    "Pens, detemir twice a day": ("basal-bolus", TOLD, "--pump", "pen, insulin=detemir, injections=2"),
    "PID with insulin feedback": ("pid-ifb", TOLD),
    "the same with a guard": ("pid-ifb", TOLD, "--guard"),
    "Loop-like, automatic boluses": ("loop-like", TOLD),
    "Loop-like, temporary basal rates": ("loop-like, dosing=temporary-basal", TOLD),
    "Loop-like, as people live": ("loop-like", TOLD, *LIVED),
    "Loop-like, no meal announced": ("loop-like",),
}
"""Controller and further options of each row."""
COLUMNS = (
    *("Therapy", "70 to 180", "Above 180", "Below 70", "Below 54", "U a day"),
    *("70 to 180, with rescue", "Below 70, with rescue", "Rescue, g a day"),
)


def means(controller, *options):
    """Means over the people of the metrics of a trial."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "glucoloop", "trial", *TRIAL, "--controller", controller, *options]
        told = subprocess.run([*command, "--json", "--out", f"{folder}/t"], check=True, stdout=subprocess.PIPE).stdout
    (result,) = json.loads(told)["controllers"].values()
    return {name: values["mean"] for name, values in result["metrics"].items() if "mean" in values}


def row(name, controller, *options):
    alone = means(controller, *options)
    rescued = means(controller, *options, "--rescue", "--metric", "rescues")
    cells = (
        *(f"{alone[f'time_{where}_pct']:.1f}" for where in ("70_180", "above_180", "below_70", "below_54")),
        f"{alone['insulin_total_mU'] / 3000.0:.1f}",
        *(f"{rescued[f'time_{where}_pct']:.1f}" for where in ("70_180", "below_70")),
        f"{rescued['rescue_carbs_g'] / 3.0:.1f}",
    )
    return f"| {' | '.join((name, *cells))} |"


def main():
    lines = [f"| {' | '.join(COLUMNS)} |", f"| :--- |{' ---: |' * (len(COLUMNS) - 1)}"]
    for name, asked in THERAPIES.items():
        lines.append(row(name, *asked))
        print(lines[-1], flush=True)
    text = "\n".join([*lines, "", f"Means over 100 people of seed 1, times in percent; {made()}.", ""])
    (Path(__file__).resolve().parent / "guide" / "therapies_figures.md").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
