"""Reading of a record: time of `gl.read_record` beside that in which Polars reads the same CSV as bare texts.

python benchmarks/records.py                       a million readings in the shape of Dexcom Clarity
python benchmarks/records.py --readings 100000
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from pathlib import Path

import polars as pl

import glucoloop as gl

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "shared"))

from device_files import clarity

REPEATS = 3


def processor_time(work) -> float:
    """Least time of all processors over a few repeats [s], which other programs on the machine hardly change."""
    times = []
    for _ in range(REPEATS):
        begun = time.process_time()
        work()
        times.append(time.process_time() - begun)
    return min(times)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--readings", type=int, default=1_000_000)
    parser.add_argument("--json", action="store_true")
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "clarity.csv"
        path.write_text(clarity(asked.readings))
        bare = processor_time(lambda: pl.read_csv(path, infer_schema=False))
        whole = processor_time(lambda: gl.read_record(path))
    if asked.json:
        print(json.dumps({"readings": asked.readings, "seconds": whole, "bare_csv_seconds": bare}))
        return
    print(f"{asked.readings} readings: {whole:.2f} s of processor time, {whole / bare:.1f} times that of a bare CSV.")


if __name__ == "__main__":
    main()
