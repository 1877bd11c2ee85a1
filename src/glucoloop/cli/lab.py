"""``glucoloop lab``: the laboratory as a page, in one file."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from glucoloop.cli.command import OVERWRITE_FILE, Command, CommandOption, Given
from glucoloop.cli.screen import file_to_write, print_text, write_file
from glucoloop.patients.catalogue import DEFAULT_PATIENT
from glucoloop.refusal import Refusal

HELP: Final = (
    "Write the laboratory as a page: one HTML file that simulates the closed loop in the browser, without a server and "
    "without the network.\n\n"
    "Meals, controller, tuning, guard, faults and sensor are changed by hand, and the picture follows. People are "
    "drawn around parker-1999, hovorka-2004 and wilinska-2010. The numbers are those of glucoloop run within 0.02 "
    "mg/dl, and the page tells the command that repeats them.\n\n"
    "  glucoloop lab --out lab.html\n\n"
    "  glucoloop lab --patient hovorka-2004 --population twin/posterior.toml --out twin.html"
)
_OPTIONS: Final = (
    CommandOption("out", "--out", "The file.", metavar="FILE"),
    OVERWRITE_FILE,
    CommandOption(
        "population",
        "--population",
        "People of the page in the place of the default ones: a population, or a file, like those of glucoloop twin. "
        "The page carries up to 200 of them.",
        metavar="NAME",
    ),
    CommandOption("patient", "--patient", "Patient around whom the population is.", metavar="NAME"),
    CommandOption(
        "language",
        "--language",
        "Module with the page's texts in another language; what it leaves out stays English.",
        metavar="FILE",
    ),
)


def _lab(given: Given) -> None:
    """Write the page, and say where it is."""
    place = file_to_write(given)
    if place is None:
        raise Refusal("--out is missing; name the file, like --out lab.html")
    patient, population = given.get("patient"), given.get("population")
    if patient is not None and population is None:
        raise Refusal("--patient is of no use without --population; give that too, or choose the patient on the page")
    from glucoloop.lab.pack import page
    from glucoloop.storage.files import read_text

    language = given.get("language")
    code = None if language is None else read_text(Path(language), "a module with texts")
    text = page(None if population is None else (patient or DEFAULT_PATIENT.name, population), code).encode()
    write_file(place, text)
    print_text(
        f"Wrote {place}, {len(text) / 1000:.0f} kB. Open it in a browser: it needs neither a server nor the network."
    )


LAB: Final = Command("lab", HELP, _OPTIONS, _lab)
