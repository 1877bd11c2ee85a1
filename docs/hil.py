"""Run nights of hardware in the loop, and write the table of ``guide/hil.md``.

    python docs/hil.py

It rewrites ``guide/hil_figures.md``. The compilers and QEMU that the page names are needed.
"""

import json
import subprocess
import sys
import tempfile
from pathlib import Path

import polars as pl
from made import made

from glucoloop.control.catalogue import CONTROLLERS

GUIDE = Path(__file__).resolve().parent / "guide"
NIGHT = "--guard --duration 1440 --noise 1.45"
CALM = ""
ROUGH = "--power-cuts 1000 --hangs 5 --damaged 200 --lost 50 --doubled 100 --late 100"
OUTAGES = f"{ROUGH} --outages 10"
LEFT_OUT = ("basal",)
"""A rate that never changes tells nothing of a link."""
TOLD = "--patient hovorka-2004 --announce-meals --announce-before 15"
"""Options of the controllers that give boluses."""
# Chip, controller and disturbances.
CASES = (
    ("host", "pid", CALM),
    ("host", "pid", ROUGH),
    ("cortex-m4f", "mpc-se", CALM),
    *(("cortex-m4f", controller, ROUGH) for controller in CONTROLLERS if controller not in LEFT_OUT),
    ("cortex-m4f", "mpc-se", OUTAGES),
    ("cortex-m7", "mpc-se", ROUGH),
    ("rv32", "mpc-se", ROUGH),
)
HEADER = ("Chip", "Controller, guarded", "Power cuts", "Hangs", "Disturbed frames", "Outages")
FOUND = ("Answered in time", "Fallbacks", "Boluses given", "Equal to the bit")
FRAMES = ("damaged", "lost", "doubled", "late")


def row(chip, controller, disturbances):
    told = TOLD if CONTROLLERS[controller].gives_boluses else ""
    words = f"hil --chip {chip} --controller {controller} {told} {NIGHT} {disturbances}".split()
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run([sys.executable, "-m", "glucoloop", *words, "--out", f"{folder}/night"], check=True)
        result = json.loads(Path(folder, "night", "metrics.json").read_text(encoding="utf-8"))["chip"]
        trace = pl.read_csv(Path(folder, "night", "trace.csv"))
    counts, samples = result["counts"], result["samples"]
    silent = samples - result["answered_in_time"]
    cells = (
        chip,
        controller,
        sum(number for kind, number in counts.items() if kind.startswith("cut")),
        counts["hang"],
        sum(counts[kind] for kind in FRAMES),
        10 if disturbances == OUTAGES else 0,
        f"{result['answered_in_time']} of {samples}",
        silent,
        trace.filter(pl.col("bolus_mU") > 0.0).height if told else "-",
        f"{result['equal_to_the_bit']} of {samples}",
    )
    print(*cells, flush=True)
    return f"| {' | '.join(map(str, cells))} |"


def main():
    header = (*HEADER, *FOUND)
    lines = [f"| {' | '.join(header)} |", f"|{'---|' * len(header)}", *(row(*case) for case in CASES)]
    text = (
        f"Each line is 24 hours in float32, `glucoloop hil {NIGHT}`, of controllers that give boluses with `{TOLD}`; "
        f"the disturbances are `{OUTAGES}` or a part of them. A decision that came late, after an outage, is compared "
        "too.\n\n" + "\n".join(lines) + f"\n\nThe table was {made()}.\n"
    )
    (GUIDE / "hil_figures.md").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
