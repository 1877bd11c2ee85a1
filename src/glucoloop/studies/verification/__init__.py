"""Verification: random loops with random faults, with every promise checked at every sample."""

from __future__ import annotations

import functools
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Final

from glucoloop.control.catalogue import CONTROLLERS
from glucoloop.limits import LARGEST_COUNTER, LARGEST_SEED
from glucoloop.parts.part import Part
from glucoloop.parts.patients import USUAL_PATIENT
from glucoloop.refusal import Refusal
from glucoloop.situations.option import Option
from glucoloop.studies.study import PlainStudy

if TYPE_CHECKING:
    from glucoloop.studies.verification.campaign import Campaign
    from glucoloop.studies.verification.nonsense import NonsenseCheck

USUAL_LOOPS: Final = 100_000
MOST_LOOPS: Final = 1_000_000_000
MOST_SAMPLES: Final = 100_000_000_000
_ONE_OF: Final = f"One of {', '.join(CONTROLLERS)}, or one of another package, or module:attribute; repeat it for more."
_key = functools.partial(Option, panel="Campaign")


class Verification(Part):
    """A campaign, or a nonsense test."""

    kind: ClassVar = "verification"

    loops: Annotated[
        int | None,
        _key(
            "Smallest number of loops; each controller has as many with a guard as without.",
            default=f"{USUAL_LOOPS}",
            at_least=1,
            at_most=MOST_LOOPS,
        ),
    ] = None
    seed: Annotated[int, _key("The same seed gives the same loops.", at_least=0, at_most=LARGEST_SEED)] = 1
    controllers: Annotated[tuple[str, ...], _key(_ONE_OF, flag="--controller", default="all")] = ()
    patient: Annotated[str, _key("The patient, by name.")] = USUAL_PATIENT.name
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

    def __post_init__(self) -> None:
        if self.person is not None and self.loops is not None:
            raise Refusal("--loops and --person exclude one another; leave one out")
        if len(set(self.controllers)) < len(self.controllers):
            raise Refusal(f"a controller is named twice in {', '.join(self.controllers)}; leave one out")
        if self.nonsense is not None and self.loops is not None:
            raise Refusal("--loops and --nonsense exclude one another; leave one out")
        if self.nonsense is not None and self.patient != USUAL_PATIENT.name:
            raise Refusal("--nonsense has no patient at all; leave --patient out")

    def definition(self) -> Campaign | NonsenseCheck:
        """The campaign or the nonsense test; making it imports JAX.

        Raises
        ------
        Refusal
            For an unknown patient or controller.
        """
        from glucoloop.studies.verification.campaign import Campaign
        from glucoloop.studies.verification.nonsense import NonsenseCheck

        chosen: dict[str, Any] = {"controllers": self.controllers} if self.controllers else {}
        if self.nonsense is not None:
            return NonsenseCheck(seed=self.seed, samples=self.nonsense, loop=self.person, **chosen)
        if self.loops is not None:
            chosen["loops"] = self.loops
        return Campaign(seed=self.seed, patient=self.patient, person=self.person, **chosen)


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
    request=Verification,
    unit="loops",
    keeps_files=False,
)
