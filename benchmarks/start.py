#!/usr/bin/env python3
"""Measure the start of commands in new processes, with nothing kept and with all that an earlier one kept.

    python benchmarks/start.py [--repeats N] [--beside FOLDER]

Processor seconds of whole commands, and in parentheses in those of ``import jax`` in a new process; the minimum of the
repeats counts, and they take turns, so that what else runs on the machine disturbs less. `--beside` names the ``src``
of another version, which is measured in the same run.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
from pathlib import Path

COMMANDS = {
    "run": ["run", "--out", "run", "--overwrite"],
    "trial of one person": ["trial", "--people", "1", "--out", "trial", "--overwrite"],
}


def processor_s(words: list[str], folder: Path, **environment: str) -> float:
    """Processor seconds of Python with the given words."""
    before = os.times()
    told = {"cwd": folder, "env": {**os.environ, **environment}, "capture_output": True, "text": True}
    done = subprocess.run([sys.executable, *words], check=False, **told)
    after = os.times()
    if done.returncode:
        sys.exit(f"{' '.join(words)} failed:\n{done.stdout}{done.stderr}")
    return after.children_user + after.children_system - before.children_user - before.children_system


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--beside", type=Path, help="folder src of another version")
    asked = parser.parse_args()
    here = Path(__file__).resolve().parents[1] / "src"
    sources = {"here": here, **({"beside": asked.beside.resolve()} if asked.beside else {})}
    if sys.dont_write_bytecode:
        print("PYTHONDONTWRITEBYTECODE is set: each process compiles Python's own modules again.")
    with tempfile.TemporaryDirectory(prefix="glucoloop-start-") as place:
        folder = Path(place)
        jax_s = min(processor_s(["-c", "import jax"], folder) for _ in range(asked.repeats + 1))
        print(f"import jax: {jax_s:.2f} s")
        for name, words in COMMANDS.items():
            command, result = ["-m", "glucoloop", *words], dict[str, list[float]]()
            for _ in range(asked.repeats + 1):
                for version, source in sources.items():
                    kept = {"PYTHONPATH": str(source), "GLUCOLOOP_CACHE_DIR": str(folder / f"{name}-{version}")}
                    result.setdefault(version, []).append(processor_s(command, folder, **kept))
            for version, (first, *others) in result.items():
                best = min(others)
                print(f"{name}, {version}: first {first:.1f} s, then {best:.2f} s ({best / jax_s:.1f})", flush=True)


if __name__ == "__main__":
    main()
