#!/usr/bin/env python3
"""Time the way from nothing to a first figure, and weigh what is installed on it.

    python benchmarks/installed.py [--wheel FILE] [--python PYTHON] [--no-cache]

In an empty folder: an environment of that Python, ``pip install`` of the wheel (by default one that is built here) with
the newest release of every package, and ``glucoloop run --out first-run``; wall time and time of processors of each.
Then the size of every installed package, and which of them each command imported.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
COMMANDS = {
    "run": ("run", "--out", "a-run"),
    "compare": ("compare", "--controller", "pid", "--controller", "mpc"),
    "trial": ("trial", "--people", "4", "--out", "a-trial"),
}
TABLE_FROM_MB = 20.0
"""Smaller packages are one line of the table."""

# A module that lazy-loader has only promised is not imported.
WATCHED = """
import importlib.util, json, sys
from glucoloop.cli import program
try:
    code = program()
except SystemExit as left:
    code = left.code
names = [name for name, module in list(sys.modules.items()) if not isinstance(module, importlib.util._LazyModule)]
json.dump({"code": code or 0, "modules": sorted({name.partition(".")[0] for name in names})}, open(IMPORTED, "w"))
"""

SIZES = """
import importlib.metadata, json
sizes, modules = {}, {}
for name, distributions in importlib.metadata.packages_distributions().items():
    for distribution in distributions:
        modules.setdefault(distribution, []).append(name)
found = []
for distribution in importlib.metadata.distributions():
    name = distribution.metadata["Name"]
    size = sum(path.stat().st_size for path in map(lambda f: f.locate(), distribution.files or ()) if path.is_file())
    found.append({"name": name, "version": distribution.version, "size": size, "modules": modules.get(name, [])})
print(json.dumps(found))
"""


def timed(command: Sequence[str | Path], folder: Path) -> dict[str, float]:
    before, started = resource.getrusage(resource.RUSAGE_CHILDREN), time.monotonic()
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    wall, after = time.monotonic() - started, resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode != 0:
        sys.exit(f"{' '.join(map(str, command))} failed:\n{done.stdout}{done.stderr}")
    spent = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return {"wall_s": round(wall, 1), "processor_s": round(spent, 1)}


def imported(python: Path, folder: Path, words: Sequence[str]) -> set[str]:
    """Top-level modules that one command imported."""
    told = folder / "imported.json"
    script = WATCHED.replace("IMPORTED", repr(str(told)))
    subprocess.run([python, "-c", script, *words], cwd=folder, capture_output=True, check=False)
    answer = json.loads(told.read_text(encoding="utf-8"))
    if answer["code"] != 0:
        sys.exit(f"glucoloop {' '.join(words)} failed with exit code {answer['code']}.")
    told.unlink()
    return set(answer["modules"])


def measured(wheel: Path | None, python: str, *, cache: bool) -> dict[str, Any]:
    with tempfile.TemporaryDirectory(prefix="glucoloop-installed-") as place:
        folder = Path(place)
        if wheel is None:
            build = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)]
            subprocess.run(build, cwd=ROOT, check=True, capture_output=True)
            [wheel] = folder.glob("*.whl")
        load = os.getloadavg()[0]
        programs = folder / "environment" / "bin"
        pip = [programs / "python", "-m", "pip", "install", "--quiet", *([] if cache else ["--no-cache-dir"])]
        times = {
            "environment": timed([python, "-m", "venv", folder / "environment"], folder),
            "pip install": timed([*pip, wheel.resolve()], folder),
            "first run": timed([programs / "glucoloop", "run", "--out", "first-run"], folder),
            "second run": timed([programs / "glucoloop", "run", "--out", "second-run"], folder),
        }
        if not (folder / "first-run" / "figure.png").is_file():
            sys.exit("The first run left no figure.")
        asked = subprocess.run([programs / "python", "-c", SIZES], capture_output=True, text=True, check=True)
        packages = json.loads(asked.stdout)
        uses = {name: imported(programs / "python", folder, words) for name, words in COMMANDS.items()}
        version = subprocess.run(
            [programs / "python", "-V"], capture_output=True, text=True, check=True
        ).stdout.split()[1]
    for package in packages:
        package["imported_by"] = [name for name, modules in uses.items() if modules & set(package["modules"])]
    return {"python": version, "load": load, "times": times, "packages": packages}


def table(result: dict[str, Any]) -> list[str]:
    """Lines of Markdown: what is large, and the rest together."""
    packages = sorted(result["packages"], key=lambda package: -package["size"])
    large = [package for package in packages if package["size"] >= TABLE_FROM_MB * 1e6]
    small = packages[len(large) :]
    rows = [
        (f"{p['name']} {p['version']}", p["size"], ", ".join(f"`{name}`" for name in p["imported_by"])) for p in large
    ]
    rows.append((f"{len(small)} others", sum(package["size"] for package in small), ""))
    rows.append((f"all {len(packages)}", sum(package["size"] for package in packages), ""))
    lines = ["| Package | MB | Imported by |", "| :--- | ---: | :--- |"]
    return lines + [f"| {name} | {size / 1e6:.0f} | {users} |" for name, size, users in rows]


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--wheel", type=Path, help="wheel to install; without it, one is built of this tree")
    parser.add_argument("--python", default=sys.executable, help="interpreter of the new environment")
    parser.add_argument("--no-cache", action="store_true", help="download every package again")
    options = parser.parse_args()
    result = measured(options.wheel, options.python, cache=not options.no_cache)
    print(
        f"Python {result['python']} on {platform.system()} {platform.machine()}, {os.cpu_count()} processors, "
        f"load {result['load']:.1f} before\n\n{'':14}{'wall, s':>9}{'processors, s':>15}"
    )
    for name, spent in result["times"].items():
        print(f"{name:14}{spent['wall_s']:9.1f}{spent['processor_s']:15.1f}")
    print("", *table(result), sep="\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
