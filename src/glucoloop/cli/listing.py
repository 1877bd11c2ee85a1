"""``glucoloop list``: what there is to choose from, with the settings of each part."""

from __future__ import annotations

import shutil
from typing import Annotated, Final

import typer

from glucoloop.parts.listing import listed, listing

HELP: Final = (
    "List what there is: patients, sensors, pumps, faults, controllers, guards and metrics.\n\n"
    "With the name of a kind those of the kind are listed, and with the name of one its settings: their usual values, "
    "bounds and units. What other packages add is listed too.\n\n"
    "  glucoloop list\n\n"
    "  glucoloop list faults\n\n"
    "  glucoloop list mpc-se"
)
_WIDEST: Final = 100


def command(
    what: Annotated[str | None, typer.Argument(metavar="[KIND|NAME]", help="A kind of parts, or one of them.")] = None,
    json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Print a description of each part."""
    parts = listed(what)
    if json:
        from glucoloop.storage.strict_json import json_text, with_version

        print(json_text(with_version({"parts": parts})))
    else:
        print(listing(parts, min(_WIDEST, shutil.get_terminal_size((_WIDEST, 24)).columns)))
