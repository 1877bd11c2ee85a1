"""``glucoloop records``: files of sensors, pumps and apps, as one tidy record."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from glucoloop.cli.command import JSON, OVERWRITE_FILE, Command, CommandOption, Given
from glucoloop.cli.screen import file_to_write, print_text, print_value, show, write_file
from glucoloop.refusal import Refusal

if TYPE_CHECKING:
    import polars as pl

    from glucoloop.records import DeviceRecord

HELP: Final = (
    "Read the record of a person from files of sensors, pumps, apps and simulators.\n\n"
    "What a file is, is seen from what it holds: an export of Dexcom Clarity, LibreView, CareLink, Nightscout or "
    "Tidepool, a file of a published data set or of a simulator, or any table whose columns are named. A folder or a "
    "ZIP holds the files of a person; of a table of several people there is a record each. Everything that was "
    "changed or left out is told, with counts; what a file leaves open is asked for. Names and serial numbers are not "
    "read.\n\n"
    "  glucoloop records clarity.csv --out record.parquet\n\n"
    "  glucoloop records entries.json treatments.json --time-zone Europe/Berlin\n\n"
    "  glucoloop records diary.csv --columns time=Zeit,glucose_mg_dl=BZ --dates day-first\n\n"
    "From a Nightscout site its entries, treatments and time zone are fetched, by reading alone. A token stands in the "
    "environment variable GLUCOLOOP_NIGHTSCOUT_TOKEN, never on the command line.\n\n"
    "  glucoloop records --from nightscout https://my-site.example --days 14 --out record.parquet"
)
_READING: Final = "Reading"
_ANSWERS: Final = (
    CommandOption(
        "reader",
        "--reader",
        "The reader, where it cannot be seen; glucoloop list readers has all.",
        panel=_READING,
        metavar="NAME",
    ),
    CommandOption(
        "columns",
        "--columns",
        "Columns of any other table: time, glucose_mg_dl or glucose_mmol_l, carbs_g, bolus_U, basal_U_h and "
        "glucagon_ug, each by its name there.",
        panel=_READING,
        metavar="COLUMN=NAME,...",
    ),
    CommandOption(
        "dates",
        "--dates",
        "Order of day and month, where all dates could be either.",
        panel=_READING,
        metavar="day-first|month-first|year-first",
    ),
    CommandOption(
        "glucose_unit",
        "--glucose-unit",
        "Unit of glucose, where the file does not say it.",
        panel=_READING,
        metavar="mg/dl|mmol/l",
    ),
    CommandOption(
        "time_zone",
        "--time-zone",
        "Time zone of the person, like Europe/Berlin: times in UTC become local, and local ones get their offset.",
        panel=_READING,
        metavar="ZONE",
    ),
    CommandOption(
        "file_units",
        "--file-units",
        "Units of amounts in the files, where they are not g, U, U/h and ug: of carbs, bolus, long_acting, basal or "
        "glucagon, as basal=mU/h,carbs=10g; basal=U/h|mU/h for rates of which some are in mU/h.",
        panel=_READING,
        metavar="AMOUNT=UNIT,...",
    ),
    CommandOption(
        "device",
        "--device",
        "Device whose readings are used, where several read at the same time, by the name that the notes have.",
        panel=_READING,
        metavar="NAME",
    ),
    CommandOption(
        "person_column",
        "--person-column",
        "Column that says whose each row is, in a table of several people, where it cannot be seen.",
        panel=_READING,
        metavar="NAME",
    ),
    CommandOption("scans", "--scans", "Keep scans beside the readings that a sensor stores.", panel=_READING),
)
_NETWORK: Final = "Network"
_MAX_DIGITS: Final = 9
_NIGHTSCOUT: Final = "nightscout"
_SITE: Final = (
    CommandOption(
        "from", "--from", "Fetch the record from a site, whose address is FILE.", panel=_NETWORK, metavar=_NIGHTSCOUT
    ),
    CommandOption("days", "--days", "Number of days up to now.", panel=_NETWORK, metavar="N", default="14"),
)


def _records(given: Given) -> None:
    """Read the files, write the record, and say what it holds."""
    place = file_to_write(given)
    people = {"": _fetched(given)} if "from" in given else _read(given)
    if len(people) > 1:
        _of_people(list(people.values()), place, given)
        return
    [record] = people.values()
    if place is not None:
        write_file(place, record.parquet())
    if given.get("json"):
        from glucoloop.storage.files import with_version

        written = {"file": str(place)} if place is not None else {}
        print_value(with_version({**_described(record), **written}))
        return
    _print_record(record)
    print_text("Nothing was written; --out FILE keeps the record." if place is None else f"Wrote {place}.")


def _of_people(records: list[DeviceRecord], place: Path | None, given: Given) -> None:
    """Write and describe the records of several people, each in a file of its own; a name may be a person's own."""
    places = [_person_place(place, number) for number in range(1, len(records) + 1)] if place is not None else []
    for one in places:
        if one.exists() and not given.get("overwrite"):
            raise Refusal(f"{one} is there already; give another name, or add --overwrite")
    for record, one in zip(records, places, strict=False):
        write_file(one, record.parquet())
    if given.get("json"):
        from glucoloop.storage.files import with_version

        described = [
            {**_described(record), **({"file": str(places[number])} if places else {})}
            for number, record in enumerate(records)
        ]
        print_value(with_version({"people": described}))
        return
    for number, record in enumerate(records, 1):
        print_text(f"Person {number} of {len(records)}:")
        _print_record(record)
    written = f"Wrote {places[0]} to {places[-1]}." if places else "Nothing was written; --out FILE keeps the records."
    print_text(written)


