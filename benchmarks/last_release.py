#!/usr/bin/env python3
"""Compare the time and the memory of everyday commands with those of the last release, or of any revision.

    python benchmarks/last_release.py [REVISION] [--rounds N] [--only NAME ...] [--at-most RATIO] [--json]

Without REVISION it is the last tag. Its source is cloned beside this tree, and both are carried out by the same Python
with the same packages, each command in a process of its own, in turns, so that a noisy machine is noisy for both. A
first round fills the caches of both and is not counted. Compared is the time of processors, which what else runs on the
machine disturbs less than the wall; a ratio is that of one round, new to old, of which median, minimum and maximum are
printed. With ``--at-most 1.1`` the exit code is 1 if a median is greater.
"""

from __future__ import annotations

import argparse
import json
import os
import shlex
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
COMMANDS = {
    "start": "list mpc",
    "run": "run --out OUT",
    "compare": "compare --controller pid --controller mpc --noise 1.45 --out OUT",
    "identify": "identify --out OUT",
    "trial": "trial --people 2000 --noise 1.45 --workers 1 --out OUT",
    "stress": "stress --people 4 --controller mpc --fault 'stuck, start_min=60, duration_min=90' --out OUT",
}


@dataclass(frozen=True)
class Spent:
    """What one process took."""

    processor_s: float
    memory_mb: float


@dataclass(frozen=True)
class Side:
    """A source tree, and a folder for its caches and results."""

    name: str
    source: Path
    folder: Path

    def carry_out(self, words: Sequence[str]) -> Spent | str:
        """Time and memory of one command, or the last line of what it said if it failed."""
        with tempfile.TemporaryDirectory(dir=self.folder) as place:
            words = [place + "/out" if word == "OUT" else word for word in words]
            variables = {**os.environ, "PYTHONPATH": str(self.source), "XDG_CACHE_HOME": str(self.folder / "cache")}
            with tempfile.TemporaryFile("w+", encoding="utf-8") as said:
                command = [sys.executable, "-m", "glucoloop", *words]
                running = subprocess.Popen(command, cwd=place, env=variables, stdout=said, stderr=subprocess.STDOUT)
                _, status, used = os.wait4(running.pid, 0)
                running.returncode = os.waitstatus_to_exitcode(status)
                if running.returncode != 0:
                    said.seek(0)
                    return (said.read().strip().splitlines() or ["no message"])[-1]
        return Spent(used.ru_utime + used.ru_stime, used.ru_maxrss / 1024)


def last_tag() -> str:
    asked = ["git", "-C", str(ROOT), "describe", "--tags", "--abbrev=0"]
    done = subprocess.run(asked, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        sys.exit("There is no tag yet; name a revision to compare with, like HEAD~20.")
    return done.stdout.strip()


def source_of(revision: str, folder: Path) -> Path:
    """The source of a revision, in a clone."""
    clone = folder / "clone"
    named = subprocess.run(
        ["git", "-C", str(ROOT), "rev-parse", "--verify", f"{revision}^{{commit}}"], capture_output=True, text=True
    )
    if named.returncode != 0:
        sys.exit(f"There is no revision {revision!r}; name a tag or a commit.")
    subprocess.run(["git", "clone", "--quiet", "--no-checkout", str(ROOT), str(clone)], check=True)
    subprocess.run(["git", "-C", str(clone), "checkout", "--quiet", named.stdout.strip()], check=True)
    return clone / "src"


def compared(old: Side, new: Side, words: Sequence[str], rounds: int) -> dict[str, Any]:
    """Medians of both sides and the ratios of the rounds, or why there are none."""
    result: dict[str, list[Spent]] = {"old": [], "new": []}
    for number in range(rounds + 1):
        order = [("old", old), ("new", new)]
        for key, side in order if number % 2 else reversed(order):
            spent = side.carry_out(words)
            if isinstance(spent, str):
                return {"failed": f"{side.name}: {spent}"}
            if number:
                result[key].append(spent)
    pairs = list(zip(result["old"], result["new"], strict=True))
    return {
        "old_s": statistics.median(one.processor_s for one in result["old"]),
        "new_s": statistics.median(one.processor_s for one in result["new"]),
        "time": sorted(after.processor_s / before.processor_s for before, after in pairs),
        "memory": sorted(after.memory_mb / before.memory_mb for before, after in pairs),
    }


def row(name: str, result: dict[str, Any]) -> str:
    if "failed" in result:
        return f"{name:10}  not compared, for it fails in {result['failed']}"
    time = result["time"]
    return (
        f"{name:10}{result['old_s']:9.2f}{result['new_s']:9.2f}{statistics.median(time):9.2f}"
        f"   {time[0]:.2f} to {time[-1]:.2f}{statistics.median(result['memory']):9.2f}"
    )


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("revision", nargs="?", help="tag or commit; the last tag by default")
    parser.add_argument("--rounds", type=int, default=5, help="rounds that are counted (default: 5)")
    parser.add_argument("--only", nargs="+", choices=COMMANDS, default=list(COMMANDS), help="some of the commands")
    parser.add_argument("--at-most", type=float, help="maximum median ratio of times, new to old")
    parser.add_argument("--json", action="store_true", help="plain data")
    options = parser.parse_args()
    if options.rounds < 1:
        parser.error(f"--rounds is {options.rounds} and must be at least 1.")
    revision = options.revision or last_tag()
    results: dict[str, dict[str, Any]] = {}
    with tempfile.TemporaryDirectory(prefix="glucoloop-last-release-") as place:
        folders = [Path(place) / name for name in ("old", "new")]
        for folder in folders:
            folder.mkdir()
        old = Side(revision, source_of(revision, folders[0]), folders[0])
        new = Side("this tree", ROOT / "src", folders[1])
        if not options.json:
            print(f"{'':10}{revision[:8]:>9}{'here':>9}   new / old, processor    memory")
            print(f"{'':10}{'s':>9}{'s':>9}{'median':>9}   rounds          median")
        for name in options.only:
            results[name] = compared(old, new, shlex.split(COMMANDS[name]), options.rounds)
            if not options.json:
                print(row(name, results[name]), flush=True)
    if options.json:
        print(json.dumps({"revision": revision, "commands": results}, indent=1))
    slower = [
        name
        for name, result in results.items()
        if options.at_most is not None and "time" in result and statistics.median(result["time"]) > options.at_most
    ]
    for name in slower:
        print(f"{name} takes more than {options.at_most:g} of the time of {revision}.", file=sys.stderr)
    return 1 if slower else 0


if __name__ == "__main__":
    sys.exit(main())
