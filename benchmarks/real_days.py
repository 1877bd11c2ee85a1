"""Days of people of AZT1D beside virtual people who live them: where the record lies among them.

    python benchmarks/real_days.py azt1d.zip --people 30     or with its folder in GLUCOLOOP_REAL_PEOPLE

Of each person of AZT1D (doi:10.17632/gk9m674wcx.1, CC BY 4.0) the last 28 days are used as by ``glucoloop days``. For
each number the median over people of the record and of the virtual people stand beside each other, and the number of
records within nine of ten virtual people. Nothing is written.
"""

import argparse
import os
import re
import sys
import tempfile
import time
import zipfile
from pathlib import Path

import jax

jax.config.update("jax_enable_x64", True)

import numpy as np  # noqa: E402

from glucoloop.refusal import Refusal  # noqa: E402
from glucoloop.situations.situation import configured  # noqa: E402
from glucoloop.studies.days import DaysRequest  # noqa: E402
from glucoloop.studies.days.study import NUMBERS, results_of  # noqa: E402


def main():
    """Compare everybody, and print a line for each number."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("place", nargs="?", type=Path, help="archive or folder of the data set")
    parser.add_argument("--people", type=int, default=30)
    parser.add_argument("--patient", default="hovorka-2004")
    request = parser.parse_args()
    place = request.place or (
        Path(os.environ["GLUCOLOOP_REAL_PEOPLE"]) if os.environ.get("GLUCOLOOP_REAL_PEOPLE") else None
    )
    if place is None or not place.exists():
        print("No archive or folder of the data set is given; see the head of this file for where to get it.")
        return 0
    compared, begun = [], time.process_time()
    with tempfile.TemporaryDirectory() as unpacked:
        for archive in [place] if place.is_file() else sorted(place.glob("*.zip")):
            with zipfile.ZipFile(archive) as files:
                files.extractall(unpacked)
        for folder in (Path(unpacked), place):
            for path in sorted(folder.rglob("Subject *.csv"), key=lambda path: int(re.sub(r"\D", "", path.stem))):
                settings = {"files": (str(path),), "people": request.people, "patient": request.patient}
                try:
                    plain = results_of(configured(DaysRequest, settings), lambda text: None).plain
                except Refusal as error:
                    print(f"{path.stem} is left out: {error.problem.rpartition(': ')[2]}")
                    continue
                compared.append(plain)
                record, median, low, high = plain["rows"]
                beside = ", ".join(
                    f"{name} {record[name]:.1f} beside {median[name]:.1f} ({low[name]:.1f} to {high[name]:.1f})"
                    for name in ("mean_mg_dl", "sd_mg_dl", "time_70_180_pct", "rises_day")
                )
                print(f"{path.stem}: {beside}; entries times {plain['habits']['eaten_over_entered']:.2f}", flush=True)
    print(f"\n{len(compared)} people. Median over people of the record, of the medians of virtual people; within 90 %")
    for number in NUMBERS:
        rows = [[row[number.name] for row in plain["rows"]] for plain in compared]
        known = np.array([row for row in rows if None not in row])
        inside = int(np.sum((known[:, 0] >= known[:, 2]) & (known[:, 0] <= known[:, 3])))
        record, virtual = np.median(known[:, :2], axis=0)
        print(f"{number.words:34}{record:9.{number.digits}f}{virtual:9.{number.digits}f}{inside:5} of {len(known)}")
    print(f"{(time.process_time() - begun) / max(1, len(compared)):.1f} s of a processor each")
    return 0


if __name__ == "__main__":
    sys.exit(main())
