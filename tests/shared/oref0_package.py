"""The npm package oref0 as truth: calls of its functions, answered by one process of node."""

import json
import os
import subprocess
from pathlib import Path

import jax
import pytest

from browser import NODE

_FOLDER = Path(__file__).parents[1] / "npm"
_INSTALLED = _FOLDER / "node_modules"
MODULES = os.environ.get("GLUCOLOOP_OREF0_MODULES") or (str(_INSTALLED) if _INSTALLED.is_dir() else None)

needs_oref0 = pytest.mark.skipif(
    not (NODE and MODULES), reason="needs node and the package oref0 of npm: `npm ci --prefix tests/npm`"
)


def answers_of(asked, calls):
    """Answers of oref0 to calls of one of its functions, in the order of the calls."""
    lines = "".join(json.dumps([asked, call]) + "\n" for call in calls)
    command = [NODE, str(_FOLDER / "oref0.cjs"), MODULES]
    done = subprocess.run(command, input=lines, capture_output=True, text=True, timeout=550, check=False)
    assert done.returncode == 0, done.stderr
    return [json.loads(line) for line in done.stdout.splitlines()]


def as_written(function):
    """A function in which XLA makes no product of a quotient, so that numbers are rounded as in JavaScript."""
    return jax.jit(function, compiler_options={"xla_disable_hlo_passes": "algsimp"})
