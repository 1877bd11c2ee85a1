"""Keys of a stress test, and its usual trial."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Final

from glucoloop.config.key import Key
from glucoloop.config.options.situation import KINDS_OF_FAULTS
from glucoloop.studies.options import PAPER_CONTROLLERS, PAPER_MEAL, GuardsKey

USUAL: Final[Mapping[str, Any]] = {
    "people": 100,
    "duration_min": 600.0,
    "meals": PAPER_MEAL,
    "noise_variance": 1.45,
    "controllers": list(PAPER_CONTROLLERS),
}
"""Usual keys of the trial, where they differ from those of a trial."""
REFUSED: Final = ("traces", "guard", "metrics")
"""Keys of a trial that the test does not have."""


@dataclass(frozen=True, kw_only=True)
class StressKeys:
    """Keys of a stress test that a trial does not have, or that have another meaning here."""

    faults: Annotated[
        tuple[str, ...] | None,
        Key(
            f"A fault that is tried alone, in place of the usual ones; repeat it for more. {KINDS_OF_FAULTS}",
            panel="Faults",
            flag="--fault",
            metavar="FAULT",
        ),
    ] = None
    guards: GuardsKey = "both"
