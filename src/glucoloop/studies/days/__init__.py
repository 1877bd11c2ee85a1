"""Days of a person by a record: a scenario of the person's habits, and virtual people who live it beside the record."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar, Final

from glucoloop.component.effects import MEALS_ANNOUNCED, TIME_OF_DAY, Need
from glucoloop.component.request import Request
from glucoloop.meals.rescue import RESCUES, RescueComponent
from glucoloop.patients.catalogue import PATIENTS
from glucoloop.patients.component import PatientComponent
from glucoloop.situations.case import Case, cases_of
from glucoloop.studies.study import COMPONENTS_HELP, PlainStudy
from glucoloop.studies.twin import RecordOfPerson
from glucoloop.trials.trial import Trial

_FAMILY: Final = "hovorka-2004"
SCENARIO: Final = "scenario.toml"
TRIAL: Final = "trial.toml"


class DaysRequest(Trial, RecordOfPerson):
    """Record, and the virtual people who live its days under its therapy, or under other controllers."""

    kind: ClassVar = "comparison with a record"
    # meals, clock, length and profile are those of the record
    refused: ClassVar[tuple[str, ...]] = (
        *("scenario", "days", "duration_min", "meals", "meal_size_spread_pct", "meal_time_spread_min", "habits"),
        *("exercise", "exercise_spread_pct", "exercise_time_spread_min", "announce_meals", "announce_before_min"),
        *("start", "events", "therapy", "profile_by", "profile_error", "targets", "overrides", "actions"),
        *("warm_up_min", "metrics", "traces", "shard_people", "first_person", "sample_time_min"),
    )

    people: int = 50
    patient: PatientComponent = PATIENTS.by_default(_FAMILY)
    controller: tuple[Request[Case], ...] = cases_of("basal-bolus")
    rescue: RescueComponent | None = RESCUES.by_default(RESCUES.default)

    def uses(self) -> frozenset[Need]:
        """Needs that the trial of the days meets, whose meals are announced at times of day."""
        return super().uses() | {MEALS_ANNOUNCED, TIME_OF_DAY}

    @classmethod
    def resolved(cls, values: Mapping[str, Any]) -> dict[str, Any]:
        """The settings with announced meals, as those of the record are."""
        return super().resolved({**values, "announce_meals": True})


DAYS: Final = PlainStudy(
    name="days",
    what="a comparison with a record",
    help=(
        "Learn how a person lives from a record, write it as a scenario, and let virtual people live these days beside "
        "the record.\n\n"
        "The scenario has the meals that are entered with their times, sizes, spreads and how often each is eaten, "
        "weekends where they differ, boluses that are missed or late, rises of glucose without an entered meal as "
        "snacks of which nobody is told, and gaps of the sensor. Its comments say what each rests on, and what a "
        "record does not tell. Virtual people then live as many days of it under the therapy of the record, scaled to "
        "the basal rate that each needs: mean, variation, ranges, nights and rises stand side by side.\n\n"
        f"{COMPONENTS_HELP}\n\n"
        "  glucoloop days record.parquet --out days\n\n"
        "  glucoloop days record.parquet --patient uva-padova-2008 --controller basal-bolus --controller oref0\n\n"
        f"  glucoloop trial --patient hovorka-2004 --controller oref0 --scenario days/{SCENARIO} --out trial"
    ),
    module="glucoloop.studies.days.study",
    request=DaysRequest,
    option_texts={
        "default": {"patient": _FAMILY},
        "help": {
            "patient": "Patient, around whom people vary.",
            "setpoint_mg_dl": "Glucose at which all people rest; that of the record's nights by default.",
            "seed": "The same seed gives the same people, meals and noise.",
        },
        "rare": dict.fromkeys(("setpoint_mg_dl", "noise_variance", "dead_time_min", "model", "design"), True),
    },
    files=("page.html", SCENARIO, TRIAL, "numbers.csv"),
    summary="days.json",
)
