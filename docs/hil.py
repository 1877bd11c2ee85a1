"""Run nights of hardware in the loop, and write the table of ``guide/hil.md``.

    python docs/hil.py                  # every line
    python docs/hil.py therapy-mpc      # those of this controller; the others stay

It rewrites ``guide/hil_figures.md``. The compilers and QEMU that the page names are needed.
"""

import json
import subprocess
import sys
import tempfile
from datetime import date
from pathlib import Path

import polars as pl

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
FOUND = ("Answered in time", "Fallbacks", "Boluses given", "Equal to the bit", "Made on")
FRAMES = ("damaged", "lost", "doubled", "late")
FIGURES = GUIDE / "hil_figures.md"


def drawn(disturbances):
    """Numbers of power cuts, hangs, disturbed frames and outages, of which a line tells."""
    words = disturbances.split()
    counts = dict(zip(words[::2], map(int, words[1::2]), strict=True))
    frames = sum(counts.get(f"--{kind}", 0) for kind in FRAMES)
    return counts.get("--power-cuts", 0), counts.get("--hangs", 0), frames, counts.get("--outages", 0)


def lines_there():
    """Lines of the page by chip, controller and disturbances."""
    cells = ([cell.strip() for cell in line.strip("|").split("|")] for line in FIGURES.read_text("utf-8").split("\n"))
    return {(*of[:2], *map(int, of[2:6])): f"| {' | '.join(of)} |" for of in cells if len(of) > 6 and of[2].isdecimal()}


def row(chip, controller, disturbances):
    """Line of a night."""
    told = TOLD if CONTROLLERS[controller].gives_boluses else ""
    words = f"hil --chip {chip} --controller {controller} {told} {NIGHT} {disturbances}".split()
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run([sys.executable, "-m", "glucoloop", *words, "--out", f"{folder}/night"], check=True)
        result = json.loads(Path(folder, "night", "metrics.json").read_text(encoding="utf-8"))["chip"]
        trace = pl.read_csv(Path(folder, "night", "trace.csv"))
    counts, samples, expected = result["counts"], result["samples"], drawn(disturbances)
    silent = samples - result["answered_in_time"]
    cells = (
        chip,
        controller,
        sum(number for kind, number in counts.items() if kind.startswith("cut")),
        counts["hang"],
        sum(counts[kind] for kind in FRAMES),
        expected[-1],
        f"{result['answered_in_time']} of {samples}",
        silent,
        trace.filter(pl.col("bolus_mU") > 0.0).height if told else "-",
        f"{result['equal_to_the_bit']} of {samples}",
        date.today().isoformat(),
    )
    print(*cells, flush=True)
    return f"| {' | '.join(map(str, cells))} |"


def main():
    chosen, header = sys.argv[1:], (*HEADER, *FOUND)
    there = lines_there() if chosen else {}
    rows = (row(*case) if not chosen or case[1] in chosen else there[(*case[:2], *drawn(case[2]))] for case in CASES)
    lines = [f"| {' | '.join(header)} |", f"|{'---|' * len(header)}", *rows]
    FIGURES.write_text(
        f"Each line is 24 hours in float32, `glucoloop hil {NIGHT}`, of controllers that give boluses with `{TOLD}`; "
        f"the disturbances are `{OUTAGES}` or a part of them. A decision that came late, after an outage, is compared "
        "too.\n\n" + "\n".join(lines) + "\n",
        encoding="utf-8",
    )


if __name__ == "__main__":
    main()
