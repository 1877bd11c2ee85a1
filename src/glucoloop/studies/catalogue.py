"""Every declared study by the name of its command; a study is one entry here, and its declaration is loaded by name."""

from __future__ import annotations

from typing import Final, NamedTuple


class CommandEntry(NamedTuple):
    """A command in the help of the program; nothing of it is imported before it is asked for."""

    place: str
    """Place ``module:attribute`` of its declaration."""
    group: str
    """Heading of the help of the program."""
    summary: str


SIMULATE: Final = "Simulate"
SAFETY: Final = "Safety"
LIMITS: Final = "Limits of what is possible"
CARRY_ON: Final = "Carry on"
MODELS: Final = "People and models"
STUDIES: Final = {
    "run": CommandEntry("glucoloop.studies.run:RUN", SIMULATE, "Close the loop: controller, virtual patient, meals."),
    "compare": CommandEntry("glucoloop.studies.run:COMPARE", SIMULATE, "Close it with several controllers."),
    "trial": CommandEntry(
        "glucoloop.studies.trial:TRIAL", SIMULATE, "Try controllers on a population of virtual people."
    ),
    "tune": CommandEntry(
        "glucoloop.studies.tuning:TUNE", SIMULATE, "Try every tuning of a grid, and say which are any good."
    ),
    "identify": CommandEntry(
        "glucoloop.studies.identification:IDENTIFY", MODELS, "Identify a model, also from your own CSV."
    ),
    "stress": CommandEntry(
        "glucoloop.studies.stress:STRESS", SAFETY, "Try controllers under faults of sensor and pump, guarded or not."
    ),
    "verify": CommandEntry(
        "glucoloop.studies.verification:VERIFY", SAFETY, "Close random loops, and check every promise at every sample."
    ),
    "adversary": CommandEntry(
        "glucoloop.studies.adversary:ADVERSARY", SAFETY, "Search for the sensor errors that do the most harm."
    ),
    "detect": CommandEntry(
        "glucoloop.studies.detection:DETECT", SAFETY, "Say how soon and how well unannounced meals are detected."
    ),
    "hil": CommandEntry("glucoloop.studies.hil:HIL", CARRY_ON, "Close the loop with the controller on a chip."),
    "bound": CommandEntry("glucoloop.studies.bound:BOUND", LIMITS, "Find how closely glucose could be held at all."),
    "robust": CommandEntry(
        "glucoloop.studies.robust:ROBUST", LIMITS, "Search for a tuning that is good for a whole population."
    ),
}
