"""Measure memory and processor time of long runs of one person, as the command line computes them.

    python benchmarks/long_runs.py [--json] [--small] [--days N ...] [--only TEXT]

Each line is a command in a process of its own, for 14, 40, 120 and 366 days of three meals a day: the most memory that
it had, by the operating system, and its processor time, both with all imports and all compiling. Memory that grew with
the square of the days would show as a rise of nine times from one column to the next. The last lines find a twin in a
record of so many days of a simulated person, at most 90, and simulate the days of the record again on it; for these the
folder ``tests/shared`` is needed, which makes such records.

``--small`` takes 2 and 4 days of the first command, and shows that all this works.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

DAYS = (14, 40, 120, 366)
COMMANDS = (
    ("run", "--patient", "parker-1999", "--controller", "pid"),
    ("run", "--patient", "parker-1999", "--controller", "mpc", "--noise", "1.45", "--guard"),
    ("run", "--patient", "parker-1999", "--controller", "mpc-se"),
    ("run", "--patient", "parker-1999", "--controller", "meal-mpc"),
    ("run", "--patient", "parker-1999", "--controller", "pid", "--meal-model", "lehmann-deutsch"),
    ("run", "--patient", "hovorka-2004", "--controller", "basal-bolus", "--announce-meals"),
    ("run", "--patient", "wilinska-2010", "--controller", "profile-mpc", "--announce-meals"),
    ("run", "--patient", "uva-padova-2008", "--controller", "pid"),
    ("run", "--patient", "kanderian-2009", "--controller", "pid"),
    ("run", "--patient", "roy-parker-2007", "--controller", "pid"),
    ("run", "--patient", "mcgill-2020", "--controller", "pid"),
    ("trial", "--people", "2", "--patient", "parker-1999", "--controller", "pid"),
    ("trial", "--people", "2", "--patient", "hovorka-2004", "--controller", "profile-mpc", "--announce-meals"),
)


TWIN = ("twin", "--patient", "hovorka-2004")
REPLAY = ("replay", "--controller", "basal-bolus", "--draws", "20")
LONGEST_RECORD_DAYS = 90
_RECORD = """
import sys
from lived_records import lived
record, _ = lived("hovorka-2004", "boiroux2017", 1000, days=int(sys.argv[1]))
open(sys.argv[2], "wb").write(record.parquet())
"""


def measured(command: tuple[str, ...], days: int) -> dict[str, Any]:
    """Memory [MiB] and processor time [s] of a command for so many days of three meals."""
    with tempfile.TemporaryDirectory() as place:
        return of_process(*command, "--scenario", f"week, days={days}", "--out", str(Path(place) / "out"), days=days)


def measured_with_a_twin(days: int) -> list[dict[str, Any]]:
    """The same of a twin that is found in a record of so many days, and of their replay."""
    with tempfile.TemporaryDirectory() as place:
        record, twin = str(Path(place) / "record.parquet"), str(Path(place) / "twin")
        shared = {"PYTHONPATH": os.pathsep.join([str(Path(__file__).parents[1] / "tests" / "shared"), *sys.path])}
        subprocess.run([sys.executable, "-c", _RECORD, str(days), record], env={**os.environ, **shared}, check=True)
        length = ("--days", str(days))
        return [
            of_process(*TWIN, record, *length, "--out", twin, days=days),
            of_process(*REPLAY, record, *length, "--twin", twin, "--out", str(Path(place) / "out"), days=days),
        ]


def of_process(*command: str, days: int) -> dict[str, Any]:
    """The same of a command of glucoloop; processes that it starts count in its time, and the largest one in memory."""
    process = subprocess.Popen(
        [sys.executable, "-m", "glucoloop", *command], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
    )
    assert process.stderr is not None
    message = process.stderr.read()
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise SystemExit(f"{' '.join(command)} for {days} days ended with {process.returncode}: {message[-500:]}")
    kib = usage.ru_maxrss if sys.platform != "darwin" else usage.ru_maxrss / 1024.0
    return {"days": days, "memory_MiB": kib / 1024.0, "seconds": usage.ru_utime + usage.ru_stime}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", action="store_true", help="plain data on standard output")
    parser.add_argument("--small", action="store_true", help="only 2 and 4 days of the first command")
    parser.add_argument(
        "--days", type=int, nargs="+", default=DAYS, help="lengths in place of 14, 40, 120 and 366 days"
    )
    parser.add_argument("--only", default="", help="only the commands that have this text in them")
    arguments = parser.parse_args()
    days = (2, 4) if arguments.small else arguments.days
    if not arguments.json:
        print(f"{'Memory, MiB / processor time, s':96}" + "".join(f"{f'{n} d':>14}" for n in days), flush=True)
    results = []

    def add(command: tuple[str, ...], lengths: list[dict[str, Any]]) -> None:
        results.append({"command": " ".join(command), "lengths": lengths})
        if not arguments.json:
            cells = (f"{each['memory_MiB']:.0f} / {each['seconds']:.0f}" for each in lengths)
            print(f"{' '.join(command):96}" + "".join(f"{cell:>14}" for cell in cells), flush=True)

    chosen = [command for command in COMMANDS if arguments.only in " ".join(command)]
    for command in chosen[:1] if arguments.small else chosen:
        add(command, [measured(command, n) for n in days])
    if not arguments.small and any(arguments.only in " ".join(command) for command in (TWIN, REPLAY)):
        pairs = [measured_with_a_twin(min(n, LONGEST_RECORD_DAYS)) for n in days]
        for command, lengths in zip((TWIN, REPLAY), zip(*pairs, strict=True), strict=True):
            add(command, list(lengths))
    if arguments.json:
        print(json.dumps(results))


if __name__ == "__main__":
    main()
