"""Computation of requested bounds."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import polars as pl

from glucoloop.bounds import IN_ADVANCE, HedgedDoses, OptimalDoses, bound_of_situation, hedged_doses, optimal_doses
from glucoloop.config.bound import bound_keys
from glucoloop.config.options.bound import BoundKeys
from glucoloop.config.options.situation import SituationKeys
from glucoloop.patients.capabilities import lowest_valid_glucose_mg_dl
from glucoloop.pumps import DoseLimits
from glucoloop.report.validity import validity_told

_ARRAYS = ("t_min", "insulin_mU_min", "fine_t_min", "glucose_mg_dl")
_BEGINS = "told from noise that it begins"
_ENDS = "told from noise that it ends"


@dataclass(frozen=True)
class Bounded:
    """Plans by the knowledge of the meals, and plans under sensor noise."""

    config: BoundKeys
    plans: dict[str, OptimalDoses]
    hedged: dict[str, HedgedDoses]
    limits: DoseLimits

    def report(self) -> dict[str, Any]:
        """Plain values for JSON, which knows neither NaN nor infinity."""
        plans = []
        for label, plan in self.plans.items():
            told = {key: value for key, value in dataclasses.asdict(plan).items() if key not in _ARRAYS}
            plans.append({"information": label, **{key: _plain(value) for key, value in told.items()}})
        hedged = [
            {
                "information": label,
                "error": of.error,
                "told_after_min": _plain(of.told_after_min),
                "deviation_mg_dl": of.deviation_mg_dl,
                "undershoot_mg_dl": of.meal.undershoot_mg_dl,
                "peak_mg_dl": of.meal.peak_mg_dl,
                "other_undershoot_mg_dl": of.other.undershoot_mg_dl,
                "other_peak_mg_dl": of.other.peak_mg_dl,
                "converged": of.converged,
                "iterations": of.meal.iterations,
                "optimality": of.meal.optimality,
            }
            for label, of in self.hedged.items()
        ]
        return {"config": bound_keys(self.config), "bounds": plans, "hedged": hedged}

    def notes(self) -> Iterator[str]:
        """Further notes, one sentence each."""
        for label, plan in {**self.plans, **{label: of.meal for label, of in self.hedged.items()}}.items():
            if not plan.converged:
                yield (
                    f"{label}: not converged after {plan.iterations} steps; the objective could fall by about "
                    f"{plan.optimality:.2g} more, so this is not a bound."
                )
        limit = float(lowest_valid_glucose_mg_dl(self.config.situation().nominal))
        for label, plan in self.plans.items():
            not_valid = validity_told(plan.fine_t_min, plan.glucose_mg_dl, limit)
            if not_valid is not None:
                yield f"{label}: {not_valid}"
        if self.config.dead_time_min and self.plans:
            yield f"Readings are {self.config.dead_time_min:g} min late, so each meal is known later by that time."
        if self.config.situation().whom[0].under_the_skin:
            yield (
                "The doses are rates within the pump's limits, without boluses; a controller that gives boluses can do "
                "better."
            )
        if len(self.config.meals) > 1:
            yield (
                "Each meal is known only after it begins; a controller that prepares for a likely meal could do better."
            )
        if self.hedged:
            yield (
                "Told from noise: two worlds, this meal and none, or this meal and one a fifth larger, with the same "
                "doses until they can be told apart with the stated error. The largest deviation is that of "
                "the worse world; undershoot and peak are those of this meal."
            )
        elif self.config.noise_variance > 0.0:
            yield (
                "The bound under sensor noise is left out here: it is computed for one meal, at rest at the setpoint, "
                "and the objective deviation."
            )

    def samples(self) -> pl.DataFrame:
        """Doses of the plans."""
        return _stacked(self._all(), "t_min", "insulin_mU_min")

    def minutes(self) -> pl.DataFrame:
        """Glucose of the plans."""
        return _stacked(self._all(), "fine_t_min", "glucose_mg_dl")

    def _all(self) -> dict[tuple[str, str], OptimalDoses]:
        """All plans by information and world."""
        plans = {(label, "meal"): plan for label, plan in self.plans.items()}
        for label, of in self.hedged.items():
            plans[label, "meal"] = of.meal
            plans[label, "no meal" if of.question == "begins" else "larger meal"] = of.other
        return plans


def _plain(value: Any) -> Any:
    return None if isinstance(value, float) and not np.isfinite(value) else value


def _stacked(plans: dict[tuple[str, str], OptimalDoses], time: str, what: str) -> pl.DataFrame:
    tables = [
        pl.DataFrame({"t_min": getattr(plan, time), what: getattr(plan, what)}).select(
            pl.lit(label).alias("information"), pl.lit(world).alias("world"), pl.all()
        )
        for (label, world), plan in plans.items()
    ]
    return pl.concat(tables)


def information_label(known_after_min: float) -> str:
    """Knowledge of the meals, in words."""
    if known_after_min == IN_ADVANCE:
        return "all known in advance"
    if known_after_min == 0.0:
        return "known from its start"
    return f"known {abs(known_after_min):g} min {'after' if known_after_min > 0.0 else 'before'} its start"


def work_out(asked: BoundKeys, done: Callable[[str], None]) -> Bounded:
    """Compute every plan that was asked for, and those under sensor noise.

    Raises
    ------
    ValueError
        For a situation that is not possible, in one sentence.
    """
    made, scenario = asked.situation(), asked.scenario()
    person, limits = made.nominal, made.limits
    plans = {}
    for known_after_min in dict.fromkeys([*([IN_ADVANCE] if asked.in_advance else []), *asked.known_after_min]):
        label = information_label(known_after_min)
        plans[label] = optimal_doses(
            person,
            scenario,
            limits,
            known_after_min=known_after_min + asked.dead_time_min,
            objective=asked.objective,
            undershoot_weight=asked.undershoot_weight,
            sample_time_min=asked.sample_time_min,
        )
        done(label)
    hedged: dict[str, HedgedDoses] = {}
    if asked.hedged:
        found = hedged_doses(
            person,
            scenario,
            asked.noise_variance,
            limits,
            dead_time_min=asked.dead_time_min,
            sample_time_min=asked.sample_time_min,
        )
        for of in found:
            label = f"{_BEGINS if of.question == 'begins' else _ENDS}, error {of.error:.0%}"
            hedged[label] = of
            done(label)
    return Bounded(config=asked, plans=plans, hedged=hedged, limits=limits)


def bound_of_run(situation: SituationKeys) -> OptimalDoses:
    """The bound for every controller in the situation of a run, whatever its faults and the steps of its pump.

    Raises
    ------
    ValueError
        For a situation that is not possible, or too long for a plan.
    """
    made = situation.situation()
    return bound_of_situation(
        made.nominal,
        situation.scenario(),
        made.limits,
        dead_time_min=situation.dead_time_min,
        sample_time_min=situation.sample_time_min,
    )
