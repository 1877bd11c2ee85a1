"""Stress test: controllers, with and without a guard, on the same people under one fault after another.

It is a trial whose cases are all controllers under all faults. Each person has the same meals, noise and onset of a
fault under each controller.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Final

from glucoloop.config.key import Key
from glucoloop.config.options.situation import KINDS_OF_FAULTS
from glucoloop.studies.options import PAPER_CONTROLLERS, PAPER_MEAL, GuardsKey
from glucoloop.studies.study import TrialStudy


@dataclass(frozen=True, kw_only=True)
class StressSettings:
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


STRESS: Final = TrialStudy(
    name="stress",
    what="a stress test",
    help=(
        "Test controllers under faults of sensor and pump, one fault at a time, with and without a guard; the results "
        "are a table and a page.\n\n"
        "The same people, with the same meals and noise, are simulated with each fault and without it. By default "
        "these are 100 people whose metabolism varies as in Parker et al. (2000), with 50 g at 50 min, noise of "
        "variance 1.45, 23 faults and the paper's four controllers. The folder is written in parts; after Ctrl-C, the "
        "same command continues where it stopped.\n\n"
        "  glucoloop stress --out stress\n\n"
        "  glucoloop stress --controller mpc --people 1000 --fault 'stuck, start_min=60, duration_min=90' --out stuck"
        "\n\n"
        "  glucoloop stress --config stress/stress.toml --out again"
    ),
    module="glucoloop.studies.stress.study",
    settings=(StressSettings,),
    refused=("traces", "guard", "metrics"),
    usual={
        "people": 100,
        "duration_min": 600.0,
        "meals": PAPER_MEAL,
        "noise_variance": 1.45,
        "controllers": list(PAPER_CONTROLLERS),
    },
    files=("stress.csv", "stress.parquet", "stress.html", "figure.pdf", "figure.png", "figure.svg"),
)
