"""Verification: random loops with random faults, with every promise checked at every sample."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Annotated, Final

from glucoloop.config.key import Key
from glucoloop.config.options.situation import PatientKey
from glucoloop.control.catalogue import CONTROLLERS
from glucoloop.limits import LARGEST_COUNTER, LARGEST_SEED
from glucoloop.parts.patients import USUAL_PATIENT
from glucoloop.studies.study import PlainStudy

USUAL_LOOPS: Final = 100_000
MOST_LOOPS: Final = 1_000_000_000
MOST_SAMPLES: Final = 100_000_000_000
_ONE_OF: Final = f"One of {', '.join(CONTROLLERS)}, or one of another package, or module:attribute; repeat it for more."
_key = functools.partial(Key, panel="Campaign")


@dataclass(frozen=True, kw_only=True)
class VerifySettings:
    """Keys of a campaign, or of a nonsense test."""

    loops: Annotated[
        int | None,
        _key(
            "Smallest number of loops; each controller has as many with a guard as without.",
            told=f"{USUAL_LOOPS}",
            at_least=1,
            at_most=MOST_LOOPS,
        ),
    ] = None
    seed: Annotated[int, _key("The same seed gives the same loops.", at_least=0, at_most=LARGEST_SEED)] = 1
    controllers: Annotated[tuple[str, ...], _key(_ONE_OF, flag="--controller", told="all")] = ()
    patient: PatientKey = USUAL_PATIENT.name
    person: Annotated[
        int | None, _key("Only the loops of this person, with their faults.", at_least=0, at_most=LARGEST_COUNTER)
    ] = None
    nonsense: Annotated[
        int | None,
        _key(
            "Instead, give guarded controllers nonsense for this number of samples, lose their memory at random, and "
            "check doses and caps.",
            metavar="SAMPLES",
            at_least=1,
            at_most=MOST_SAMPLES,
        ),
    ] = None


VERIFY: Final = PlainStudy(
    name="verify",
    what="a verification",
    help=(
        "Simulate random loops with random faults, and check at every sample what every loop promises.\n\n"
        "People of the patient's populations eat up to four meals at any time and have up to three faults of sensor "
        "and pump at once, also absurd ones, with every controller, with and without a guard. The exit code is 0 if "
        "every promise was kept and 1 if one was broken; each broken loop is listed with the command that simulates it "
        "again.\n\n"
        "All loops are drawn at random; `glucoloop adversary` searches for the sensor errors that do the most harm."
        "\n\n"
        "  glucoloop verify\n\n"
        "  glucoloop verify --loops 1000000 --seed 2 --json > found.json\n\n"
        "  glucoloop verify --seed 2 --controller mpc --person 17\n\n"
        "  glucoloop verify --nonsense 100000000"
    ),
    module="glucoloop.studies.verification.study",
    settings=(VerifySettings,),
    shared="nothing",
    words={"panel": {"patient": "Campaign"}},
    unit="loops",
    keeps_files=False,
)
