"""Result of one check of an exported controller, and how a tool is run on its files."""

from __future__ import annotations

import subprocess
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

_LONGEST_S: Final = 600.0
OUTCOMES: Final = {True: "held", False: "did not hold", None: "not run"}
"""Outcome of a check in words."""


@dataclass(frozen=True)
class Rung:
    """One check of the ladder."""

    check: str
    holds: bool | None
    """Whether the check passed, or None if it was not run."""
    finding: str
    measured: Mapping[str, Any]

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {"check": self.check, "holds": self.holds, "found": self.finding, **self.measured}


def ran(command: list[str], folder: Path) -> tuple[int, str]:
    """Exit code of a command, 124 after ten minutes, and what it printed."""
    try:
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False, timeout=_LONGEST_S)
    except subprocess.TimeoutExpired:
        return 124, f"no answer in {_LONGEST_S:g} s"
    return done.returncode, f"{done.stdout}{done.stderr}"
