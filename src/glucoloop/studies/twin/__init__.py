"""Twin of a person: the parameters of a family of patients, found from a record of ordinary life."""

from __future__ import annotations

import functools
from typing import Annotated, ClassVar, Final

from glucoloop.component.base import Component
from glucoloop.component.grammar import Tree
from glucoloop.component.setting import PATIENT_PANEL, Option
from glucoloop.patients.catalogue import patient_entry
from glucoloop.refusal import Refusal
from glucoloop.studies.study import PlainStudy

_record = functools.partial(Option, panel="Record")
_search = functools.partial(Option, panel="Search")
_patient = functools.partial(Option, panel=PATIENT_PANEL)


class RecordOfPerson(Component):
    """Files of a person's record, and what they do not tell."""

    kind: ClassVar = "record"

    files: Annotated[
        tuple[str, ...],
        _record(
            "Record of one person: a file that `glucoloop records` wrote, or files that it reads without an answer.",
            flag="FILE...",
            metavar="FILE",
        ),
    ] = ()
    most_days: Annotated[
        int, _record("Days at most; of a longer record the last ones are used.", flag="--days", at_least=1, at_most=90)
    ] = 28
    basal_U_h: Annotated[
        float | None,
        _record("Basal rate where the record tells none.", flag="--basal", metavar="U/h", above=0.0, at_most=35.0),
    ] = None

    def tree(self, *, whole: bool = False) -> Tree:
        """Settings without the files, whose names often hold that of a person."""
        results = super().tree(whole=whole)
        results.pop("files", None)
        return results


class TwinRequest(RecordOfPerson):
    """Record, family of patients, and how the twin is found."""

    kind: ClassVar = "twin"

    patient: Annotated[
        str,
        _patient(
            "Family of patients, whose population is what is accepted of the person before: `glucoloop list patients`.",
            metavar="NAME",
        ),
    ] = "hovorka-2004"
    population: Annotated[
        str | None,
        _patient("Another population of the family, or a file.", metavar="NAME|FILE", default="the default one"),
    ] = None
    weight_kg: Annotated[
        float | None,
        _patient("Body weight, where it is known.", flag="--weight", metavar="KG", at_least=5.0, at_most=300.0),
    ] = None
    held_out_days: Annotated[
        int | None,
        _search(
            "Last days whose readings are not used, and are predicted as a check; 0 for none.",
            at_least=0,
            at_most=30,
            default="a third, 8 at most",
        ),
    ] = None

    def __post_init__(self) -> None:
        patient_entry(self.patient)  # refuses an unknown one
        if self.held_out_days is not None and self.held_out_days >= self.most_days:
            raise Refusal(
                f"--held-out-days is {self.held_out_days} of {self.most_days} days, so nothing is left; hold out fewer"
            )


TWIN: Final = PlainStudy(
    name="twin",
    what="a twin",
    help=(
        "Find a person's own model, the twin, from a record of ordinary life: readings of a sensor, meals and insulin, "
        "without any test dose.\n\n"
        "The twin is the most likely person of a family of patients, given the record and what is assumed of people "
        "of that family, beside an appearance of glucose that nobody entered. The last days are held out and "
        "predicted; whether the twin is to be relied on stands first, and what the record does not tell is said.\n\n"
        "  glucoloop records export.csv --out record.parquet\n\n"
        "  glucoloop twin record.parquet --weight 72 --out twin\n\n"
        "  glucoloop replay record.parquet --twin twin --controller profile-mpc --out replay\n\n"
        "  glucoloop run --patient 'hovorka-2004, person=twin/person.toml:twin' --controller profile-mpc\n\n"
        "  glucoloop trial --patient hovorka-2004 --population twin/posterior.toml --people 200 --out people"
    ),
    module="glucoloop.studies.twin.study",
    request=TwinRequest,
    summary="twin.json",
)