def _person_place(place: Path, number: int) -> Path:
    """File of the record of one person of several: the one that was named, with the number of the person."""
    return place.with_name(f"{place.stem}-{number}{place.suffix}")


def _read(given: Given) -> dict[str, DeviceRecord]:
    from glucoloop.records.record import read_people

    if "days" in given:
        raise Refusal("--days is for a site; add --from nightscout, or leave it out")
    answers: dict[str, Any] = {option.key: given[option.key] for option in _ANSWERS if option.key in given}
    return read_people(*given["files"], **answers)


def _fetched(given: Given) -> DeviceRecord:
    """Record of a site; what answers questions of files is refused, but for the time zone."""
    if given["from"] != _NIGHTSCOUT:
        raise Refusal(f"--from is {given['from']!r}; the one kind of site is {_NIGHTSCOUT}")
    if len(given["files"]) > 1:
        raise Refusal(f"--from {_NIGHTSCOUT} has {len(given['files'])} addresses; give the one of the person")
    for option in _ANSWERS:
        if option.key in given and option.key != "time_zone":
            raise Refusal(f"{option.flag} is for files, and not for a site; leave it out")
    days = given.get("days", "14")
    if not days.isdecimal() or len(days) > _MAX_DIGITS:
        raise Refusal(f"--days is {days!r}; give a whole number of days")
    from glucoloop.records.nightscout_site import TOKEN_VARIABLE, read_nightscout

    token = os.environ.get(TOKEN_VARIABLE, "").strip() or None
    return read_nightscout(given["files"][0], days=int(days), token=token, time_zone=given.get("time_zone"))


def _described(record: DeviceRecord) -> dict[str, Any]:
    """A record in plain values."""
    times = record.frame["time"]
    counted = ("glucose_mg_dl", "carbs_g", "bolus_U", "long_acting_U", "basal_U_h", "glucagon_ug")
    return {
        "rows": record.rows,
        "rows_used": record.rows_used,
        "left_out": dict(record.left_out),
        "first": str(times.min()),
        "last": str(times.max()),
        "values": {name: record.frame.height - record.frame[name].null_count() for name in counted},
        "ranges": {name: ends for name in counted if (ends := _range_of(record.frame[name]))},
        "sums": {name: float(record.frame[name].sum()) for name in _SUMMED if record.frame[name].is_not_null().any()},
        "devices": sorted(record.frame["device"].drop_nulls().unique()),
        "notes": list(record.notes),
    }


_SUMMED: Final = ("carbs_g", "bolus_U", "long_acting_U", "glucagon_ug")
"""Columns of amounts, which have a sum."""


def _range_of(column: pl.Series) -> list[float] | None:
    """Smallest and largest number of a column; None if it has none."""
    numbers = column.drop_nulls().drop_nans()
    return [float(numbers.min()), float(numbers.max())] if len(numbers) else None  # type: ignore[arg-type]


def _print_record(record: DeviceRecord) -> None:
    from rich import box
    from rich.table import Table

    from glucoloop.reporting.columns import FittingTable

    summary = _described(record)
    print_text(
        f"{summary['rows_used']} of {summary['rows']} rows are used, from {summary['first']} to {summary['last']}."
    )
    table = Table("Column", box=box.SIMPLE_HEAD, pad_edge=False)
    for name in ("Values", "Minimum", "Maximum", "Sum"):
        table.add_column(name, justify="right")
    for name, count in summary["values"].items():
        numbers = [*summary["ranges"].get(name, [None, None]), summary["sums"].get(name)]
        table.add_row(name, str(count), *("" if number is None else f"{number:.2f}" for number in numbers))
    show(FittingTable(table))
    for note in record.notes:
        print_text(note)


RECORDS: Final = Command(
    "records",
    HELP,
    (
        CommandOption(
            "files",
            "FILE...",
            "Files of one person, a table of several people, or the address of a site.",
            metavar="FILE",
            many=True,
        ),
        *_ANSWERS,
        *_SITE,
        CommandOption("out", "--out", "File for the record, in the format Parquet.", metavar="FILE"),
        OVERWRITE_FILE,
        JSON,
    ),
    _records,
)
