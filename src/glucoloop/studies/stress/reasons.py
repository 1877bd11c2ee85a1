"""Reason why a person was worse off under a fault: the run is repeated, and its salient events described."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Final

import jax
import numpy as np

from glucoloop.cohorts.engine import PreparedTrial, announced_to
from glucoloop.control import Status
from glucoloop.experiments.assemble import close_loop
from glucoloop.experiments.random_keys import keys_of_people
from glucoloop.meals import Meal, Scenario
from glucoloop.meals.plan import draw_meals
from glucoloop.patients.population import of_people, virtual_people
from glucoloop.printable import glucose_text
from glucoloop.simulation import Trace
from glucoloop.simulation.people_plant import varying

LOW_MG_DL: Final = 60.0
_BEFORE_MIN: Final = 90.0
"""Time before a low for which the insulin is examined."""
_BIAS_MG_DL: Final = 4.0
_LESS: Final = 0.05
_ACTS: Final = (
    (Status.READING_REJECTED, "rejected {}", "reading"),
    (Status.FALLBACK_BASAL, "gave the basal rate for {}", "sample"),
    (Status.FALLBACK_REDUCED, "gave a part of it for {}", "sample"),
    (Status.DOSE_LIMITED, "cut {}", "dose"),
    (Status.SUSPENDED, "suspended insulin for {}", "sample"),
)


def reason_of(prepared: PreparedTrial, label: str, person: int) -> str:
    """Description of the run of a person under a case of a trial, in a few sentences."""
    return " ".join(_told(_again(prepared, label, person), prepared.grid.sample_time_min))


def _again(prepared: PreparedTrial, label: str, person: int) -> Trace:
    """Repeated run of one person of a trial, as a full trace."""
    trial, of_case = prepared.trial, prepared.cases[label]
    number = np.array([person], np.int64)
    drawn = virtual_people(trial.population, trial.seed, number, setpoint_mg_dl=prepared.setpoint_mg_dl)
    meals = draw_meals(trial.plan, trial.seed, number)
    counted = announced_to(trial, meals, number)
    told = meals.carbs_g if counted is None else counted
    controller = of_case.controller
    if of_case.loop.own is not None:
        own = of_case.loop.own(drawn)
        controller = _first(own, varying(own, controller))
    return close_loop(
        trial,
        controller,
        Scenario(
            [
                Meal(*map(float, of_meal))
                for of_meal in zip(
                    *(values[:, 0] for values in (meals.carbs_g, meals.t_min, meals.eating_min, told)), strict=True
                )
            ],
            trial.plan.horizon_min,
            announced=trial.announce_meals,
            meal_model=trial.gut,
            start_min=trial.start_min,
        ),
        patient=of_people(drawn.patient, 0),
        around=of_case.surroundings,
        key=keys_of_people(trial.seed, number)[0],
    )


def _first(many: Any, varies: list[bool]) -> Any:
    """First element along the trailing axis."""
    leaves, tree = jax.tree.flatten(many)
    return jax.tree.unflatten(tree, [leaf[..., 0] if own else leaf for leaf, own in zip(leaves, varies, strict=True)])


def _told(trace: Trace, sample_time_min: float) -> Iterator[str]:
    glucose, fine_t = np.asarray(trace.fine_glucose_mg_dl), np.asarray(trace.fine_t_min)
    low = np.flatnonzero(glucose < LOW_MG_DL)
    if not low.size:
        yield f"Simulated alone, the person stayed above {LOW_MG_DL:g} mg/dl, by {glucose.min() - LOW_MG_DL:.1f} mg/dl."
        return
    first_min, last_min = fine_t[low[0]], fine_t[low[-1]]
    least = glucose_text(glucose.min())
    yield f"Below {LOW_MG_DL:g} mg/dl from {first_min:.0f} to {last_min:.0f} min, least {least} mg/dl."
    t = np.asarray(trace.t_min)
    before = (t >= first_min - _BEFORE_MIN) & (t <= first_min)
    known = np.asarray(trace.reading_valid) & np.isfinite(np.asarray(trace.reading_mg_dl))
    yield from _of_readings(trace, before, known)
    yield from _of_pump(trace, t <= first_min, before)
    basal = float(trace.basal_insulin_mU_min)
    rate = np.asarray(trace.insulin_mU_min)[before].mean() / basal if basal else np.nan
    yield f"In the {before.sum() * sample_time_min:.0f} min before, the person got {rate:.2f} of the basal rate."
    status = np.asarray(trace.status)[t <= last_min]
    acts = [text.format(_counted(count, what)) for of, text, what in _ACTS if (count := int((status == of).sum()))]
    if acts:
        yield f"Up to the end of it the guard {', '.join(acts)}."


def _counted(number: int, what: str) -> str:
    return f"{number} {what}" if number == 1 else f"{number} {what}s"


def _of_readings(trace: Trace, before: Any, known: Any) -> Iterator[str]:
    missing = int((~known & before).sum())
    if missing:
        yield f"Of the {int(before.sum())} readings before it {missing} {'was' if missing == 1 else 'were'} missing."
    seen = before & known
    if not seen.any():
        return
    error = (np.asarray(trace.reading_mg_dl) - np.asarray(trace.glucose_mg_dl))[seen]
    middle, largest = float(np.median(error)), float(error[np.abs(error).argmax()])
    if abs(middle) > _BIAS_MG_DL:
        yield f"Readings were {abs(middle):.0f} mg/dl too {'high' if middle > 0.0 else 'low'} in the median before it."
    elif abs(largest) > 2.0 * _BIAS_MG_DL:
        yield f"One reading was {abs(largest):.0f} mg/dl too {'high' if largest > 0.0 else 'low'}."


def _insulin(trace: Trace) -> Iterator[Any]:
    """All insulin that was asked for, delivered and reported at each sample, as rates: boluses count evenly."""
    sample_time_min = trace.fine_t_min[-1] / trace.t_min.shape[0]
    for rate, bolus in (
        (trace.command_mU_min, trace.command_bolus_mU),
        (trace.insulin_mU_min, trace.bolus_mU),
        (trace.reported_mU_min, trace.reported_bolus_mU),
    ):
        yield rate if bolus is None else rate + bolus / sample_time_min


def _of_pump(trace: Trace, so_far: Any, before: Any) -> Iterator[str]:
    command, given, said = (np.asarray(dose) for dose in _insulin(trace))
    lost = float((command - given)[so_far].sum() / max(command[so_far].sum(), 1.0))
    if lost > _LESS:
        yield f"Until then the pump had delivered {100.0 * lost:.0f} % less than it was told."
    untold = float(np.nansum((said - given)[so_far]))
    if untold > _LESS * float(given[so_far].sum()):
        yield "It had not said so."
