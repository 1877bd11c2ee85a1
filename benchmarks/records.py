"""Reading of a record, beside Polars that reads the same CSV as bare texts, and whole commands of ``glucoloop report``.

python benchmarks/records.py                       a million readings in the shape of Dexcom Clarity
python benchmarks/records.py --readings 100000
python benchmarks/records.py --people 1000         the report of a folder of people too, 14 days each
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
from datetime import timedelta
from pathlib import Path

import polars as pl

import glucoloop as gl

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "shared"))

from device_files import START, clarity

REPEATS = 3
FORTNIGHT = 14 * 288
"""Readings of a person."""


def processor_time(work) -> float:
    """Minimum time of all processors over a few repeats [s], which other programs on the machine hardly change."""
    times = []
    for _ in range(REPEATS):
        begun = time.process_time()
        work()
        times.append(time.process_time() - begun)
    return min(times)


def report_s(compiled: Path, *arguments: object) -> tuple[float, float]:
    """Time on the wall and of all processors [s] of ``glucoloop report`` in a process of its own.

    Modules that a run compiled lie in a folder for the next ones, as they do where the program is installed.
    """
    command = [sys.executable, "-m", "glucoloop", "report", *map(str, arguments)]
    environment = {**os.environ, "PYTHONPYCACHEPREFIX": str(compiled)}
    environment.pop("PYTHONDONTWRITEBYTECODE", None)
    before, begun = resource.getrusage(resource.RUSAGE_CHILDREN), time.monotonic()
    subprocess.run(command, check=True, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    wall, after = time.monotonic() - begun, resource.getrusage(resource.RUSAGE_CHILDREN)
    return wall, after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--readings", type=int, default=1_000_000)
    parser.add_argument("--people", type=int, default=0)
    parser.add_argument("--json", action="store_true")
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "clarity.csv"
        path.write_text(clarity(asked.readings))
        bare = processor_time(lambda: pl.read_csv(path, infer_schema=False))
        whole = processor_time(lambda: gl.read_record(path))
        compiled = Path(folder) / "compiled"
        runs = [report_s(compiled, path, "--out", Path(folder) / f"report-{run}") for run in range(REPEATS)]
        reports = {f"{asked.readings} readings": min(runs)}
        if asked.people:
            group = Path(folder) / "people"
            group.mkdir()
            for person in range(asked.people):
                (group / f"{person}.csv").write_text(clarity(FORTNIGHT, START + timedelta(minutes=person)))
            reports[f"{asked.people} people"] = report_s(compiled, group, "--out", Path(folder) / "group")
    if asked.json:
        print(json.dumps({"readings": asked.readings, "seconds": whole, "bare_csv_seconds": bare, "report": reports}))
        return
    print(f"{asked.readings} readings: {whole:.2f} s of processor time, {whole / bare:.1f} times that of a bare CSV.")
    for what, (wall, processors) in reports.items():
        print(f"Report of {what}: {wall:.1f} s on the wall, {processors:.1f} s of processor time.")


if __name__ == "__main__":
    main()
