"""A bound carried out: the best doses by the knowledge of the meals, and those under sensor noise, and their figure."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
import polars as pl

from glucoloop.bounds import IN_ADVANCE, HedgedDoses, OptimalDoses, bound_of_situation, hedged_doses, optimal_doses
from glucoloop.meals import Meal
from glucoloop.patients.capabilities import lowest_valid_glucose_mg_dl
from glucoloop.physiology.exercise import Exercise
from glucoloop.pumps.limits import PARKER_1999_LIMITS, DoseLimits
from glucoloop.reporting import _style
from glucoloop.reporting.charts import extent
from glucoloop.reporting.columns import Column, FittingTable, decimals, terminal_table
from glucoloop.reporting.figure_files import figure_files
from glucoloop.reporting.labelled_traces import validity_sentence
from glucoloop.situations.run import Run
from glucoloop.storage.results import Results
from glucoloop.studies.bound import BoundRequest

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.figure import Figure

_COURSES: Final = ("t_min", "insulin_mU_min", "fine_t_min", "glucose_mg_dl")
"""Values of a plan over time."""


# ---------------------------------------------------------------------------------------------- what is found


@dataclass(frozen=True)
class _Bounds:
    """Plans by the knowledge of the meals, and plans under sensor noise."""

    plans: dict[str, OptimalDoses]
    hedged: dict[str, HedgedDoses]

    @property
    def curves(self) -> dict[str, OptimalDoses]:
        """All plans for the meals as they are."""
        return {**self.plans, **{label: hedged.meal for label, hedged in self.hedged.items()}}

    def table(self, time: str, what: str) -> pl.DataFrame:
        """Values of all plans over time, by information and world."""
        worlds = [(label, "meal", plan) for label, plan in self.plans.items()]
        for label, hedged in self.hedged.items():
            other = "no meal" if hedged.question == "begins" else "larger meal"
            worlds += [(label, "meal", hedged.meal), (label, other, hedged.other)]
        return pl.concat(
            pl.DataFrame({"t_min": getattr(plan, time), what: getattr(plan, what)}).select(
                pl.lit(label).alias("information"), pl.lit(world).alias("world"), pl.all()
            )
            for label, world, plan in worlds
        )


def results_of(config: BoundRequest, progress: Callable[[str], None]) -> Results:
    """Compute every plan that was asked for; Refusal for a situation that is not possible."""
    bounds = _bounds(config, progress)
    plain = {
        "config": config.tree(whole=True),
        "bounds": [
            {
                "information": label,
                **{key: value for key, value in dataclasses.asdict(plan).items() if key not in _COURSES},
            }
            for label, plan in bounds.plans.items()
        ],
        "hedged": [
            {
                "information": label,
                **{name: getattr(hedged, name) for name in ("error", "distinguished_after_min", "deviation_mg_dl")},
                "undershoot_mg_dl": hedged.meal.undershoot_mg_dl,
                "peak_mg_dl": hedged.meal.peak_mg_dl,
                "other_undershoot_mg_dl": hedged.other.undershoot_mg_dl,
                "other_peak_mg_dl": hedged.other.peak_mg_dl,
                "converged": hedged.converged,
                "iterations": hedged.meal.iterations,
                "optimality": hedged.meal.optimality,
            }
            for label, hedged in bounds.hedged.items()
        ],
        "notes": [*_notes(config, bounds)],
    }
    tables = {
        "doses.csv": bounds.table("t_min", "insulin_mU_min"),
        "glucose_1min.csv": bounds.table("fine_t_min", "glucose_mg_dl"),
    }
    return Results(plain, tables, bounds)


def bound_of_run(run: Run) -> OptimalDoses:
    """The bound for every controller in the situation of a run, whatever its faults and the steps of its pump.

    Refusal for a situation that is not possible, or too long for a plan.
    """
    return bound_of_situation(
        run.nominal,
        run.as_scenario(),
        run.limits,
        dead_time_min=run.dead_time_min,
        sample_time_min=run.sample_time_min,
    )


def _bounds(config: BoundRequest, progress: Callable[[str], None]) -> _Bounds:
    scenario = config.as_scenario()
    bounds = _Bounds({}, {})
    for known_after_min in dict.fromkeys([*([IN_ADVANCE] if config.in_advance else []), *config.known_after_min]):
        label = _information_label(known_after_min)
        bounds.plans[label] = optimal_doses(
            config.nominal,
            scenario,
            config.limits,
            known_after_min=known_after_min + config.dead_time_min,
            objective=config.objective,
            undershoot_weight=config.undershoot_weight,
            sample_time_min=config.sample_time_min,
        )
        progress(label)
    if config.hedged:
        for doses in hedged_doses(
            config.nominal,
            scenario,
            config.noise_variance,
            config.limits,
            dead_time_min=config.dead_time_min,
            sample_time_min=config.sample_time_min,
        ):
            label = f"told from noise that it {doses.question}, error {doses.error:.0%}"
            bounds.hedged[label] = doses
            progress(label)
    return bounds


def _information_label(known_after_min: float) -> str:
    """Knowledge of the meals, in words."""
    if known_after_min == IN_ADVANCE:
        return "all known in advance"
    if known_after_min == 0.0:
        return "known from its start"
    return f"known {abs(known_after_min):g} min {'after' if known_after_min > 0.0 else 'before'} its start"


def _notes(config: BoundRequest, bounds: _Bounds) -> Iterator[str]:
    """Sentences on the plans that are not what they should be, and on what the numbers mean."""
    for label, plan in bounds.curves.items():
        if not plan.converged:
            yield (
                f"{label}: not converged after {plan.iterations} steps; the objective could fall by about "
                f"{plan.optimality:.2g} more, so this is not a bound."
            )
    limit = float(lowest_valid_glucose_mg_dl(config.nominal))
    for label, plan in bounds.plans.items():
        not_valid = validity_sentence(plan.fine_t_min, plan.glucose_mg_dl, limit)
        if not_valid is not None:
            yield f"{label}: {not_valid}"
    if config.dead_time_min and bounds.plans:
        yield f"Readings are {config.dead_time_min:g} min late, so each meal is known later by that time."
    if config.patient.subcutaneous:
        yield (
            "The doses are rates within the pump's limits, without boluses; a controller that gives boluses can do "
            "better."
        )
    if len(config.meals) > 1:
        yield "Each meal is known only after it begins; a controller that prepares for a likely meal could do better."
    if config.hedged:
        yield (
            "Told from noise: two worlds, this meal and none, or this meal and one a fifth larger, with the same "
            "doses until they can be distinguished with the stated error. The largest deviation is that of "
            "the worse world; undershoot and peak are those of this meal."
        )
    elif config.noisy:
        yield (
            "The bound under sensor noise is left out here: it is computed for one meal, at steady state at the "
            "setpoint, and the objective deviation."
        )


# ---------------------------------------------------------------------------------------------- how it is shown

_COLUMNS: Final = (
    Column(name="deviation_mg_dl", short="Largest deviation\nmg/dl", text=decimals(2)),
    Column(name="undershoot_mg_dl", short="Undershoot\nmg/dl", text=decimals(2)),
    Column(name="peak_mg_dl", short="Peak\nmg/dl", text=decimals(2)),
    Column(name="settles", short="Settles\nmin", text=str, only=lambda row: "settles" in row),
    Column(
        name="known_after_min",
        short="Known after\nmin",
        text="{:g}".format,
        missing=lambda row: "never" if "error" in row else "",
    ),
)


def tables(config: BoundRequest, results: Results) -> Iterator[FittingTable]:
    """The best possible results by the knowledge of the meals, and under sensor noise."""
    rows = [
        {**row, "settles": f"{row['settling_min']:.0f}{'' if row['settled'] else '+'}"}
        for row in results.plain["bounds"]
    ]
    # they are not followed to the end of the run
    rows += [{**row, "known_after_min": row["distinguished_after_min"]} for row in results.plain["hedged"]]
    lines = [(f"{row['information']}{'' if row['converged'] else ' (not converged)'}", [row]) for row in rows]
    yield terminal_table("Information", [("", lines)], _COLUMNS)


def files_of(config: BoundRequest, results: Results) -> dict[str, bytes]:
    """The figure of all plans."""
    title = f"The best that could be done at {config.place}"
    bouts = config.as_scenario().exercise
    figure = _plot_bound(results.extra.curves, config.eaten(), bouts, title=title, limits=config.limits)
    return figure_files("figure", figure)


def _plot_bound(
    plans: Mapping[str, OptimalDoses],
    meals: Sequence[Meal] = (),
    exercise: Sequence[Exercise] = (),
    *,
    title: str | None = None,
    limits: DoseLimits = PARKER_1999_LIMITS,
) -> Figure:
    """Draw plans over each other: glucose with the setpoint, meals and exercise above, the doses as steps below.

    A plan ends where it is followed to. The pump's limits are drawn where they come into view.
    """
    horizon_min = max(float(plan.fine_t_min[-1]) for plan in plans.values())
    figure, above, below, divisor = _style.loop_panels(horizon_min, title, "double", ratio=1.4)
    first = next(iter(plans.values()))
    entries: dict[str, Artist] = {}
    setpoint = above.axhline(first.setpoint_mg_dl, **_style.SETPOINT, zorder=1)
    basal = below.axhline(first.basal_insulin_mU_min, **_style.BASAL)
    for index, (label, plan) in enumerate(plans.items()):
        style = _style.line_style(index)
        entries[label] = above.plot(plan.fine_t_min / divisor, plan.glucose_mg_dl, **style, zorder=3)[0]
        t_min = np.append(plan.t_min, plan.fine_t_min[-1])
        doses = np.append(plan.insulin_mU_min, plan.insulin_mU_min[-1])
        below.step(t_min / divisor, doses, where="post", **style, zorder=3)
    entries[f"setpoint {first.setpoint_mg_dl:.4g} mg/dl"] = setpoint
    entries[f"basal {first.basal_insulin_mU_min:.4g} mU/min"] = basal
    _style.mark_meals(above, [(meal.t_min, meal.carbs_g) for meal in meals], horizon_min, "double")
    _style.mark_exercise(above, exercise, horizon_min, "double")
    low, high = extent(*(plan.glucose_mg_dl for plan in plans.values()))
    above.set_ylim(low - 0.08 * (high - low), high + 0.08 * (high - low))
    low, high = extent([0.0], *(plan.insulin_mU_min for plan in plans.values()))
    low, high = low - 0.06 * (high - low), high + 0.06 * (high - low)
    for limit in (float(limits.min_mU_min), float(limits.max_mU_min)):
        if low <= limit <= high:
            entries["pump limits"] = below.axhline(limit, **_style.PUMP_LIMIT)
    below.set_ylim(low, high)
    _style.add_legend(figure, entries, "double")
    return figure
