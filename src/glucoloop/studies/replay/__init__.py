"""Replay: the days of a record again, with the doses of a controller in place of those that were given."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, ClassVar, Final

from glucoloop.component.effects import ANNOUNCEMENTS, MEALS_ANNOUNCED, Need
from glucoloop.component.request import Request, requested
from glucoloop.component.setting import Option
from glucoloop.forecasts.grid import SAMPLE_MIN
from glucoloop.patients.catalogue import patient_entry
from glucoloop.patients.component import PatientComponent
from glucoloop.refusal import Refusal
from glucoloop.schema.values import checked, json_value
from glucoloop.situations.case import Case
from glucoloop.situations.run import ControlledSituation
from glucoloop.situations.therapy_text import BolusShift, changes_option, read_change
from glucoloop.studies.study import COMPONENTS_HELP, PlainStudy
from glucoloop.studies.twin import RecordOfPerson

_SUMMARY: Final = "twin.json"
_PERSON: Final = "person.toml:twin"
_replay = functools.partial(Option, panel="Replay")


class ReplayRequest(RecordOfPerson, ControlledSituation):
    """Record, twin, and the controllers that dose in place of the person."""

    kind: ClassVar = "replay"
    # the person, the meals and the clock are those of the record
    refused: ClassVar = (
        *(
            "patient",
            "profile_by",
            "profile_error",
            "announce_meals",
            "carb_error_pct",
            "carb_bias_pct",
            "start",
            "rhythm",
            "rescue",
            "glucagon",
            "events",
            "actions",
        ),
        *("warm_up_min", "metrics"),
    )

    twin: Annotated[
        str | None, _replay("Folder of `glucoloop twin`, with the twin of the person of the record.", metavar="FOLDER")
    ] = None
    draws: Annotated[
        int, _replay("People drawn whom the record leaves open, for the intervals.", at_least=0, at_most=200)
    ] = 10
    unannounced: Annotated[
        bool, _replay("Do not tell the controller of the meals of the record.", needs=(ANNOUNCEMENTS,))
    ] = False
    changes: Annotated[
        tuple[str, ...], changes_option("Give the recorded doses with a change, which needs no controller", "Replay")
    ] = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        for text in self.changes:
            change = read_change(text)
            if isinstance(change, BolusShift) and change.earlier_min % SAMPLE_MIN:
                raise Refusal(f"{text!r}: a replay has samples of {SAMPLE_MIN:g} min; give a multiple of that")
            if any(case.label == text for case in self.cases):
                raise Refusal(f"a controller and a change are called {text!r}; give the controller another label")

    @functools.cached_property
    def cases(self) -> tuple[Case, ...]:
        """The controllers; none by default where changes are given."""
        return () if self.changes and not self.controller else super().cases

    def uses(self) -> frozenset[Need]:
        """Needs that the replay meets; meals of the record are announced unless that is left out."""
        return super().uses() - frozenset({MEALS_ANNOUNCED} if self.unannounced else ())

    @classmethod
    def resolved(cls, values: Mapping[str, Any]) -> dict[str, Any]:
        """The settings with the twin as the patient, to whose controllers meals are announced unless they are not."""
        twin = values["twin"]
        patient = values["patient"] if twin is None else _person(twin)
        return super().resolved({**values, "announce_meals": not values["unannounced"], "patient": patient})


def _person(twin: str) -> Request[PatientComponent]:
    """A twin as the one person of its family."""
    family = twin_values(twin).get("patient")
    if not isinstance(family, str):
        raise Refusal(f"{twin} holds no twin; give the folder of `glucoloop twin`")
    return requested(patient_entry(family), {"person": f"{twin}/{_PERSON}"}, alias=family)


def twin_values(twin: str | None) -> dict[str, Any]:
    """Plain values of a twin from the folder that holds it; Refusal where there are none."""
    from glucoloop.storage.files import read_text

    if twin is None:
        raise Refusal("no twin is given; give the folder of `glucoloop twin`, like --twin twin")
    place = Path(twin) / _SUMMARY
    if not place.is_file():
        raise Refusal(f"{twin} holds no {_SUMMARY}; give the folder of `glucoloop twin`")
    try:
        return checked(dict[str, Any], json_value(read_text(place, "a twin")))
    except Refusal as error:
        raise Refusal(f"{place} is damaged: {error}; find the twin again with `glucoloop twin`") from None


REPLAY: Final = PlainStudy(
    name="replay",
    what="a replay",
    help=(
        "Simulate the days of a record again on the person's twin, with doses of a controller, or with the recorded "
        "ones under a change, in place of those that were given.\n\n"
        "Meals are those of the record, announced when they were entered. What the record does not explain, such as "
        "meals that nobody entered, stays as an appearance of glucose, with which the twin under the recorded doses "
        "gives the record again; what a therapy changes is the difference from that. Only what returns glucose to its "
        "mean acts on glucose as the therapy makes it. Everything is done again with half and with one and a half of "
        "the sensitivity to insulin, which a record hardly tells, and for people drawn. Whether the twin predicted the "
        "days held out stands first.\n\n"
        f"{COMPONENTS_HELP}\n\n"
        "  glucoloop replay record.parquet --twin twin --controller profile-mpc --out replay\n\n"
        "  glucoloop replay record.parquet --twin twin --controller basal-bolus --controller profile-mpc\n\n"
        "  glucoloop replay record.parquet --twin twin --change 'basal, +10%, 0h-6h' --change 'bolus, 15 min earlier'"
    ),
    module="glucoloop.studies.replay.study",
    request=ReplayRequest,
    summary="replay.json",
)
