"""Results of a campaign."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Final

from glucoloop.studies.verification.invariants import PROMISES

SAME_BITS: Final = "the same bits again, in another order and other blocks"


@dataclass(frozen=True)
class Broken:
    """A loop that broke a promise."""

    promise: str
    person: int
    samples: int
    """Number of samples at which the promise was broken."""
    first_min: float
    faults: tuple[str, ...]
    """Faults in the form of `glucoloop run --fault`."""


@dataclass(frozen=True)
class Arm:
    """The loops of one controller, with a guard or without."""

    controller: str
    guarded: bool
    engine: str
    not_native: str | None
    """Operation that native code lacks for the loops, and in whose code it is; None if they ran in it."""
    loops: int
    samples: int
    broken: Mapping[str, int]
    """Number of loops that broke each promise."""
    repeated: int
    """Number of loops that were repeated."""
    not_repeated: tuple[int, ...]
    """People whose repeated loop had other bits."""
    told: tuple[Broken, ...]
    """The first few broken loops of each promise."""


@dataclass(frozen=True)
class Guarding:
    """Time below 60 mg/dl of the same people with a guard and without; a result, not a promise."""

    MARGIN_PCT: ClassVar[float] = 1.0
    """Smallest difference that counts, in percent of the time."""

    controller: str
    pairs: int
    bare_pct: float
    """Mean time without a guard over all people, in percent."""
    guarded_pct: float
    better: int
    """Number of people whose time was shorter with the guard, by more than the margin."""
    worse: int
    worst_pct: float
    """Largest difference; above 0 if the time was longer with the guard."""
    worst_person: int


@dataclass(frozen=True)
class CampaignResult:
    """Results of a campaign by controller."""

    patient: str
    """Patient around whom people were drawn."""
    seed: int
    arms: tuple[Arm, ...]
    guarding: tuple[Guarding, ...]
    interrupted: bool = False
    """Whether the campaign ended early; it then holds only finished controllers."""

    @property
    def loops(self) -> int:
        """Number of loops that were simulated and checked, without repeated ones."""
        return sum(arm.loops for arm in self.arms)

    @property
    def samples(self) -> int:
        """Number of checked samples."""
        return sum(arm.samples for arm in self.arms)

    @property
    def repeated(self) -> int:
        """Number of loops that were repeated."""
        return sum(arm.repeated for arm in self.arms)

    @property
    def violations(self) -> dict[str, int]:
        """Number of loops in which each promise was broken, over all arms."""
        counts = {promise: sum(arm.broken[promise] for arm in self.arms) for promise in PROMISES}
        return {**counts, SAME_BITS: sum(len(arm.not_repeated) for arm in self.arms)}

    @property
    def holds(self) -> bool:
        """Whether no promise was broken."""
        return not any(self.violations.values())
