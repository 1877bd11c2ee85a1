"""Report on records of continuous glucose monitors, or of simulated people: the ambulatory glucose profile."""

from __future__ import annotations

import datetime as dt
import functools
from typing import Annotated, ClassVar, Final, Literal, NamedTuple

from glucoloop.component.base import Component
from glucoloop.component.grammar import Tree
from glucoloop.component.setting import Option
from glucoloop.refusal import Refusal
from glucoloop.studies.study import PlainStudy
from glucoloop.text import how_many, is_printable

_LAST: Final = "last-"
_MAX_DAYS: Final = 3660
_report = functools.partial(Option, panel="Report")
_reading = functools.partial(Option, panel="Reading")


class Period(NamedTuple):
    """Days of a record that are reported."""

    text: str
    first: dt.date | None = None
    last: dt.date | None = None
    """The last day; it is included."""
    days: int = 0
    """Number of the last days of the record, in place of dates."""


def period_of(text: str) -> Period:
    """A period by its text: two dates like ``2026-03-01/2026-03-14``, or ``last-14`` for the last 14 days."""
    if text.startswith(_LAST) and text.removeprefix(_LAST).isdecimal():
        days = int(text.removeprefix(_LAST))
        if 1 <= days <= _MAX_DAYS:
            return Period(text, days=days)
        raise Refusal(f"--period {text} is not possible; give last-1 to last-{_MAX_DAYS}")
    first, _, last = text.partition("/")
    try:
        period = Period(text, dt.date.fromisoformat(first), dt.date.fromisoformat(last))
    except ValueError:
        raise Refusal(
            f"--period {text!r} is no period; give two dates like 2026-03-01/2026-03-14, or last-14"
        ) from None
    assert period.first is not None
    assert period.last is not None
    if period.last < period.first:
        raise Refusal(f"--period {text} ends before it begins; give the earlier date first")
    return period


class RecordRequest(Component):
    """Records that are reported, and how."""

    kind: ClassVar = "report"

    files: Annotated[
        tuple[str, ...],
        _report(
            "Records of a monitor in any format that can be read, tables of several people, folders with a file or a "
            "folder for each person, or "
            "folders that `glucoloop run`, `compare` or `trial --traces` wrote.",
            flag="FILE...",
            metavar="FILE",
        ),
    ] = ()
    periods: Annotated[
        tuple[str, ...],
        _report(
            "Days that are reported, 2026-03-01/2026-03-14 or last-14; repeat it to compare periods.",
            flag="--period",
            metavar="DAYS",
            default="all",
        ),
    ] = ()
    labels: Annotated[
        tuple[str, ...],
        _report(
            "Name of a record, or of the group of a folder, in the order of the files; names of files are not shown, "
            "since they often hold that of the person.",
            flag="--label",
            metavar="NAME",
            default="Record 1, Record 2 and so on",
        ),
    ] = ()
    file_names: Annotated[
        bool,
        _report(
            "Name records by their files, where these hold no name of a person; else a person of a folder has the "
            "number of the file in the order of names."
        ),
    ] = False
    reader: Annotated[
        str | None, _reading("Reader of the files, where it cannot be seen: `glucoloop list readers`.")
    ] = None
    dates: Annotated[
        Literal["day-first", "month-first", "year-first"] | None,
        _reading("Order of day and month, where a file leaves it open."),
    ] = None
    glucose_unit: Annotated[
        Literal["mg/dl", "mmol/l"] | None, _reading("Unit of glucose, where a file does not say it.")
    ] = None
    time_zone: Annotated[
        str | None, _reading("Time zone of the person, like Europe/Berlin, where a file tells times in UTC.")
    ] = None
    columns: Annotated[
        str | None,
        _reading("Columns of any other table, like time=Zeit,glucose_mg_dl=BZ.", metavar="NAMES"),
    ] = None
    file_units: Annotated[
        str | None,
        _reading(
            "Units of amounts in the files, where they are not g, U, U/h and ug, like basal=mU/h,carbs=10g.",
            metavar="UNITS",
        ),
    ] = None
    device: Annotated[
        str | None, _reading("Device whose readings are used, where several read at the same time.", metavar="NAME")
    ] = None
    person_column: Annotated[
        str | None,
        _reading("Column that says whose each row is, in a table of several people.", metavar="NAME"),
    ] = None
    scans: Annotated[bool, _reading("Keep scans of a Libre beside the readings that it stores by itself.")] = False
    goals: Annotated[
        Literal["adult", "older", "pregnancy"],
        _report("Goals of the consensus: for adults, for older people or those at high risk, or in pregnancy."),
    ] = "adult"

    def __post_init__(self) -> None:
        if self.labels and len(self.labels) != len(self.files):
            raise Refusal(
                f"--label is given {len(self.labels)} times for {how_many(len(self.files), 'file')}; give one for each"
            )
        if len(set(self.labels)) < len(self.labels):
            raise Refusal("a --label is given twice; give each file its own")
        if self.labels and self.file_names:
            raise Refusal("--label and --file-names both name the records; leave one out")
        for label in self.labels:
            if not label.strip() or not is_printable(label):
                raise Refusal(f"--label {label!r} cannot be shown in a line; give a name without control characters")
        for text in self.periods:
            period_of(text)

    def tree(self, *, whole: bool = False) -> Tree:
        """Settings without the files, whose names often hold that of a person."""
        results = super().tree(whole=whole)
        results.pop("files", None)
        return results


REPORT: Final = PlainStudy(
    name="report",
    what="a report",
    help=(
        "Report records of a continuous glucose monitor in the form that clinics know, the ambulatory glucose "
        "profile: the ten numbers of the consensus with its goals, the time in each range, percentiles over the day, "
        "each day, and every episode of low and high glucose.\n\n"
        "The page needs no network and prints. Several files or periods stand side by side; for many there is a row "
        "for each. A folder is a group of people, with a file or a folder for each; several folders are compared as "
        "groups; a file of it that cannot be read is named, and the exit code is 1. Names and serial numbers are in "
        "none of the results, nor are names of files unless --file-names is given.\n\n"
        "  glucoloop report export.csv --out report\n\n"
        "  glucoloop report export.csv --period 2026-02-01/2026-02-14 --period 2026-03-01/2026-03-14 --out compared\n\n"
        "  glucoloop report before after --label before --label after --out groups\n\n"
        "  glucoloop run --days 14 --out run && glucoloop report run --out report"
    ),
    module="glucoloop.studies.record_report.study",
    request=RecordRequest,
    files=(
        "figure.pdf",
        "figure.png",
        "figure.svg",
        "metrics.csv",
        "metrics.parquet",
        "groups.csv",
        "days.csv",
        "episodes.csv",
        "profile.csv",
        "report.html",
    ),
    summary="report.json",
    unit="sources",
)
