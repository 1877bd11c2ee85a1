"""``glucoloop list``: what there is to choose from, with the settings of each part."""

from __future__ import annotations

from typing import Final

from glucoloop.cli.command import Command
from glucoloop.cli.option import JSON, CommandOption, Given
from glucoloop.cli.screen import width_of_text
from glucoloop.parts.listing import listed, listing
from glucoloop.studies.catalogue import STUDIES

HELP: Final = (
    "List what there is: patients, meal models, sensors, pumps, faults, controllers, estimators of meals, guards, "
    "metrics, samplers and models.\n\n"
    "With the name of a kind those of the kind are listed, and with the name of one its settings: their usual values, "
    "bounds and units. With the name of a command every setting of it is listed, and with case what each controller "
    "has beside its own settings. What other packages add is listed too.\n\n"
    "  glucoloop list\n\n"
    "  glucoloop list faults\n\n"
    "  glucoloop list mpc-se"
)
_REQUESTS: Final = {
    "case": "glucoloop.situations.case:Case",
    "export": "glucoloop.studies.exported:Export",
    **{name: f"{entry.place}.request" for name, entry in STUDIES.items()},
}
"""Places of the settings that are listed by the name of a command."""


def _list(typed: Given) -> None:
    """Print a description of each part."""
    parts = listed(typed.get("what"), _REQUESTS)
    if typed.get("json"):
        from glucoloop.storage.files import json_text, with_version

        print(json_text(with_version({"parts": parts})))
    else:
        print(listing(parts, width_of_text()))


LIST: Final = Command(
    "list",
    HELP,
    (CommandOption("what", "KIND|NAME", "A kind of parts, or one of them.", metavar="NAME", required=False), JSON),
    _list,
)
