"""Verification: random loops with random faults, with every promise checked at every sample."""

from __future__ import annotations

import functools
import itertools
import math
import shlex
from typing import Annotated, ClassVar, Final, Literal

from glucoloop.component.base import Component
from glucoloop.component.setting import Option
from glucoloop.control.catalogue import CONTROLLERS, controller_entry
from glucoloop.patients.catalogue import DEFAULT_PATIENT, PATIENTS
from glucoloop.refusal import Refusal
from glucoloop.situations.situation import LONGEST_SAMPLE_TIME_MIN, SHORTEST_SAMPLE_TIME_MIN
from glucoloop.studies.study import SearchStudy
from glucoloop.units import LARGEST_COUNTER, LARGEST_SEED

_DEFAULT_LOOPS: Final = 100_000
_SLOW_SHARE: Final = 0.05
"""Number of loops of a slow controller for each loop of another one."""
SAMPLE_MIN: Final = 5.0
"""Sample time of the campaign, and by default of a nonsense test."""
NONSENSE_SAMPLES: Final = 96
"""Number of samples of a loop of a nonsense test."""
Precision = Literal["float64", "float32"]
_ONE_OF: Final = f"One of {', '.join(CONTROLLERS)}, or one of another package, or module:attribute; repeat it for more."
_key = functools.partial(Option, panel="Campaign")


class Verification(Component):
    """A campaign, or a nonsense test."""

    kind: ClassVar = "verification"

    loops: Annotated[
        int | None,
        _key(
            "Smallest number of loops; each controller has as many with a guard as without.",
            default=f"{_DEFAULT_LOOPS}",
            at_least=1,
            at_most=1_000_000_000,
        ),
    ] = None
    seed: Annotated[int, _key("The same seed gives the same loops.", at_least=0, at_most=LARGEST_SEED)] = 1
    controllers: Annotated[tuple[str, ...], _key(_ONE_OF, flag="--controller", default="all")] = ()
    patient: Annotated[str, _key("The patient, or one person, like 'kanderian-2009, person=3'.")] = DEFAULT_PATIENT.name
    person: Annotated[
        int | None, _key("Only the loops of this person, with their faults.", at_least=0, at_most=LARGEST_COUNTER)
    ] = None
    nonsense: Annotated[
        int | None,
        _key(
            "Instead, give guarded controllers nonsense for this number of samples, false reports of the pump among "
            "it, lose their memory at random, and check doses and caps.",
            metavar="SAMPLES",
            at_least=1,
            at_most=100_000_000_000,
        ),
    ] = None
    sample_times_min: Annotated[
        tuple[float, ...],
        _key(
            "Sample time of the guards that are given nonsense; repeat it for more.",
            flag="--sample-time",
            default="5",
            at_least=SHORTEST_SAMPLE_TIME_MIN,
            at_most=LONGEST_SAMPLE_TIME_MIN,
        ),
    ] = ()
    precisions: Annotated[
        tuple[Precision, ...],
        _key(
            "Precision of the guards that are given nonsense; repeat it for more.",
            flag="--precision",
            default="float64",
        ),
    ] = ()

    def __post_init__(self) -> None:
        if self.person is not None and self.loops is not None:
            raise Refusal("--loops and --person exclude one another; leave one out")
        if len(set(self.controllers)) < len(self.controllers):
            raise Refusal(f"a controller is named twice in {', '.join(self.controllers)}; leave one out")
        if self.nonsense is not None and self.loops is not None:
            raise Refusal("--loops and --nonsense exclude one another; leave one out")
        if self.nonsense is None and (self.sample_times_min or self.precisions):
            raise Refusal("--sample-time and --precision are those of guards that are given nonsense; add --nonsense")
        for flag, values in (("--sample-time", self.sample_times_min), ("--precision", self.precisions)):
            if len(set(values)) < len(values):
                raise Refusal(f"{flag} names the same value twice; leave one out")
        PATIENTS.parse(self.patient)
        for name in self.controllers:
            if controller_entry(name).slow and self.nonsense is not None:
                quick = [name for name, entry in CONTROLLERS.items() if not entry.slow]
                raise Refusal(f"{name} takes too long for nonsense in masses; give some of {', '.join(quick)}")

    def people(self) -> dict[str, int]:
        """Number of people for each controller: each makes a loop with a guard and one without.

        In a nonsense test, the number of loops for each.
        """
        every = (name for name, entry in CONTROLLERS.items() if self.nonsense is None or not entry.slow)
        names = self.controllers or tuple(every)
        if self.person is not None:
            return dict.fromkeys(names, 1)
        if self.nonsense is not None:
            together = NONSENSE_SAMPLES * len(names) * len(self.guard_timings())
            return dict.fromkeys(names, math.ceil(self.nonsense / together))
        shares = {name: _SLOW_SHARE if controller_entry(name).slow else 1.0 for name in names}
        pairs = (self.loops or _DEFAULT_LOOPS) / sum(shares.values()) / 2.0
        return {name: max(1, math.ceil(pairs * share - 1e-9)) for name, share in shares.items()}

    def guard_timings(self) -> tuple[tuple[float, str], ...]:
        """Pairs of a sample time [min] and a precision at which guards are given nonsense."""
        return tuple(itertools.product(self.sample_times_min or (SAMPLE_MIN,), self.precisions or ("float64",)))

    def repeat(self, controller: str, person: int, timing: tuple[float, str] | None = None) -> str:
        """Command that repeats the loops of a person, or a loop of a nonsense test with its timing."""
        kind = "" if self.patient == DEFAULT_PATIENT.name else f"--patient {shlex.quote(self.patient)} "
        if timing is not None:
            kind = f"--nonsense 1 {kind}--sample-time {timing[0]:g} --precision {timing[1]} "
        return f"glucoloop verify {kind}--seed {self.seed} --controller {controller} --person {person}"


VERIFY: Final = SearchStudy(
    name="verify",
    what="a verification",
    help=(
        "Simulate random loops with random faults, and check at every sample what every loop promises.\n\n"
        "People of the patient's populations eat up to four meals at any time and have up to three faults of sensor "
        "and pump at once, also absurd ones, with every controller, with and without a guard. The exit code is 0 if "
        "every promise was kept and 1 if one was broken; each broken loop is listed with the command that simulates it "
        "again.\n\n"
        "All loops are drawn at random; `glucoloop adversary` searches for the sensor errors that do the most harm. "
        "With --out, what is done stays: after Ctrl-C or a kill the same command goes on with the next controller.\n\n"
        "  glucoloop verify\n\n"
        "  glucoloop verify --loops 1000000 --seed 2 --out million\n\n"
        "  glucoloop verify --seed 2 --controller mpc --person 17\n\n"
        "  glucoloop verify --nonsense 100000000"
    ),
    module="glucoloop.studies.verification.study",
    request=Verification,
    results="loops.parquet",
    needs_folder=False,
    partial=True,
)
