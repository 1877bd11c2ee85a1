"""``glucoloop lab``: the laboratory as a page, in one file."""

from __future__ import annotations

from typing import Final

from glucoloop.cli.command import Command
from glucoloop.cli.option import CommandOption, Given
from glucoloop.cli.written import OVERWRITE_FILE, file_to_write, write_file
from glucoloop.refusal import Refusal

HELP: Final = (
    "Write the laboratory as a page: one HTML file that simulates the closed loop in the browser, without a server and "
    "without the network.\n\n"
    "Meals, controller, tuning, guard, faults, noise and dead time are changed by hand, and the picture follows. The "
    "page has the patients parker-1999, hovorka-2004 and wilinska-2010, and people of their populations, under PID, "
    "IMC, MPC and MPC/SE; its numbers are those of glucoloop run within 0.02 mg/dl, and it tells the command that "
    "repeats them.\n\n"
    "  glucoloop lab --out lab.html"
)
_OPTIONS: Final = (
    CommandOption("out", "--out", "The file.", metavar="FILE"),
    OVERWRITE_FILE,
)


def _lab(given: Given) -> None:
    """Write the page, and say where it is."""
    place = file_to_write(given)
    if place is None:
        raise Refusal("--out is missing; name the file, like --out lab.html")
    from glucoloop.lab.pack import page

    text = page().encode()
    write_file(place, text)
    print(f"Wrote {place}, {len(text) / 1000:.0f} kB. Open it in a browser: it needs neither a server nor the network.")


LAB: Final = Command("lab", HELP, _OPTIONS, _lab)
