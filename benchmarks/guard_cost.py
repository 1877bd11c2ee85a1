"""Measure what a guard costs and buys with subcutaneous insulin: the same people with it and without.

    python benchmarks/guard_cost.py [--json] [--people N] [--seed N] [--case NAME ...] [--controller TEXT ...]

People, meals, sensors and profiles are those of `subcutaneous`. `reckless` always asks for ten times the basal rate,
and `basal` for the basal rate: no controller with a guard should be worse than that. The settings of the guard were
chosen on people of seeds 11 and 12; none has seen those of seeds 31 and 47.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import subcutaneous

from glucoloop._pytree import pytree, static
from glucoloop.control import Decision, Observation
from glucoloop.control.decision import decide, is_known
from glucoloop.control.design_case import DesignCase
from glucoloop.control.part import ControllerComponent
from glucoloop.pumps import DoseLimits

TIMES = 10.0
CONTROLLERS = (*subcutaneous.EXPECTING_A_MONITOR, "basal-bolus", "pid", "guard_cost:Reckless", "basal")
CASES = [case for case in subcutaneous.CASES if case.endswith("white")]
REPORTED = (*subcutaneous.REPORTED, "ever_below_54_pct")


@pytree
class Asking:
    """Asks for a multiple of the basal rate, whatever it reads."""

    basal_mU_min: Any
    limits: DoseLimits
    sample_time_min: float = static()

    def with_basal(self, insulin_mU_min: jax.Array) -> Asking:
        """The same for a person with the given basal rate."""
        return dataclasses.replace(self, basal_mU_min=insulin_mU_min)

    def init(self, observation: Observation) -> jax.Array:
        """The rate."""
        return jnp.broadcast_to(TIMES * jnp.asarray(self.basal_mU_min), observation.glucose_mg_dl.shape)

    def step(self, state: jax.Array, observation: Observation) -> tuple[jax.Array, Decision]:
        """Ask for it, within the limits of the pump."""
        return state, decide(state, observation.delivered_mU_min, self.limits, is_known(observation))


class Reckless(ControllerComponent, name="reckless"):
    """Ten times the basal rate, always."""

    uses_model: ClassVar = False

    def designed(self, case: DesignCase) -> Asking:
        """For the nominal patient."""
        return Asking(basal_mU_min=case.basal_insulin_mU_min, limits=case.limits, sample_time_min=case.sample_time_min)


def pair(case: str, people: int, seeds: list[int], text: str) -> list[dict[str, Any]]:
    """Figures of a controller without the guard and with it, for people of each seed."""
    asked = text + (subcutaneous.TUNED[case.split(", ")[2]] if text in subcutaneous.EXPECTING_A_MONITOR else "")
    rows = []
    for guard in ("none", "usual"):
        for row in subcutaneous.measured(case, people, seeds, f"{asked}, guard={guard}"):
            kept = {name: row[name] for name in ("case", "seed", "people", *REPORTED)}
            rows.append({**kept, "controller": text.rpartition(":")[2].lower(), "guarded": guard == "usual"})
    return rows


def lines(rows: list[dict[str, Any]]) -> list[str]:
    """Lines of the table: a seed in each, without the guard → with it."""
    bare, guarded = ([row for row in rows if row["guarded"] is told] for told in (False, True))
    result = []
    for one, other in zip(bare, guarded, strict=True):
        shown = [f"{one[name]:.1f} → {other[name]:.1f}" for name in REPORTED]
        named = [one["case"], one["controller"], one["seed"], one["people"], *shown]
        result.append("| " + " | ".join(map(str, named)) + " |")
    return result


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", action="store_true", help="print the figures as JSON")
    parser.add_argument("--people", type=int, default=300)
    parser.add_argument("--seed", type=int, action="append", help="a seed; give it once for each; by default 31")
    parser.add_argument("--case", action="append", metavar="NAME", help="a case, or the beginning of its name")
    parser.add_argument("--controller", action="append", metavar="TEXT", help=f"by default {', '.join(CONTROLLERS)}")
    asked = parser.parse_args()
    if not asked.json:
        print("| case | controller | seed | people | 70-180, % | < 70, % | < 54, % | ever < 54, % |")
        print("| :--- | :--- |" + 6 * " ---: |")
    rows: list[dict[str, Any]] = []
    for case in subcutaneous.CASES if asked.case else CASES:
        if not any(case.startswith(wanted) for wanted in asked.case or [""]):
            continue
        for text in asked.controller or CONTROLLERS:
            rows += pair(case, asked.people, asked.seed or [31], text)
            if not asked.json:
                print("\n".join(lines(rows[-2 * len(asked.seed or [31]) :])), flush=True)
    if asked.json:
        print(json.dumps(rows, indent=2))


if __name__ == "__main__":
    main()
