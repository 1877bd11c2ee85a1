"""``glucoloop verify``: random loops with random faults, and every promise checked at every sample."""

from __future__ import annotations

import dataclasses
import sys
import time
from typing import TYPE_CHECKING, Final

from glucoloop.cli.mistakes import interrupted
from glucoloop.cli.options import PATIENT, Given, Option, with_options
from glucoloop.cli.progress import counted
from glucoloop.cli.screen import stage
from glucoloop.registry.controllers import CONTROLLERS

if TYPE_CHECKING:
    from glucoloop.studies.verification import Campaign

HELP: Final = (
    "Close random loops with random faults, and check at every sample what every loop promises.\n\n"
    "People of the patient's populations eat up to four meals at any time and meet up to three faults of sensor and "
    "pump at once, absurd ones among them, under every controller, with a guard and without. It leaves with 0 if every "
    "promise was kept, and with 1 if one was broken; then broken loops are told, each with the command that closes it "
    "again."
    "\n\n"
    "All of that comes by chance; `glucoloop adversary` searches for the sensor errors that do the most harm.\n\n"
    "  glucoloop verify\n\n"
    "  glucoloop verify --loops 1000000 --seed 2 --json > found.json\n\n"
    "  glucoloop verify --seed 2 --controller mpc --person 17\n\n"
    "  glucoloop verify --nonsense 100000000"
)
_RUN: Final = "Campaign"
_OUTPUT: Final = "Output"

OPTIONS: Final = (
    Option("loops", "--loops", int, "How many, or a few more.", _RUN, metavar="N", default="100000"),
    Option("seed", "--seed", int, "The same seed gives the same loops.", _RUN, metavar="N", default="1"),
    Option(
        "controllers",
        "--controller",
        list[str],
        f"One of {', '.join(CONTROLLERS)}, or one of another package, or module:attribute; repeat it for more.",
        _RUN,
        metavar="NAME",
        default="all",
    ),
    dataclasses.replace(PATIENT, panel=_RUN),
    Option("person", "--person", int, "Only the loops of this one, with what fails in them.", _RUN, metavar="N"),
    Option(
        "nonsense",
        "--nonsense",
        int,
        "Instead, tell guarded controllers nonsense in so many samples, with memory lost, and check doses and caps.",
        _RUN,
        metavar="SAMPLES",
    ),
    Option("json", "--json", bool, "Print one JSON object instead of a table.", _OUTPUT),
)


@with_options(OPTIONS)
def command(given: Given) -> None:
    """Check what was asked for, carry it out, and tell it."""
    as_json = bool(given.pop("json", False))
    if "person" in given and "loops" in given:
        raise ValueError("--loops and --person exclude one another; leave one out")
    if "nonsense" in given and "loops" in given:
        raise ValueError("--loops and --nonsense exclude one another; leave one out")
    if "patient" in given and "nonsense" in given:
        raise ValueError("--nonsense has no patient at all; leave --patient out")
    with stage("Importing the simulator"):
        from glucoloop.cli.compiled import keep_compiled
        from glucoloop.studies.verification import Campaign
        from glucoloop.studies.verification.nonsense import Nonsense

        if "controllers" in given:
            given["controllers"] = tuple(given["controllers"])
        campaign = nonsense = None
        try:
            if "nonsense" in given:
                named = {"nonsense": "samples", "person": "loop"}
                nonsense = Nonsense(**{named.get(key, key): value for key, value in given.items()})
            else:
                campaign = Campaign(**given)
        except ValueError as error:
            raise ValueError(_called(str(error))) from None
    keep_compiled()
    if nonsense is not None:
        from glucoloop.cli.verify_nonsense import carry_out

        carry_out(nonsense, as_json=as_json)
    elif campaign is not None:
        _carry_out(campaign, as_json=as_json)


def _called(told: str) -> str:
    """A sentence about a key, as one about its option."""
    if told.startswith("samples is "):
        return f"--nonsense{told.removeprefix('samples')}"
    for option in OPTIONS:
        if told.startswith(f"{option.key} is "):
            return option.name + told.removeprefix(option.key)
    return told


def _carry_out(campaign: Campaign, *, as_json: bool) -> None:
    from glucoloop.cli.verify_telling import report, tell
    from glucoloop.studies.verification import run_campaign

    began, loops = time.monotonic(), 2 * sum(campaign.pairs().values())
    with counted(loops, 0, "loops") as progress:
        result = run_campaign(campaign, progress)
    seconds = time.monotonic() - began
    if as_json:
        from glucoloop.storage.strict_json import json_text, with_version

        print(json_text(with_version(report(campaign, result, seconds))))
    else:
        tell(campaign, result, seconds)
    if result.interrupted:
        interrupted(f"interrupted; of {loops} loops {result.loops} were checked to the end, and are told")
    sys.exit(0 if result.holds else 1)
