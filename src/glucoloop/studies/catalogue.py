"""Every declared study by the name of its command; a study is one line here, and its declaration is loaded by name."""

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
RESULTS: Final = "Results"
_ENTRIES: Final = (
    ("studies.run:RUN", SIMULATE, "Close the loop: controller, virtual patient, meals."),
    ("studies.run:COMPARE", SIMULATE, "Close it with several controllers."),
    ("studies.trial:TRIAL", SIMULATE, "Try controllers on a population of virtual people."),
    ("studies.league:LEAGUE", SIMULATE, "Say which controller is best for whom, and where each does harm."),
    ("studies.tuning:TUNE", SIMULATE, "Try every tuning of a grid, and say which are any good."),
    ("studies.twin:TWIN", MODELS, "Find a person's own model from a record of ordinary life."),
    ("studies.replay:REPLAY", MODELS, "Simulate the days of a record again under another therapy."),
    ("studies.days:DAYS", MODELS, "Learn a person's days from a record, and let virtual people live them."),
    ("studies.forecast:FORECAST", MODELS, "Forecast glucose of a record by every method, and say how well each does."),
    ("studies.identification:IDENTIFY", MODELS, "Identify a model, also from your own CSV."),
    ("studies.stress:STRESS", SAFETY, "Try controllers under faults of sensor and pump, guarded or not."),
    ("studies.verification:VERIFY", SAFETY, "Close random loops, and check every promise at every sample."),
    ("studies.adversary:ADVERSARY", SAFETY, "Search for the sensor errors that do the most harm."),
    ("studies.detection:DETECT", SAFETY, "Say how soon and how well unannounced meals are detected."),
    ("studies.hil:HIL", CARRY_ON, "Close the loop with the controller on a chip."),
    ("studies.bound:BOUND", LIMITS, "Find the performance limit: how closely glucose could be held."),
    ("studies.robust:ROBUST", LIMITS, "Search for a tuning that is good for a whole population."),
    ("studies.record_report:REPORT", RESULTS, "Report glucose of a monitor or a simulation as clinics do."),
    ("reproduction.parker1999:REPRODUCE", RESULTS, "Reproduce a published study, number by number."),
)
STUDIES: Final = {
    place.partition(":")[2].lower(): CommandEntry(f"glucoloop.{place}", group, summary)
    for place, group, summary in _ENTRIES
}
