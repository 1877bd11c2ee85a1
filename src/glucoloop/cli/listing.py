"""``glucoloop list``: what there is to choose from, with the settings of each component."""

from __future__ import annotations

import textwrap
from typing import Final

from glucoloop.cli.command import JSON, Command, CommandOption, Given
from glucoloop.cli.screen import print_text, print_value, width_of_text
from glucoloop.component.listing import listed, listing
from glucoloop.patients.catalogue import PATIENTS
from glucoloop.studies.catalogue import STUDIES

HELP: Final = (
    "List what there is: patients, meal models, sensors, pumps, faults, controllers, estimators of meals, guards, "
    "metrics, samplers, models and readers.\n\n"
    "With the name of a kind those of the kind are listed, and with the name of one its settings: their default "
    "values, bounds and units. With the name of a command every setting of it is listed, and with case what each "
    "controller has beside its own settings. With the name of a population its people are listed, or how they are "
    "drawn. What other packages add is listed too.\n\n"
    "  glucoloop list\n\n"
    "  glucoloop list faults\n\n"
    "  glucoloop list mpc-se"
)
_REQUESTS: Final = {
    "case": "glucoloop.situations.case:Case",
    "export": "glucoloop.studies.export:Export",
    **{name: f"{entry.place}.request" for name, entry in STUDIES.items()},
}
"""Places of the settings that are listed by the name of a command."""


def _list(typed: Given) -> None:
    """Print a description of each component."""
    config = typed.get("what")
    patient = next((name for name, component in PATIENTS.items() if config in component.populations), None)
    if patient is None:
        components = listed(config, _REQUESTS)
        text = listing(components, width_of_text())
    else:
        from glucoloop.situations.population import described_population

        described, lines = described_population(str(config), patient)
        components = [described]
        width = width_of_text()
        text = "\n".join(textwrap.fill(line, width, subsequent_indent="    ", break_on_hyphens=False) for line in lines)
    if typed.get("json"):
        from glucoloop.storage.files import with_version

        print_value(with_version({"parts": components}))
    else:
        print_text(text)


LIST: Final = Command(
    "list",
    HELP,
    (
        CommandOption(
            "what", "KIND|NAME", "A kind of components, one of them, or a population.", metavar="NAME", required=False
        ),
        JSON,
    ),
    _list,
)
