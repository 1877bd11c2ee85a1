"""People of two published data sets, read and compared with a count of the same files by Python's csv module.

python benchmarks/real_people.py --folder FOLDER     or with the folder in GLUCOLOOP_REAL_PEOPLE

The folder holds ``Subject N.csv`` of AZT1D (doi:10.17632/gk9m674wcx.1) and ``UoMGlucoseN.csv`` with the other files
of each person of T1D-UOM (doi:10.5281/zenodo.15169263), both under CC BY 4.0, or the ZIPs of these. Readings,
carbohydrate, boluses, long-acting insulin and daily basal insulin of each person have to be equal, but for readings
that the record says to be there twice, and rows of a mistyped year; nothing is written.
"""

from __future__ import annotations

import argparse
import csv
import io
import itertools
import math
import os
import re
import sys
import tempfile
import zipfile
from collections import defaultdict
from datetime import datetime, timedelta
from pathlib import Path

import polars as pl

import glucoloop as gl

MG_DL_PER_MMOL_L = 18.0156
TWICE = re.compile(
    r"(?:Left out: readings that stand there twice, at slightly different times \(|^)(\d+)"
    r"(?:\)| rows? lost a value and kept another one: readings that stand there twice)"
)
COLUMNS = {"readings": "glucose_mg_dl", "carbs_g": "carbs_g", "bolus_U": "bolus_U", "long_acting_U": "long_acting_U"}


def rows_of(path):
    """Rows of a CSV as dictionaries, exact repeats once."""
    text = path.read_bytes().decode("utf-8-sig")
    rows = csv.DictReader(io.StringIO(text))
    return list({tuple((key, value) for key, value in row.items() if key): row for row in rows}.values())


def time_of(row):
    """Time of a row of T1D-UOM."""
    text = next(text for name, text in row.items() if name.endswith("_ts"))
    return datetime.strptime(text.strip(), "%d/%m/%Y %H:%M")


def wrong_years(files):
    """Times of at most 12 rows that lie 90 days from all others of a person, as those of 2033 or 2204 do."""
    times = sorted(time_of(row) for path in files for row in rows_of(path))
    parts = [[times[0]]]
    for time in times[1:]:
        if time - parts[-1][-1] >= timedelta(days=90):
            parts.append([])
        parts[-1].append(time)
    return {time for part in parts if len(part) <= 12 for time in part}


def number(text):
    return float(text) if text and text.strip() else None


def basal_by_day(rates):
    """Basal insulin of each day [U], of rates held until the next one."""
    result = defaultdict(float)
    for (begin, rate), (end, _) in itertools.pairwise(rates):
        while begin < end:
            midnight = datetime.combine(begin.date(), datetime.min.time()) + timedelta(days=1)
            until = min(end, midnight)
            result[begin.date()] += rate * (until - begin).total_seconds() / 3600.0
            begin = until
    return dict(result)


def in_U_h(rates):
    """Rates of AZT1D in U/h: those above 35 are in mU/h, those below 1 in U/h, and others as the nearest of these."""
    sure = [(at, 1e-3 if rate > 35.0 else 1.0) for at, rate in rates if rate > 35.0 or 0.0 < rate < 1.0]
    place, result = 0, []
    for at, rate in rates:
        while place + 1 < len(sure) and sure[place + 1][0] <= at:
            place += 1
        near = [one for one in sure[max(0, place - 1) : place + 2]]
        factor = min(near, key=lambda one: (abs(one[0] - at), one[0] > at))[1] if near else 1.0
        result.append((at, rate * factor))
    return result


def counted_azt1d(path):
    """Sums of a person of AZT1D by hand."""
    rows = rows_of(path)
    glucose = "CGM" if "CGM" in rows[0] else "Readings (CGM / BGM)"
    readings = {}
    for row in rows:
        value = number(row[glucose])
        if value and 20.0 <= value <= 800.0:
            readings.setdefault(row["EventDateTime"], value)
    rates = [
        (datetime.fromisoformat(row["EventDateTime"]), number(row["Basal"])) for row in rows if row["Basal"].strip()
    ]
    rates = sorted(dict(reversed(rates)).items())
    return {
        "readings": len(readings),
        "carbs_g": sum(number(row["CarbSize"]) or 0.0 for row in rows),
        "bolus_U": sum(number(row["TotalBolusInsulinDelivered"]) or 0.0 for row in rows),
        "long_acting_U": 0.0,
    }, basal_by_day(in_U_h(rates))


