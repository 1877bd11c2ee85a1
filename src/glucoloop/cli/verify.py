"""``glucoloop verify``: random loops with random faults, and every promise checked at every sample."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any, Final, NoReturn

from glucoloop.cli.mistakes import interrupted
from glucoloop.cli.options import OUTPUT, Given, Option, among, options_of, with_options
from glucoloop.cli.progress import counted
from glucoloop.cli.screen import show, stage
from glucoloop.cli.telling import note_on_boluses
from glucoloop.refusal import Refusal
from glucoloop.studies.verification.options import CAMPAIGN_PANEL, CampaignKeys

if TYPE_CHECKING:
    from glucoloop.studies.verification.campaign import Campaign
    from glucoloop.studies.verification.nonsense import NonsenseCheck, NonsenseResult
    from glucoloop.studies.verification.result import CampaignResult

HELP: Final = (
    "Simulate random loops with random faults, and check at every sample what every loop promises.\n\n"
    "People of the patient's populations eat up to four meals at any time and have up to three faults of sensor and "
    "pump at once, also absurd ones, with every controller, with and without a guard. The exit code is 0 if every "
    "promise was kept and 1 if one was broken; each broken loop is listed with the command that simulates it again."
    "\n\n"
    "All loops are drawn at random; `glucoloop adversary` searches for the sensor errors that do the most harm.\n\n"
    "  glucoloop verify\n\n"
    "  glucoloop verify --loops 1000000 --seed 2 --json > found.json\n\n"
    "  glucoloop verify --seed 2 --controller mpc --person 17\n\n"
    "  glucoloop verify --nonsense 100000000"
)
OPTIONS: Final = (
    *options_of(CampaignKeys, panel={"patient": CAMPAIGN_PANEL}),
    Option(
        "nonsense",
        "--nonsense",
        int,
        "Instead, give guarded controllers nonsense for this number of samples, lose their memory at random, and check "
        "doses and caps.",
        CAMPAIGN_PANEL,
        metavar="SAMPLES",
    ),
    *among(OUTPUT, ("json",)),
)


@with_options(OPTIONS)
def command(given: Given) -> None:
    """Check the request, run the loops, and print the results."""
    as_json = bool(given.pop("json", False))
    if "person" in given and "loops" in given:
        raise Refusal("--loops and --person exclude one another; leave one out")
    if "nonsense" in given and "loops" in given:
        raise Refusal("--loops and --nonsense exclude one another; leave one out")
    if "patient" in given and "nonsense" in given:
        raise Refusal("--nonsense has no patient at all; leave --patient out")
    with stage("Importing the simulator"):
        from glucoloop.cli.compiled import keep_compiled
        from glucoloop.studies.verification.campaign import Campaign
        from glucoloop.studies.verification.nonsense import NonsenseCheck

        if "controllers" in given:
            given["controllers"] = tuple(given["controllers"])
        campaign = nonsense = None
        try:
            if "nonsense" in given:
                named = {"nonsense": "samples", "person": "loop"}
                nonsense = NonsenseCheck(**{named.get(key, key): value for key, value in given.items()})
            else:
                campaign = Campaign(**given)
        except Refusal as error:
            raise Refusal(_called(str(error))) from None
    if campaign is not None:
        note_on_boluses(campaign.patient, given.get("controllers", ()))
    keep_compiled()
    if nonsense is not None:
        _check_nonsense(nonsense, as_json=as_json)
    elif campaign is not None:
        _check_campaign(campaign, as_json=as_json)


def _called(told: str) -> str:
    """A sentence about a key, as one about its option."""
    if told.startswith("samples is "):
        return f"--nonsense{told.removeprefix('samples')}"
    for option in OPTIONS:
        if told.startswith(f"{option.key} is "):
            return option.name + told.removeprefix(option.key)
    return told


def _check_campaign(campaign: Campaign, *, as_json: bool) -> NoReturn:
    from glucoloop.studies.verification.campaign import run_campaign
    from glucoloop.studies.verification.results import campaign_report, campaign_told

    began, loops = time.monotonic(), 2 * sum(campaign.pairs().values())
    with counted(loops, 0, "loops") as progress:
        result = run_campaign(campaign, progress)
    seconds = time.monotonic() - began
    if as_json:
        _print_json(campaign_report(campaign, result, seconds))
    else:
        _print(campaign_told(campaign, result, seconds))
    _leave(result, f"of {loops} loops {result.loops} were checked to the end; their results follow")


def _check_nonsense(nonsense: NonsenseCheck, *, as_json: bool) -> NoReturn:
    from glucoloop.studies.verification.nonsense import run_nonsense
    from glucoloop.studies.verification.results import nonsense_report, nonsense_told

    began, loops = time.monotonic(), nonsense.loops * len(nonsense.controllers)
    with counted(loops, 0, "loops") as progress:
        result = run_nonsense(nonsense, progress)
    seconds = time.monotonic() - began
    if as_json:
        _print_json(nonsense_report(result, seconds))
    else:
        _print(nonsense_told(result, seconds))
    _leave(result, f"of {loops} loops {sum(arm.loops for arm in result.arms)} were checked to the end")


def _print_json(report: Mapping[str, Any]) -> None:
    from glucoloop.storage.strict_json import json_text, with_version

    print(json_text(with_version(report)))


def _print(told: Iterable[object]) -> None:
    for part in told:
        print(part) if isinstance(part, str) else show(part)


def _leave(result: CampaignResult | NonsenseResult, checked: str) -> NoReturn:
    if result.interrupted:
        interrupted(f"interrupted; {checked}")
    sys.exit(0 if result.holds else 1)
