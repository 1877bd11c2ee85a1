"""What a campaign found."""

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
    """At which it was broken."""
    first_min: float
    faults: tuple[str, ...]
    """As `glucoloop run --fault` takes them."""


@dataclass(frozen=True)
class Arm:
    """The loops of one controller, with a guard or without."""

    controller: str
    guarded: bool
    engine: str
    loops: int
    samples: int
    broken: Mapping[str, int]
    """Promise -> loops."""
    repeated: int
    """Loops closed a second time."""
    not_repeated: tuple[int, ...]
    """People whose loop then had other bits."""
    told: tuple[Broken, ...]
    """The first few broken loops of each promise."""


@dataclass(frozen=True)
class Guarding:
    """Time below 60 mg/dl of the same people with a guard and without. A figure and no promise."""

    MARGIN_PCT: ClassVar[float] = 1.0
    """Of the time; less is no difference."""

    controller: str
    pairs: int
    bare_pct: float
    """Mean of all."""
    guarded_pct: float
    better: int
    """People with less than without, by more than the margin."""
    worse: int
    worst_pct: float
    """Largest difference; above 0: with a guard it was longer."""
    worst_person: int


@dataclass(frozen=True)
class CampaignResult:
    """What a campaign found, by controller."""

    patient: str
    """Around whom people were drawn."""
    seed: int
    arms: tuple[Arm, ...]
    guarding: tuple[Guarding, ...]
    interrupted: bool = False
    """Whether it ended early; then only what was finished of controllers is here."""

    @property
    def loops(self) -> int:
        """Closed and checked, without those closed again."""
        return sum(arm.loops for arm in self.arms)

    @property
    def samples(self) -> int:
        """Checked."""
        return sum(arm.samples for arm in self.arms)

    @property
    def repeated(self) -> int:
        """Loops closed a second time."""
        return sum(arm.repeated for arm in self.arms)

    @property
    def violations(self) -> dict[str, int]:
        """Promise -> loops in which it was broken, of all arms."""
        counts = {promise: sum(arm.broken[promise] for arm in self.arms) for promise in PROMISES}
        return {**counts, SAME_BITS: sum(len(arm.not_repeated) for arm in self.arms)}

    @property
    def holds(self) -> bool:
        """Whether no promise was broken."""
        return not any(self.violations.values())
