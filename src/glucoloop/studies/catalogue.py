"""Every declared study by the name of its command; a study is one entry here, and its declaration is loaded by name."""

from __future__ import annotations

from typing import Final, NamedTuple


class StudyEntry(NamedTuple):
    """A study in the help of the program."""

    place: str
    """Place ``module:attribute`` of its declaration."""
    group: str
    """Heading of the help of the program."""
    summary: str


SIMULATE: Final = "Simulate"
SAFETY: Final = "Safety"
LIMITS: Final = "Limits of what is possible"
STUDIES: Final = {
    "tune": StudyEntry(
        "glucoloop.studies.tuning:TUNE", SIMULATE, "Try every tuning of a grid, and say which are any good."
    ),
    "stress": StudyEntry(
        "glucoloop.studies.stress:STRESS", SAFETY, "Try controllers under faults of sensor and pump, guarded or not."
    ),
    "verify": StudyEntry(
        "glucoloop.studies.verification:VERIFY", SAFETY, "Close random loops, and check every promise at every sample."
    ),
}
