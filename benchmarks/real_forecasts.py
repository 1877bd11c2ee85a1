"""Forecasts of people of two published data sets by every method, beside the mean, the time of day, the last reading.

    python benchmarks/real_forecasts.py azt1d.zip t1d-uom.zip     or with their folder in GLUCOLOOP_REAL_PEOPLE

Each archive or folder holds ``Subject N.csv`` of AZT1D (doi:10.17632/gk9m674wcx.1) or ``UoMGlucoseN.csv`` with the
other files of each person of T1D-UOM (doi:10.5281/zenodo.15169263), both under CC BY 4.0. Of each person the last 28
days are used, the last 8 of them held out. The settings of the methods were chosen on the first eight people of AZT1D,
in the order of the names of their files; these, the others and all stand in lines of their own. Intervals of 95 % are
bootstraps over people. Nothing is written.
"""

import argparse
import itertools
import os
import re
import sys
import tempfile
import time
import zipfile
from pathlib import Path

import numpy as np

import glucoloop as gl
from glucoloop.forecasts.grid import SAMPLES_PER_DAY, gridded_record
from glucoloop.forecasts.method import METHODS
from glucoloop.forecasts.scores import DAY, forecast_errors
from glucoloop.refusal import Refusal

HORIZONS_MIN = (30, 60, 120, 240)
HELD_OUT_DAYS = 8
CHOSEN_ON = 8
"""Number of people of AZT1D on whom settings were chosen."""
EVERY = (
    "kalman",
    "kalman, individual=false",
    "twin",
    "ridge",
    "loop-like, fitted=true",
    "loop-like",
    "time-of-day",
    "mean",
    "persistence",
)
COMPARED = (("persistence", "60 min"), ("mean", "120 min"), ("ridge", "120 min"), ("mean", DAY), ("time-of-day", DAY))


def people_of(folder):
    """Data set, name and files of each person."""
    for path in sorted(folder.rglob("Subject *.csv")):
        yield "AZT1D", path.stem, [path]
    for path in sorted(folder.rglob("UoMGlucose*.csv")):
        who = re.sub(r"\D", "", path.stem)
        yield "T1D-UOM", who, sorted(folder.rglob(f"UoM*{who}.csv"))


def uses_pen(files):
    """Whether a person injects long-acting insulin."""
    return bool(gl.read_record(*files).frame["long_acting_U"].is_not_null().any())


def after_corrections(record, first_day):
    """Samples at or after a bolus that have a reading, with no carbohydrate from 1 h before to 4 h after it."""
    bolus = record.user_bolus_U + record.automatic_bolus_U > 0.0
    eaten = np.concatenate([[0], np.cumsum(record.carbs_g > 0.0)])
    at = np.flatnonzero(bolus & np.isfinite(record.reading_mg_dl))
    at = at[(at >= first_day * SAMPLES_PER_DAY) & (at + 48 < bolus.size)]
    return at[eaten[at + 48] == eaten[np.maximum(at - 12, 0)]]


def measured(record, text):
    """Error and coverage at each horizon of one person, and processor time of the fit."""
    first_day = record.days - HELD_OUT_DAYS
    begun = time.process_time()
    predictor = METHODS.choose(text).fit(record.of_days(0, first_day))
    result = {"cpu_s": time.process_time() - begun}
    for known in (True, False):
        for horizon, errors in forecast_errors(predictor, record, first_day, HORIZONS_MIN, future_known=known).items():
            result["rmse", known, horizon] = float(np.sqrt(np.mean(errors.error_mg_dl**2)))
            result["covered", known, horizon] = 100.0 * float(np.mean(errors.covered))
    origins, ahead = after_corrections(record, first_day), np.arange(24, 49, 3)
    if origins.size:
        forecast = predictor.forecast(record, origins, ahead, future_known=True)
        error = record.reading_mg_dl[origins[:, None] + ahead] - forecast.mean_mg_dl
        there = np.isfinite(error)
        result["corrections"] = 100.0 * float(np.mean((np.abs(error) <= forecast.half_width_mg_dl)[there]))
    return result


def median_text(values):
    """Median with its interval over people."""
    values = np.array(values)
    draws = np.random.default_rng(0).integers(0, values.size, (2000, values.size))
    low, high = np.percentile(np.median(values[draws], axis=1), (2.5, 97.5))
    return f"{np.median(values):5.1f} ({low:.1f}-{high:.1f})"