def counted_uom(files):
    """Sums of a person of T1D-UOM by hand."""
    result, rates = {"readings": 0, "carbs_g": 0.0, "bolus_U": 0.0, "long_acting_U": 0.0}, {}
    wrong = wrong_years(files)
    for path in files:
        for row in rows_of(path):
            if "bg_ts" in row or time_of(row) in wrong:
                continue
            if "bolus_ts" in row:
                result["bolus_U"] += number(row["bolus_dose"]) or 0.0
            elif "meal_ts" in row:
                result["carbs_g"] += number(row["carbs_g"]) or 0.0
            elif row["insulin_kind"] == "L":
                result["long_acting_U"] += number(row["basal_dose"]) or 0.0
            elif row["basal_dose"].strip():
                at = datetime.strptime(row["basal_ts"], "%d/%m/%Y %H:%M")
                rates.setdefault(at, number(row["basal_dose"]))
    readings = {}
    for path in files:
        if "Glucose" in path.name:
            for row in rows_of(path):
                if (value := number(row["value"])) and 20.0 <= value * MG_DL_PER_MMOL_L <= 800.0:
                    readings.setdefault(row["bg_ts"], value)
    return {**result, "readings": len(readings)}, basal_by_day(sorted(rates.items()))


def read(files):
    """The same sums of a record, and its days of basal insulin."""
    record = gl.read_record(*files)
    frame = record.frame
    sums = {
        name: float(frame[column].is_not_null().sum() if name == "readings" else frame[column].sum())
        for name, column in COLUMNS.items()
    }
    sums["readings"] += sum(int(count) for note in record.notes for count in TWICE.findall(note))
    rates = frame.filter(pl.col("basal_U_h").is_not_null()).unique("time", keep="first", maintain_order=True)
    known = record.rows_used + sum(record.left_out.values()) == record.rows
    return sums, basal_by_day(list(rates.select("time", "basal_U_h").iter_rows())), known, record


def people_of(folder):
    """Files of each person."""
    for path in sorted(folder.rglob("Subject *.csv")):
        yield path.stem, [path], counted_azt1d(path)
    for path in sorted(folder.rglob("UoMGlucose*.csv")):
        who = path.stem.removeprefix("UoMGlucose")
        files = sorted(one for one in folder.rglob(f"UoM*{who}.csv"))
        yield f"UoM {who}", files, counted_uom(files)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--folder", type=Path, default=os.environ.get("GLUCOLOOP_REAL_PEOPLE"))
    parser.add_argument("--notes", action="store_true", help="print the notes of each record too")
    given = parser.parse_args()
    if given.folder is None or not Path(given.folder).is_dir():
        print("No folder with the data sets is given; see the head of this file for where to get them.")
        return 0
    wrong = 0
    with tempfile.TemporaryDirectory() as unpacked:
        for archive in Path(given.folder).glob("*.zip"):
            with zipfile.ZipFile(archive) as files:
                files.extractall(unpacked)
        folder = Path(unpacked) if any(Path(unpacked).iterdir()) else Path(given.folder)
        for name, files, (sums, days) in people_of(folder):
            told, told_days, known, record = read(files)
            equal = known and all(math.isclose(told[key], sums[key], rel_tol=1e-9, abs_tol=1e-6) for key in sums)
            same_days = days.keys() == told_days.keys() and all(
                math.isclose(days[day], told_days[day], rel_tol=1e-9, abs_tol=1e-6) for day in days
            )
            wrong += not (equal and same_days)
            verdict = (
                "equal" if equal and same_days else f"DIFFERS: counted {sums}, {sum(days.values()):.3f} U of basal"
            )
            daily = sum(told_days.values()) / max(1, len(told_days))
            print(
                f"{name}: {told['readings']:.0f} readings, {told['carbs_g']:.0f} g, {told['bolus_U']:.2f} U of bolus, "
                f"{told['long_acting_U']:.0f} U long-acting, {daily:.2f} U of basal a day; {verdict}"
            )
            if given.notes or not (equal and same_days):
                print(*(f"    {note}" for note in record.notes), sep="\n")
    print(f"{wrong} people differ.")
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main())
