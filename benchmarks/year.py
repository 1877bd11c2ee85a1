"""Measure what long trials cost: processor time of a patient-day, memory and disk, for 1 to 52 weeks.

    python benchmarks/year.py [--json] [--small] [--controller PART] [--patient-days N]

People of `parker-1999` live their own days (the scenario ``week``), with sensor noise, in float32, under linear MPC or
another controller, on one core: shards are computed and written to a folder as by ``glucoloop trial``, and all that is
compiled was compiled before. Each length has a process of its own, of which the maximum memory is told. Times are of
the processor, so that what else runs on the machine disturbs less. From the time of the longest follows what the record
would take, a million people for 52 weeks:

    glucoloop trial --people 1000000 --scenario "week, days=364" --noise 1.45 --precision float32 --out record

``--small`` takes some seconds, and shows that all this works.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from glucoloop.situations.situation import configured
from glucoloop.trials.computing import run_here
from glucoloop.trials.engine import prepare, run_people
from glucoloop.trials.folder import trial_folder
from glucoloop.trials.trial import MIN_BLOCK, Trial

WEEKS = (1, 4, 12, 52)
RECORD_PATIENT_DAYS = 1_000_000 * 364


def measured(weeks: int, patient_days: int, controller: str) -> dict[str, Any]:
    """Time, memory and disk of a trial of so many patient-days, in this process."""
    people = max(1, round(patient_days / (7 * weeks * MIN_BLOCK))) * MIN_BLOCK
    keys = {
        "people": people,
        "scenario": f"week, days={7 * weeks}",
        "sensor": ["white-noise, variance=1.45"],
        "precision": "float32",
        "controller": [controller],
    }
    trial = configured(Trial, keys)
    prepared = prepare(trial)

    def simulate(label: str, person: np.ndarray, traces: bool) -> Any:
        return run_people(prepared, label, person, traces=traces, threads=1)

    simulate(trial.cases[0].label, np.arange(min(people, trial.people_a_block)), False)  # which compiles
    with tempfile.TemporaryDirectory() as place, trial_folder(Path(place) / "trial", trial) as folder:
        start = time.process_time()
        run_here(folder, simulate)
        seconds = time.process_time() - start
        written = sum(file.stat().st_size for file in folder.path.rglob("*") if file.is_file())
    return {
        "weeks": weeks,
        "people": people,
        "shards": trial.shards,
        "patient_days": people * 7 * weeks,
        "patient_days_s": people * 7 * weeks / seconds,
        "memory_MB": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0,
        "disk_kB": written / 1000.0,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", action="store_true", help="plain data on standard output")
    parser.add_argument("--small", action="store_true", help="only 1 and 5 weeks of 64 people")
    parser.add_argument("--controller", default="mpc")
    parser.add_argument("--patient-days", type=int, default=100_000, help="patient-days of each length, about")
    parser.add_argument("--weeks", type=int, help="only this length, in this process")
    asked = parser.parse_args()
    if asked.weeks is not None:
        print(json.dumps(measured(asked.weeks, asked.patient_days, asked.controller)))
        return
    patient_days = 0 if asked.small else asked.patient_days
    result = []
    for weeks in (1, 5) if asked.small else WEEKS:
        of_weeks = ("--weeks", str(weeks), "--patient-days", str(patient_days), "--controller", asked.controller)
        told = subprocess.run([sys.executable, __file__, *of_weeks], stdout=subprocess.PIPE, text=True, check=True)
        result.append(json.loads(told.stdout))
    cores = os.cpu_count() or 1
    hours = RECORD_PATIENT_DAYS / result[-1]["patient_days_s"] / cores / 3600.0
    if asked.json:
        print(json.dumps({"controller": asked.controller, "lengths": result, "cores": cores, "record_h": hours}))
        return
    print(f"{'Weeks':>6}{'People':>9}{'Patient-days/s':>16}{'Beside the first':>18}{'Memory, MB':>12}{'Disk, kB':>10}")
    for one in result:
        beside = one["patient_days_s"] / result[0]["patient_days_s"]
        rates = f"{one['patient_days_s']:16.0f}{beside:18.2f}"
        print(f"{one['weeks']:6}{one['people']:9}{rates}{one['memory_MB']:12.0f}{one['disk_kB']:10.0f}")
    print(f"A million people for 52 weeks, at the last rate, on {cores} idle cores: {hours:.2f} h")


if __name__ == "__main__":
    main()