def print_group(title, people):
    """Lines of one group of people, by method."""
    print(f"\n{title}: {len(people)} people. RMSE in mg/dl, median over people (interval of 95 %)")
    horizons = (*(f"{horizon} min" for horizon in HORIZONS_MIN), DAY)
    print(f"{'method':34}" + "".join(f"{horizon:>19}" for horizon in horizons) + "  cpu s")
    for text in EVERY:
        rows = [person[text] for person in people if text in person]
        for known, label in ((True, "known"), (False, "unknown")):
            if rows:
                cells = "".join(f"{median_text([row['rmse', known, h] for row in rows]):>19}" for h in horizons)
                print(f"{text + ', ' + label:34}{cells}  {np.median([row['cpu_s'] for row in rows]):5.1f}")
    print("Readings in the band of 90 %: median (lowest to highest person) in %, future known; after corrections")
    for text in EVERY:
        rows = [person[text] for person in people if text in person]
        if not rows:
            continue
        texts = []
        for horizon in horizons:
            covered = [row["covered", True, horizon] for row in rows]
            texts.append(f"{np.median(covered):.0f} ({min(covered):.0f}-{max(covered):.0f})")
        after = [row["corrections"] for row in rows if "corrections" in row]
        print(f"{text:34}" + "".join(f"{one:>19}" for one in texts) + (f"  {np.median(after):.0f}" if after else ""))
    for own, (other, horizon) in itertools.product(("kalman", "twin"), COMPARED):
        pairs = [
            (person[own]["rmse", True, horizon], person[other]["rmse", True, horizon])
            for person in people
            if own in person and other in person
        ]
        if not pairs:
            continue
        difference = np.array([by_other - by_own for by_own, by_other in pairs])
        draws = np.random.default_rng(0).integers(0, difference.size, (2000, difference.size))
        low, high = np.percentile(difference[draws].mean(axis=1), (2.5, 97.5))
        print(
            f"{own} better than {other} at {horizon}: {int((difference > 0).sum())} of {difference.size}, "
            f"by {difference.mean():.1f} mg/dl ({low:.1f} to {high:.1f})"
        )


def main():
    """Forecast everybody, and print each group."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("places", nargs="*", type=Path, help="archives or folders of the data sets")
    places = parser.parse_args().places
    if not places and os.environ.get("GLUCOLOOP_REAL_PEOPLE"):
        places = [Path(os.environ["GLUCOLOOP_REAL_PEOPLE"])]
    if not places or not all(place.exists() for place in places):
        print("No archive or folder of the data sets is given; see the head of this file for where to get them.")
        return 0
    results = {"AZT1D": [], "T1D-UOM": [], "pens": []}
    with tempfile.TemporaryDirectory() as unpacked:
        for place in places:
            for archive in [place] if place.is_file() else sorted(place.glob("*.zip")):
                with zipfile.ZipFile(archive) as files:
                    files.extractall(unpacked)
        for folder in [Path(unpacked), *(place for place in places if place.is_dir())]:
            for of, name, files in people_of(folder):
                try:
                    record = gridded_record(gl.read_record(*files))
                    if not record.carbs_g.any() or not record.insulin_U.any():
                        raise Refusal("its last 28 days have no carbohydrate or no insulin")
                    results[of].append({text: measured(record, text) for text in EVERY})
                    if of == "T1D-UOM" and uses_pen(files):
                        results["pens"].append(results[of][-1])
                except Refusal as error:
                    print(f"{of} {name} is left out: {error.problem}")
                    continue
                day = {text: results[of][-1][text]["rmse", True, DAY] for text in ("kalman", "twin", "mean")}
                print(f"{of} {name}: day", ", ".join(f"{text} {rmse:.1f}" for text, rmse in day.items()), flush=True)
    azt1d = results["AZT1D"]
    groups = {
        "AZT1D, all": azt1d,
        "AZT1D, on whom settings were chosen": azt1d[:CHOSEN_ON],
        "AZT1D, the others": azt1d[CHOSEN_ON:],
        "T1D-UOM": results["T1D-UOM"],
        "T1D-UOM, pens": results["pens"],
    }
    for title, people in groups.items():
        if people:
            print_group(title, people)
    return 0


if __name__ == "__main__":
    sys.exit(main())
