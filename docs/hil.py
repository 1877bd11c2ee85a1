"""Run nights of hardware in the loop, and write the table of ``guide/hil.md``.

    python docs/hil.py

It rewrites ``guide/hil_figures.md``. The compilers and QEMU that the page names are needed.
"""

import json
import platform
import subprocess
from pathlib import Path

GUIDE = Path(__file__).resolve().parent / "guide"
NIGHT = "--guard --duration 1440 --noise 1.45"
ROUGH = "--power-cuts 1000 --hangs 5 --damaged 200 --lost 50 --doubled 100 --late 100"
ROUGH_WITH_OUTAGES = f"{ROUGH} --outages 10"
# Chip, controller and disturbances.
CASES = (
    ("host", "pid", ""),
    ("host", "pid", ROUGH),
    ("cortex-m4f", "mpc-se", ""),
    ("cortex-m4f", "mpc-se", ROUGH_WITH_OUTAGES),
    ("cortex-m7", "mpc-se", ""),
    ("rv32", "mpc-se", ""),
)
HEADER = ("Chip", "Controller, guarded", "Disturbances", "Answered in time", "Equal to the bit", "Samples/s")


def row(chip, controller, disturbances):
    words = f"hil --chip {chip} --controller {controller} {NIGHT} {disturbances} --json".split()
    done = subprocess.run(["glucoloop", *words], check=True, stdout=subprocess.PIPE, text=True)
    found = json.loads(done.stdout)["chip"]
    cells = (
        chip,
        controller,
        f"`{disturbances}`" if disturbances else "none",
        f"{found['answered_in_time']} of {found['samples']}",
        f"{found['equal_to_the_bit']} of {found['samples']}",
        f"{found['samples_per_s']:.0f}",
    )
    print(*cells, flush=True)
    return f"| {' | '.join(cells)} |"


def main():
    lines = [f"| {' | '.join(HEADER)} |", f"|{'---|' * len(HEADER)}", *(row(*case) for case in CASES)]
    text = (
        f"Each line is 24 hours, `glucoloop hil {NIGHT}`, on a machine of 2 cores ({platform.machine()}) that was busy "
        "with other work, which decides on the speed of emulated chips: each of their power cuts starts QEMU anew. A "
        "decision that came late, after an outage, is compared too.\n\n" + "\n".join(lines) + "\n"
    )
    (GUIDE / "hil_figures.md").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
