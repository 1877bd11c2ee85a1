#!/usr/bin/env python3
"""Measure what a person at the desk waits for: processor time of new processes, in those of ``import jax``.

    python benchmarks/desk.py [--repeats N] [--beside FOLDER] [--only WORD]

Each line is carried out `--cold` times with nothing kept and then `--repeats` times with all that an earlier one kept.
Printed are medians, and in parentheses those in times of ``import jax`` in the same run. Versions take turns, so that
what else runs on the machine disturbs both; `--beside` names the ``src`` of another one.
"""

from __future__ import annotations

import argparse
import os
import statistics
import tempfile
from pathlib import Path

from start import processor_s

PYTHON = """
import matplotlib
matplotlib.use("Agg")
import glucoloop as gl
patient = gl.patient()
model = gl.identify(patient).model
controller = gl.design_linear_mpc(model)
trace = gl.simulate(patient, controller)
metrics = gl.summarise(trace)
gl.plot(trace).savefig("loop.png")
"""
GYMNASIUM = """
import gymnasium
import glucoloop.gym
env = gymnasium.make(glucoloop.gym.ENVIRONMENT)
env.reset(seed=0)
"""
GLUCOLOOP = ["-m", "glucoloop"]
LINES = {
    "README's lines": ["-c", PYTHON],
    "Gymnasium": ["-c", GYMNASIUM],
    "run --json": [*GLUCOLOOP, "run", "--json"],
    "compare of three": [
        *GLUCOLOOP,
        "compare",
        *(w for c in ("mpc", "pid", "basal-bolus") for w in ("--controller", c)),
    ],
    "trial --people 1": [*GLUCOLOOP, "trial", "--people", "1", "--out", "trial", "--overwrite"],
    "export": [*GLUCOLOOP, "export", "--out", "export", "--overwrite"],
    "--help": [*GLUCOLOOP, "--help"],
}


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--cold", type=int, default=1, help="processes with nothing kept")
    parser.add_argument("--beside", type=Path, help="folder src of another version")
    parser.add_argument("--only", default="", help="lines that have this word")
    asked = parser.parse_args()
    here = Path(__file__).resolve().parents[1] / "src"
    sources = {"here": here, **({"beside": asked.beside.resolve()} if asked.beside else {})}
    with tempfile.TemporaryDirectory(prefix="glucoloop-desk-") as place:
        folder = Path(place)
        # Python's own modules are compiled once, as on a machine that has run before
        os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
        os.environ["PYTHONPYCACHEPREFIX"] = str(folder / "bytecode")
        processor_s(["-c", PYTHON], folder, PYTHONPATH=str(here), GLUCOLOOP_CACHE_DIR="off")
        for name, words in LINES.items():
            if asked.only not in name:
                continue
            jax_s, spent = list[float](), dict[tuple[str, str], list[float]]()
            for repeat in range(asked.cold + asked.repeats):
                jax_s.append(processor_s(["-c", "import jax"], folder))
                for version, source in sources.items():
                    cold = repeat < asked.cold
                    kept = folder / f"kept-{version}-{repeat if cold else asked.cold - 1}" / name.replace(" ", "-")
                    kept.parent.mkdir(exist_ok=True)
                    told = {"PYTHONPATH": str(source), "GLUCOLOOP_CACHE_DIR": str(kept)}
                    spent.setdefault((version, "cold" if cold else "warm"), []).append(
                        processor_s(words, folder, **told)
                    )
            one = statistics.median(jax_s)
            for (version, state), times in spent.items():
                middle = statistics.median(times)
                print(f"{name}, {version}, {state}: {middle:.2f} s ({middle / one:.1f} of {one:.2f} s)", flush=True)


if __name__ == "__main__":
    main()
