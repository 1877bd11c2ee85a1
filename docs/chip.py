"""Export controllers, check each folder with every tool that is installed, and write the tables of ``guide/chip.md``.

    python docs/chip.py imc pid mpc mpc-se

It rewrites ``guide/chip_figures.md``: each controller with its guard, in float32, over 200 samples of a closed loop
with faults. The compilers, QEMU, cppcheck and Frama-C that the page names are needed.
"""

import json
import subprocess
import sys
import tempfile
from pathlib import Path

GUIDE = Path(__file__).resolve().parent / "guide"
SAMPLES = 200
CHIPS = ("cortex-m4f", "cortex-m7", "rv32")
SIZES = (
    "Controller, guarded",
    "Form",
    "Chip",
    "Program and tables",
    "State and workspace",
    "Stack",
    "Instructions",
    "ms",
)


def checks_of(controller, folder):
    """The form of an exported controller, and what each check of its folder found."""
    subprocess.run(["glucoloop", "export", "--controller", controller, "--guard", "--out", str(folder)], check=True)
    form = json.loads((folder / "manifest.json").read_text(encoding="utf-8"))["form"]
    command = ["glucoloop", "export", "--check", str(folder), "--samples", str(SAMPLES), "--json"]
    done = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True)
    return form, {found["check"]: found for found in json.loads(done.stdout)["checks"]}


def size_rows(controller, form, checks):
    for chip in CHIPS:
        found = checks[f"C on an emulated {chip}"]
        if not found["holds"]:
            sys.exit(f"{controller} on {chip}: {found['found']}")
        cells = (
            f"{found['flash_bytes']} B",
            f"{found['ram_bytes']} B",
            f"{found['stack_bytes']} B",
            f"{found['instructions']}",
            f"{found['ms_assumed']:.2g}",
        )
        yield f"| {' | '.join((controller, form, chip, *cells))} |"


def proof_row(controller, checks):
    said = {True: "holds", False: "does not hold", None: "not run"}
    found = [checks[name] for name in checks if "MISRA" in name or "EVA" in name]
    return f"| {' | '.join([controller, *(said[each['holds']] + ': ' + each['found'] for each in found)])} |"


def main(controllers):
    sizes = [f"| {' | '.join(SIZES)} |", "| :--- | :--- | :--- |" + " ---: |" * (len(SIZES) - 3)]
    proofs = ["| Controller, guarded | MISRA C:2012, by cppcheck | Any state and observation, by Frama-C EVA |"]
    proofs.append("| :--- | :--- | :--- |")
    for controller in controllers:
        with tempfile.TemporaryDirectory() as folder:
            form, checks = checks_of(controller, Path(folder) / "out")
        sizes += size_rows(controller, form, checks)
        proofs.append(proof_row(controller, checks))
    (GUIDE / "chip_figures.md").write_text("\n".join([*sizes, "", *proofs, ""]), encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
