#!/usr/bin/env python3
"""Time the whole reproduction of Parker, Doyle and Peppas (1999): both operating points, every seed.

    python benchmarks/reproduction.py [--seeds 60] [--json]

Two new processes, the first with an empty and the second with a filled compilation cache; their ratio is what compiling
costs.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any


def reproduce(cache: Path, out: Path, seeds: int) -> dict[str, Any]:
    """One run in a process of its own."""
    command = [sys.executable, "-m", "glucoloop", "reproduce", "parker1999"]
    start = time.perf_counter()
    done = subprocess.run(
        [*command, "--seeds", str(seeds), "--out", str(out), "--json"],
        env={**os.environ, "GLUCOLOOP_CACHE_DIR": str(cache)},
        capture_output=True,
        text=True,
        check=False,
    )
    seconds = time.perf_counter() - start
    if done.returncode != 0:
        sys.exit(f"the reproduction failed:\n{done.stderr}")
    entries = json.loads(done.stdout)["entries"]
    agreeing = {
        point: sum(entry["reproduced"].get(point, {}).get("agrees") is True for entry in entries)
        for point in ("setpoint-81", "nominal-22")
    }
    return {"seconds": seconds, "entries": len(entries), "agreeing": agreeing}


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=60, help="runs of each noisy experiment")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        cache = Path(scratch, "cache")
        cold = reproduce(cache, Path(scratch, "cold"), arguments.seeds)
        warm = reproduce(cache, Path(scratch, "warm"), arguments.seeds)
    figures = {
        "seeds": arguments.seeds,
        "cores": os.cpu_count(),
        "cold_s": cold["seconds"],
        "warm_s": warm["seconds"],
        "cold_by_warm": cold["seconds"] / warm["seconds"],
        "agreeing": warm["agreeing"],
        "entries": warm["entries"],
    }
    if arguments.json:
        print(json.dumps(figures, indent=2))
        return
    print(f"whole reproduction, {arguments.seeds} seeds, both operating points, {os.cpu_count()} cores")
    print(f"  cold  {figures['cold_s']:7.1f} s   empty compilation cache")
    print(f"  warm  {figures['warm_s']:7.1f} s   filled; cold takes {figures['cold_by_warm']:.2f} times as long")
    for point, count in figures["agreeing"].items():
        print(f"  {point}: {count} of {figures['entries']} printed entries reproduce")


if __name__ == "__main__":
    main()
