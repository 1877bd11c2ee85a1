"""Work of a replay: the twin and people of its posterior under the recorded doses, and under each controller."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
import polars as pl

from glucoloop.build.assemble import PeopleLoop, with_profile_of_each
from glucoloop.build.designs import controller_of
from glucoloop.build.random_keys import keys_of_people
from glucoloop.build.surroundings import Surroundings, surroundings_of
from glucoloop.meals import Eaten
from glucoloop.metrics import RunningMetrics
from glucoloop.patients.capabilities import sites
from glucoloop.patients.population import VirtualPeople, virtual_people
from glucoloop.refusal import Refusal
from glucoloop.reporting.columns import Column, FittingTable, terminal_table
from glucoloop.reporting.days_figure import DayTraces, days_plot, plot_days
from glucoloop.reporting.print_figure import figure_files
from glucoloop.reporting.template import render
from glucoloop.simulation.closed_loop import sample_grid
from glucoloop.simulation.cohort import CohortRun
from glucoloop.simulation.plant import SampleGrid
from glucoloop.situations.case import Case
from glucoloop.situations.situation import Situation
from glucoloop.storage.results import Results
from glucoloop.studies.replay import ReplayRequest, twin_values
from glucoloop.studies.twin.study import days_of
from glucoloop.text import how_many
from glucoloop.trials.blocks import block_size, in_blocks
from glucoloop.twins import RecordedDays, ResidualSensor, Simulator, StoredTwin
from glucoloop.twins.days import SAMPLE_MIN
from glucoloop.twins.trajectory import WARM_UP_MIN
from glucoloop.units import MIN_PER_DAY, MU_PER_U

Values = npt.NDArray[np.float64]

_RECORD: Final = "record"
_RECORDED_DOSES: Final = "twin, recorded doses"
_LONGEST_FILLED_MIN: Final = 60.0
"""Longest time without readings over which a residual is carried."""
_SHOWN_DAYS: Final = 2.0


@dataclass(frozen=True)
class _Arm:
    """One therapy: glucose ``(people, times)`` and insulin ``(people, samples)``, the twin first."""

    name: str
    t_min: Values
    """Times of glucose: of the samples and their end, or of the readings of a record."""
    glucose_mg_dl: Values
    insulin_mU_min: Values

    def numbers(self) -> dict[str, Values]:
        """Numbers of each person ``(people,)``, after the first hours."""
        glucose = self.glucose_mg_dl[:, self.t_min >= WARM_UP_MIN]
        insulin = self.insulin_mU_min[:, round(WARM_UP_MIN / SAMPLE_MIN) :]
        there = np.isfinite(glucose)
        count = there.sum(axis=1)

        def share(inside: npt.NDArray[np.bool_]) -> Values:
            results: Values = 100.0 * (inside & there).sum(axis=1) / count
            return results

        return {
            "mean_mg_dl": np.nanmean(glucose, axis=1),
            "time_70_180_pct": share((glucose >= 70.0) & (glucose <= 180.0)),
            "time_below_70_pct": share(glucose < 70.0),
            "time_below_54_pct": share(glucose < 54.0),
            "time_above_180_pct": share(glucose > 180.0),
            "daily_dose_U": insulin.mean(axis=1) * MIN_PER_DAY / MU_PER_U,
        }


@dataclass(frozen=True)
class _Replayed:
    """All arms, the twin under the recorded doses first, and the record."""

    days: RecordedDays
    grid: SampleGrid
    arms: tuple[_Arm, ...]
    left_out: int


def results_of(config: ReplayRequest, progress: Callable[[str], None]) -> Results:
    """Replay the record under each controller; Refusal for one that cannot be designed."""
    values = twin_values(config.twin)
    try:
        twin = StoredTwin.of(values)
    except Refusal as error:
        raise error.within(str(config.twin)) from None
    days = days_of(config)
    if abs(config.sample_time_min - SAMPLE_MIN) > 1e-9:
        raise Refusal(f"a replay has samples of {SAMPLE_MIN:g} min, as its twin; leave --sample-time out")
    replayed = _replayed(config, twin, days, progress)
    rows = [_row(_RECORD, {name: value[:1] for name, value in _record(days).numbers().items()}, None)]
    recorded = replayed.arms[0].numbers()
    rows += [_row(arm.name, arm.numbers(), None if arm is replayed.arms[0] else recorded) for arm in replayed.arms]
    plain = {
        "config": config.tree(whole=True),
        "carried": config.carry,
        "people": len(replayed.arms[0].glucose_mg_dl),
        "days": days.length_min / MIN_PER_DAY,
        "meals": days.meals,
        "rows": rows,
        "notes": [*days.notes, *_notes(config, replayed)],
    }
    table = pl.DataFrame(rows)
    return Results(plain, {"numbers.csv": table, "courses.parquet": _courses(replayed)}, replayed)


def _replayed(
    config: ReplayRequest, twin: StoredTwin, days: RecordedDays, progress: Callable[[str], None]
) -> _Replayed:
    start = f"{days.first:%H:%M}"
    situation = Situation(**{**{name: getattr(config, name) for name in Situation.settings()}, "start": start})
    z = twin.coordinates(config.draws, config.seed)
    simulator = Simulator.of(twin.people(Simulator.parameters(twin.posterior, z)), twin.posterior, days)
    values, x = simulator.starts(z)
    people = virtual_people(
        twin.people(values), situation.seed, np.arange(len(z)), setpoint_mg_dl=situation.target_mg_dl
    )
    possible = people.feasible & np.isfinite(x).all(axis=0)
    if not possible[0]:
        raise Refusal(
            f"no insulin infusion holds the twin at {situation.target_mg_dl:g} mg/dl; give another --setpoint"
        )
    people = dataclasses.replace(people, rest=x).at(np.flatnonzero(possible))
    samples = math.floor(days.length_min / SAMPLE_MIN)
    grid = sample_grid(samples * SAMPLE_MIN, SAMPLE_MIN, days.clock_min)
    seen = simulator.glucose_mg_dl(z[possible])[:, : samples + 1]
    plasma = dataclasses.replace(simulator, site=sites(people.patient)[0])
    recorded = plasma.glucose_mg_dl(z[possible])[:, : samples + 1]
    progress(f"{how_many(len(seen), 'person', 'people')} under the recorded doses")
    residual = _residual(days, seen) if config.carry else np.zeros_like(seen)
    t_min = SAMPLE_MIN * np.arange(samples + 1, dtype=np.float64)
    given = np.broadcast_to(days.insulin_mU_min[:samples], (len(seen), samples))
    arms = [_Arm(_RECORDED_DOSES, t_min, recorded + residual, given)]
    for case in config.cases:
        run = _loop(situation, case, people, days, grid, residual if config.carry else None)
        arms.append(_Arm(case.label, t_min, run.glucose_mg_dl.T + residual, run.insulin_mU_min.T))
        progress(case.label)
    return _Replayed(days, grid, tuple(arms), int(np.count_nonzero(~possible)))


def _loop(
    situation: Situation,
    case: Case,
    people: VirtualPeople,
    days: RecordedDays,
    grid: SampleGrid,
    residual: Values | None,
) -> CohortRun:
    """Loop of all people under a controller, which has the profile of each."""
    eats = (days.carbs_g > 0.0) & (days.meal_min < grid.samples * SAMPLE_MIN)
    bare = surroundings_of(situation, case.faults)

    def with_residual(of: Values) -> Surroundings:
        return Surroundings(sensor=ResidualSensor(inner=bare.sensor, residual_mg_dl=jnp.asarray(of)), pump=bare.pump)

    controller = controller_of(situation, case)
    loop = PeopleLoop(
        situation,
        controller,
        people.at(np.arange(1)),
        grid,
        RunningMetrics(
            setpoint_mg_dl=situation.target_mg_dl, limits=situation.limits, inside_min=tuple(grid.inside_min.tolist())
        ),
        meals=Eaten(t_min=days.meal_min[eats], carbs_g=days.carbs_g[eats], eating_min=np.zeros(eats.sum())),
        controllers_of=with_profile_of_each(controller),
        surroundings=bare if residual is None else with_residual(residual[0, :-1]),
        varied=None if residual is None else with_residual(residual[:1, :-1].T),
        start_min=days.clock_min,
        engine=None if residual is None else "xla",  # a residual is looked up by the number of the sample
    )

    def run(place: npt.NDArray[np.intp], n: int) -> CohortRun:
        del n  # what fills the last block up is cut off at the end
        some = people.at(place)
        own: dict[str, Any] = {} if residual is None else {"surroundings": with_residual(residual[place, :-1].T)}
        return loop.run(some, keys_of_people(situation.seed, some.draw.person), **own)

    number = people.feasible.size
    runs = in_blocks(run, np.arange(number), block_size(loop.engine), None)

    def joined(name: str) -> Values:
        return np.concatenate([getattr(part, name) for part in runs], axis=-1)[:, :number]

    return dataclasses.replace(runs[0], glucose_mg_dl=joined("glucose_mg_dl"), insulin_mU_min=joined("insulin_mU_min"))


def _residual(days: RecordedDays, twin_mg_dl: Values) -> Values:
    """Reading minus the twin at each sample ``(people, samples + 1)``; 0 where readings are missing for long."""
    t_min = SAMPLE_MIN * np.arange(twin_mg_dl.shape[1])
    reading = np.interp(t_min, days.reading_min, days.reading_mg_dl)
    after = np.clip(np.searchsorted(days.reading_min, t_min), 1, days.reading_min.size - 1)
    gap = days.reading_min[after] - days.reading_min[after - 1]
    return np.where(gap <= _LONGEST_FILLED_MIN, reading - twin_mg_dl, 0.0)


def _record(days: RecordedDays) -> _Arm:
    """The record itself, at its readings."""
    samples = math.floor(days.length_min / SAMPLE_MIN)
    return _Arm(_RECORD, days.reading_min, days.reading_mg_dl[None], days.insulin_mU_min[None, :samples])


def _row(name: str, numbers: Mapping[str, Values], recorded: Mapping[str, Values] | None) -> dict[str, Any]:
    """Numbers of an arm: of the twin, and from 5 to 95 % of the people; and differences from the recorded doses."""
    row: dict[str, Any] = {"therapy": name}
    for key, values in numbers.items():
        row[key] = float(values[0])
        for what, of in (("", values), ("change_", None if recorded is None else values - recorded[key])):
            if of is not None and of.size > 1:
                low, high = np.percentile(of, (5.0, 95.0))
                row |= {f"{what}{key}_low": float(low), f"{what}{key}_high": float(high)}
        row[f"change_{key}"] = None if recorded is None else float(values[0] - recorded[key][0])
    return row


def _courses(replayed: _Replayed) -> pl.DataFrame:
    parts = []
    for arm in replayed.arms:
        low, high = np.percentile(arm.glucose_mg_dl, (5.0, 95.0), axis=0)
        parts.append(
            pl.DataFrame(
                {
                    "t_min": arm.t_min,
                    "glucose_mg_dl": arm.glucose_mg_dl[0],
                    "low_mg_dl": low,
                    "high_mg_dl": high,
                    "insulin_mU_min": np.append(arm.insulin_mU_min[0], np.nan),
                }
            ).select(pl.lit(arm.name).alias("therapy"), pl.all())
        )
    return pl.concat(parts)


def _notes(config: ReplayRequest, replayed: _Replayed) -> Iterator[str]:
    yield (
        "What the twin does not explain of the readings is carried along: the controller sees it, and it is in the "
        "glucose of every therapy, as if it came from outside and no dose had changed it."
        if config.carry
        else "What the twin does not explain of the readings is left out; --carry carries it along."
    )
    if replayed.left_out:
        who = how_many(replayed.left_out, "drawn person", "drawn people")
        yield f"{who} could not rest at the target and were left out."


def _columns() -> Iterator[Column]:
    names = {
        "mean_mg_dl": ("Mean (mg/dl)", "mean\n(mg/dl)"),
        "time_70_180_pct": ("70 to 180 mg/dl (%)", "70-180\n(%)"),
        "time_below_70_pct": ("Below 70 mg/dl (%)", "< 70\n(%)"),
        "time_below_54_pct": ("Below 54 mg/dl (%)", "< 54\n(%)"),
        "time_above_180_pct": ("Above 180 mg/dl (%)", "> 180\n(%)"),
        "daily_dose_U": ("Insulin (U a day)", "U\na day"),
    }
    for key, (head, short) in names.items():
        text = "{:.0f}".format if key == "mean_mg_dl" else "{:.1f}".format
        yield Column(name=key, group=head, head="twin", short=short, text=text)
        yield Column(name=f"{key}_low", group=head, head="5th pct.", text=text, missing=lambda row: "")
        yield Column(name=f"{key}_high", group=head, head="95th pct.", text=text, missing=lambda row: "")


_COLUMNS: Final = tuple(_columns())


def _lines(results: Results) -> list[tuple[str, list[dict[str, Any]]]]:
    names = [column.name for column in _COLUMNS]
    return [(row["therapy"], [{name: row.get(name) for name in names}]) for row in results.rows]


def tables(config: ReplayRequest, results: Results) -> Iterator[FittingTable]:
    """Numbers of the record, of the twin under the recorded doses, and under each controller."""
    yield terminal_table("Therapy", [("", _lines(results))], _COLUMNS)


def sentences(config: ReplayRequest, results: Results) -> Iterator[str]:
    """Sentences on what each controller changes, with its interval."""
    for row in results.rows[2:]:
        inside, below = (
            (f"{row[f'change_{key}']:+.1f}", f"{row[f'change_{key}_low']:+.1f} to {row[f'change_{key}_high']:+.1f}")
            for key in ("time_70_180_pct", "time_below_70_pct")
        )
        yield (
            f"{row['therapy']} instead of the recorded doses: time from 70 to 180 mg/dl {inside[0]} percentage points "
            f"({inside[1]} in 90 % of the people of the posterior), time below 70 mg/dl {below[0]} ({below[1]})."
        )
    yield (
        "The intervals cover the uncertainty of the twin that the record leaves. They do not cover that another "
        "therapy changes how a person eats and lives, nor what the patient model lacks."
    )


def files_of(config: ReplayRequest, results: Results) -> dict[str, bytes]:
    """The page and the figure."""
    replayed: _Replayed = results.extra
    days = _days_of_picture(replayed)
    page = render(
        Path(__file__).with_name("page.html"),
        "Replay of a record",
        sentences=[*sentences(config, results), *results.plain["notes"]],
        facts={
            "Twin": config.patient.display_name,
            "Record": f"{results.plain['days']:.1f} days with {results.plain['meals']} meals",
            "Meals": "not announced" if config.unannounced else "announced when they were entered",
            "Residual": "carried along" if config.carry else "left out",
            "People": f"the twin and {results.plain['people'] - 1} drawn from its posterior",
        },
        script=True,
        plot=days_plot(days, "90 % of people"),
        rows=[(name, [("", row) for row in rows]) for name, rows in _lines(results)],
        columns=_COLUMNS,
    )
    return {"page.html": page.encode(), **figure_files("figure", plot_days(days))}


def _days_of_picture(replayed: _Replayed) -> DayTraces:
    """The last days."""
    days = replayed.days
    begin = max(WARM_UP_MIN, days.length_min - _SHOWN_DAYS * MIN_PER_DAY)
    t_min = replayed.arms[0].t_min
    chosen = t_min >= begin
    bands = {arm.name: np.percentile(arm.glucose_mg_dl[:, chosen], (5.0, 95.0), axis=0) for arm in replayed.arms}
    return DayTraces(
        first=days.first,
        t_min=t_min[chosen],
        reading_mg_dl=np.interp(t_min[chosen], days.reading_min, days.reading_mg_dl),
        trajectory_mg_dl={arm.name: arm.glucose_mg_dl[0, chosen] for arm in replayed.arms},
        band_mg_dl={name: (low, high) for name, (low, high) in bands.items()},
        meals=days.meals_from(begin),
    )
