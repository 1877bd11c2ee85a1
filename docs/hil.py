"""Run nights of hardware in the loop, and write the table of ``guide/hil.md``.

    python docs/hil.py

It rewrites ``guide/hil_figures.md``. The compilers and QEMU that the page names are needed.
"""

import json
import os
import platform
import subprocess
from pathlib import Path

from made import made

GUIDE = Path(__file__).resolve().parent / "guide"
NIGHT = "--guard --duration 1440 --noise 1.45"
CALM = ""
ROUGH = "--power-cuts 1000 --hangs 5 --damaged 200 --lost 50 --doubled 100 --late 100"
OUTAGES = f"{ROUGH} --outages 10"
CONTROLLERS = ("pid", "imc", "mpc", "mpc-se", "nlqdmc-se", "meal-mpc")
# Chip, controller and disturbances.
CASES = (
    ("host", "pid", CALM),
    ("host", "pid", ROUGH),
    ("cortex-m4f", "mpc-se", CALM),
    *(("cortex-m4f", controller, ROUGH) for controller in CONTROLLERS),
    ("cortex-m4f", "mpc-se", OUTAGES),
    ("cortex-m7", "mpc-se", ROUGH),
    ("rv32", "mpc-se", ROUGH),
)
HEADER = ("Chip", "Controller, guarded", "Power cuts", "Hangs", "Disturbed frames", "Outages")
FOUND = ("Answered in time", "Fallbacks", "Equal to the bit", "Samples/s")
FRAMES = ("damaged", "lost", "doubled", "late")


def row(chip, controller, disturbances):
    words = f"hil --chip {chip} --controller {controller} {NIGHT} {disturbances} --json".split()
    done = subprocess.run(["glucoloop", *words], check=True, stdout=subprocess.PIPE, text=True)
    found = json.loads(done.stdout)["chip"]
    counts, samples = found["counts"], found["samples"]
    silent = samples - found["answered_in_time"]
    cells = (
        chip,
        controller,
        sum(number for kind, number in counts.items() if kind.startswith("cut")),
        counts["hang"],
        sum(counts[kind] for kind in FRAMES),
        10 if disturbances == OUTAGES else 0,
        f"{found['answered_in_time']} of {samples}",
        silent,
        f"{found['equal_to_the_bit']} of {samples}",
        f"{found['samples_per_s']:.0f}",
    )
    print(*cells, flush=True)
    return f"| {' | '.join(map(str, cells))} |"


def main():
    header = (*HEADER, *FOUND)
    lines = [f"| {' | '.join(header)} |", f"|{'---|' * len(header)}", *(row(*case) for case in CASES)]
    text = (
        f"Each line is 24 hours in float32, `glucoloop hil {NIGHT}`; the disturbances are `{OUTAGES}` or a part of "
        f"them. The machine has 2 cores ({platform.machine()}), and its load of the last minute was "
        f"{os.getloadavg()[0]:.0f} at the end: an idle one is quicker by about as much. A decision that came late, "
        "after an outage, is compared too."
        "\n\n" + "\n".join(lines) + f"\n\nThe table was {made()}.\n"
    )
    (GUIDE / "hil_figures.md").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
