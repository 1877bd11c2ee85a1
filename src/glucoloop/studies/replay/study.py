"""Work of a replay: the twin and people near it under the recorded doses, and under each controller."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Mapping, Sequence
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
from glucoloop.build.surroundings import surroundings_of
from glucoloop.forecasts.grid import SAMPLE_MIN, GriddedRecord
from glucoloop.meals import Eaten
from glucoloop.metrics import RunningMetrics
from glucoloop.patients.population import VirtualPeople, virtual_people
from glucoloop.refusal import Refusal
from glucoloop.reporting.columns import Column, FittingTable, terminal_table
from glucoloop.reporting.days_figure import DayTraces, days_plot, plot_days
from glucoloop.reporting.figure_files import figure_files
from glucoloop.reporting.template import render
from glucoloop.simulation.closed_loop import sample_grid
from glucoloop.simulation.cohort import CohortRun
from glucoloop.simulation.minute_inputs import PeopleMinuteInputs
from glucoloop.simulation.plant import SampleGrid
from glucoloop.situations.case import Case
from glucoloop.situations.population import person_of
from glucoloop.situations.situation import Situation
from glucoloop.situations.therapy_text import read_change
from glucoloop.storage.results import Results
from glucoloop.studies.replay import ReplayRequest, twin_values
from glucoloop.studies.replay.changed_doses import CalculatorNumbers, changed_doses
from glucoloop.studies.twin.study import record_of
from glucoloop.text import how_many
from glucoloop.trials.people import block_size, few_in_a_block, in_blocks
from glucoloop.twins import (
    Explained,
    StoredTwin,
    change_range,
    explained_people,
    people_of,
    replay_people,
    under_doses,
)
from glucoloop.twins.twin import record_sentences, rises_without_carbs_pct
from glucoloop.units import MIN_PER_DAY, MU_PER_U

Values = npt.NDArray[np.float64]

_RECORD: Final = "record"
_RECORDED_DOSES: Final = "twin, recorded doses"
_PERSON: Final = "person.toml:twin"
_WARM_UP_MIN: Final = 720.0
"""Time at the start that is not counted: the state forgets how it was begun."""
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
        glucose = self.glucose_mg_dl[:, self.t_min >= _WARM_UP_MIN]
        insulin = self.insulin_mU_min[:, round(_WARM_UP_MIN / SAMPLE_MIN) :]
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

    record: GriddedRecord
    arms: tuple[_Arm, ...]
    sensitivities: tuple[float, ...]
    """Factors on the sensitivity of the people after the twin."""
    drawn: tuple[bool, ...]
    """Marks of the people who are drawn."""
    notes: tuple[str, ...] = ()
    """Sentences on the doses that were changed."""


def results_of(config: ReplayRequest, progress: Callable[[str], None]) -> Results:
    """Replay the record under each controller; Refusal for one that cannot be designed."""
    try:
        twin = StoredTwin.of(twin_values(config.twin))
    except Refusal as error:
        raise error.within(config.twin or "") from None
    record = record_of(config)
    if abs(config.sample_time_min - SAMPLE_MIN) > 1e-9:
        raise Refusal(f"a replay has samples of {SAMPLE_MIN:g} min, as its twin; leave --sample-time out")
    replayed = _replayed(config, twin, record, progress)
    rows = [_row(_RECORD, {name: value[:1] for name, value in _record(record).numbers().items()}, None, replayed)]
    recorded = replayed.arms[0].numbers()
    rows += [
        _row(arm.name, arm.numbers(), None if arm is replayed.arms[0] else recorded, replayed) for arm in replayed.arms
    ]
    on_record = {
        "automatic_insulin_pct": record.automatic_insulin_pct,
        "rises_without_carbs_pct": rises_without_carbs_pct(record),
    }
    plain = {
        "verdict": twin.verdict,
        "predicts": twin.predicts,
        "config": config.tree(whole=True),
        "people": len(replayed.arms[0].glucose_mg_dl),
        "sensitivities": list(replayed.sensitivities),
        "days": record.days,
        "meals": int(np.count_nonzero(record.carbs_g)),
        "record": on_record,
        "rows": rows,
        "notes": [*record.notes, *record_sentences(on_record), *replayed.notes, *_notes(replayed)],
    }
    first = {"verdict": twin.verdict}
    table = pl.DataFrame([{**first, **row} for row in rows])
    courses = _courses(replayed).with_columns(pl.lit(twin.verdict).alias("verdict"))
    return Results(plain, {"numbers.csv": table, "courses.parquet": courses}, replayed)


def _replayed(
    config: ReplayRequest, twin: StoredTwin, record: GriddedRecord, progress: Callable[[str], None]
) -> _Replayed:
    situation = Situation.narrowed(config, start=f"{record.first:%H:%M}")
    everybody = list(replay_people(twin, config.draws, config.seed))
    number = how_many(len(everybody), "person", "people")
    persons = explained_people(everybody, record, twin.mean_mg_dl, lambda at: progress(f"{at} of {number} explained"))
    values = [{name: float(of[0]) for name, of in patient.values(p).items()} for patient, p, *_ in persons]
    profile = person_of(f"{config.twin}/{_PERSON}", twin.patient.prior.patient, 0).table
    drawn = people_of(
        twin.patient.prior.patient, values, {} if profile is None else profile.profile_of(profile.names[0])
    )
    people = virtual_people(drawn, situation.seed, np.arange(len(persons)), setpoint_mg_dl=situation.target_mg_dl)
    if not people.feasible[0]:
        raise Refusal(
            f"no insulin infusion holds the twin at {situation.target_mg_dl:g} mg/dl; give another --setpoint"
        )
    rest = np.stack([person.explained.start for person in persons], axis=-1)
    possible = np.flatnonzero(people.feasible)
    people, persons = dataclasses.replace(people, rest=rest).at(possible), [persons[at] for at in possible]
    notes = list[str]()
    if len(persons) < len(everybody):
        notes.append(
            f"{len(everybody) - len(persons)} of {number} are left out, since their equations cannot give this record."
        )
    fits = [person.explained for person in persons]
    glucose = np.stack([fit.glucose_mg_dl for fit in fits])
    samples = record.reading_mg_dl.size
    grid = sample_grid(samples * SAMPLE_MIN, SAMPLE_MIN, 0.0)
    first = np.asarray(people.patient.glucose_mg_dl(jnp.asarray(people.rest)))[:, None]
    t_min = SAMPLE_MIN * np.arange(samples + 1, dtype=np.float64)
    given = np.broadcast_to(MU_PER_U / SAMPLE_MIN * record.insulin_U, (len(persons), samples))
    arms = [_Arm(_RECORDED_DOSES, t_min, np.concatenate([first, glucose], axis=1), given)]
    numbers = _calculator(people, situation.target_mg_dl) if config.changes else None
    for text in config.changes:
        assert numbers is not None
        changed, note = changed_doses(record, read_change(text), numbers)
        glucose = np.stack([under_doses(person.patient, person.p, person.explained, changed) for person in persons])
        given = np.broadcast_to(MU_PER_U / SAMPLE_MIN * changed.insulin_U, given.shape)
        arms.append(_Arm(text, t_min, np.concatenate([first, glucose], axis=1), given))
        notes.append(f"{text}: {note}")
        progress(text)
    if numbers is not None:
        notes.append(
            f"A bolus is changed by the difference that a calculator with {numbers.carb_ratio_g_U:.3g} g/U, "
            f"{numbers.correction_mg_dl_U:.3g} mg/dl/U and a target of {numbers.target_mg_dl:.4g} mg/dl finds, by "
            f"the profile in {config.twin}/person.toml; later boluses stay as they were recorded."
        )
    for case in config.cases:
        run = _loop(situation, case, people, record, grid, fits)
        arms.append(_Arm(case.label, t_min, run.glucose_mg_dl.T, run.insulin_mU_min.T))
        progress(case.label)
    ends = tuple(person.end for person in persons if person.end is not None)
    return _Replayed(record, tuple(arms), ends, tuple(person.drawn for person in persons), tuple(notes))


def _calculator(people: VirtualPeople, target_mg_dl: float) -> CalculatorNumbers:
    """Numbers of the bolus calculator of the twin, whose profile all people have."""
    profile = people.at(np.arange(1)).profile
    return CalculatorNumbers(
        carb_ratio_g_U=float(profile.carb_ratio()[0]),
        correction_mg_dl_U=float(profile.correction_factor()[0]),
        target_mg_dl=target_mg_dl,
    )


def _loop(
    situation: Situation,
    case: Case,
    people: VirtualPeople,
    record: GriddedRecord,
    grid: SampleGrid,
    fits: Sequence[Explained],
) -> CohortRun:
    """Loop of all people under a controller, which has the profile of each."""
    eaten = np.flatnonzero(record.carbs_g)
    controller = controller_of(situation, case)
    appearance = np.stack([fit.other_mg_min for fit in fits], axis=-1)
    returning = np.array([fit.return_mg_min for fit in fits])

    def inputs(place: npt.NDArray[np.intp]) -> PeopleMinuteInputs:
        return PeopleMinuteInputs(grid, None, (), situation.seed, place, appearance[:, place], returning[place])

    loop = PeopleLoop(
        situation,
        controller,
        people.at(np.arange(1)),
        grid,
        RunningMetrics(
            setpoint_mg_dl=situation.target_mg_dl, limits=situation.limits, inside_min=tuple(grid.inside_min.tolist())
        ),
        meals=Eaten(
            t_min=np.asarray(SAMPLE_MIN * (eaten + 0.5), np.float64),
            carbs_g=record.carbs_g[eaten],
            eating_min=np.zeros(eaten.size),
        ),
        controllers_of=with_profile_of_each(controller),
        surroundings=surroundings_of(situation, case.faults),
        start_min=0.0,
        minute_inputs=inputs(np.arange(1)).names,
    )

    def run(place: npt.NDArray[np.intp], n: int) -> CohortRun:
        del n  # what fills the last block up is cut off at the end
        some = people.at(np.resize(place, drawn_together))
        keys = keys_of_people(situation.seed, some.draw.person)
        return loop.run(some, keys, number=place.size, minute_inputs=inputs(place))

    number, drawn_together = people.feasible.size, block_size(loop.engine)
    runs = in_blocks(run, np.arange(number), min(drawn_together, few_in_a_block(number)))

    def joined(name: str) -> Values:
        return np.concatenate([getattr(part, name) for part in runs], axis=-1)[:, :number]

    return dataclasses.replace(runs[0], glucose_mg_dl=joined("glucose_mg_dl"), insulin_mU_min=joined("insulin_mU_min"))


def _record(record: GriddedRecord) -> _Arm:
    """The record itself, at its readings."""
    there = np.flatnonzero(np.isfinite(record.reading_mg_dl))
    return _Arm(
        _RECORD,
        np.asarray(SAMPLE_MIN * (there + 1.0), np.float64),
        record.reading_mg_dl[None, there],
        MU_PER_U / SAMPLE_MIN * record.insulin_U[None],
    )


def _row(
    name: str, numbers: Mapping[str, Values], recorded: Mapping[str, Values] | None, replayed: _Replayed
) -> dict[str, Any]:
    """Numbers of an arm: of the twin, at both ends of the sensitivity, and the range of all people; and changes."""
    row: dict[str, Any] = {"therapy": name}
    for key, values in numbers.items():
        for what, of in (("", values), ("change_", None if recorded is None else values - recorded[key])):
            row[f"{what}{key}"] = None if of is None else float(of[0])
            if of is None or of.size == 1:
                continue
            row[f"{what}{key}_low"], row[f"{what}{key}_high"] = map(float, change_range(of, replayed.drawn))
            for place, factor in enumerate(replayed.sensitivities):
                row[f"{what}{key}_at_{factor:g}"] = float(of[1 + place])
    return row


def _courses(replayed: _Replayed) -> pl.DataFrame:
    parts = []
    for arm in replayed.arms:
        ends = {
            f"at_{factor:g}_mg_dl": arm.glucose_mg_dl[1 + place] for place, factor in enumerate(replayed.sensitivities)
        }
        parts.append(
            pl.DataFrame(
                {
                    "t_min": arm.t_min,
                    "glucose_mg_dl": arm.glucose_mg_dl[0],
                    "low_mg_dl": arm.glucose_mg_dl.min(axis=0),
                    "high_mg_dl": arm.glucose_mg_dl.max(axis=0),
                    **ends,
                    "insulin_mU_min": np.append(arm.insulin_mU_min[0], np.nan),
                }
            ).select(pl.lit(arm.name).alias("therapy"), pl.all())
        )
    return pl.concat(parts)


def _notes(replayed: _Replayed) -> Iterator[str]:
    yield (
        "What the record does not explain stays as an appearance of glucose under every therapy, as if no dose had "
        "changed it; only what returns glucose to its mean acts on glucose as it becomes."
    )
    if replayed.sensitivities:
        low, high = replayed.sensitivities
        yield (
            f"A record hardly tells how strongly insulin acts: each therapy stands also with {low:g} and {high:g} of "
            "the sensitivity, each with what the record then does not explain."
        )
    else:
        yield (
            "The patient does not declare which of its parameters are its sensitivity to insulin, so that the ranges "
            "are over no ends of it."
        )


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
        yield Column(name=f"{key}_low", group=head, head="lowest", text=text, missing=lambda row: "")
        yield Column(name=f"{key}_high", group=head, head="highest", text=text, missing=lambda row: "")


_COLUMNS: Final = tuple(_columns())


def _lines(results: Results) -> list[tuple[str, list[dict[str, Any]]]]:
    """Row of each therapy, and one at each end of the sensitivity."""
    names = [column.name for column in _COLUMNS]
    lines = list[tuple[str, list[dict[str, Any]]]]()
    for row in results.rows:
        lines.append((row["therapy"], [{name: row.get(name) for name in names}]))
        for factor in results.plain["sensitivities"]:
            of_end = {name: row.get(f"{name}_at_{factor:g}") for name in names}
            if of_end["mean_mg_dl"] is not None:
                lines.append((f"{row['therapy']}, {factor:g} of the sensitivity", [of_end]))
    return lines


def tables(config: ReplayRequest, results: Results) -> Iterator[FittingTable]:
    """Numbers of the record, of the twin under the recorded doses, and under each controller."""
    yield terminal_table("Therapy", [(results.plain["verdict"], _lines(results))], _COLUMNS)


def sentences(config: ReplayRequest, results: Results) -> Iterator[str]:
    """Sentences on whether the twin predicts, and what each controller changes, with its interval."""
    plain = results.plain
    yield plain["verdict"]
    if not plain["predicts"]:
        yield (
            "What a therapy would have changed is not claimed for such a twin; the numbers show only what its "
            "equations make of the doses."
        )
    else:
        for row in results.rows[2:]:
            inside, below = (
                (f"{row[f'change_{key}']:+.1f}", f"{row[f'change_{key}_low']:+.1f} to {row[f'change_{key}_high']:+.1f}")
                for key in ("time_70_180_pct", "time_below_70_pct")
            )
            yield (
                f"{row['therapy']} instead of the recorded doses: time from 70 to 180 mg/dl {inside[0]} percentage "
                f"points ({inside[1]}), time below 70 mg/dl {below[0]} ({below[1]})."
            )
    over = [f"{factor:g}" for factor in plain["sensitivities"]]
    yield (
        f"The ranges are over {' and '.join(over) + ' of the sensitivity, ' if over else ''}the twin as it was found, "
        "whose glucose nothing returns to its mean, and nine of ten people drawn. They do not cover that another "
        "therapy changes how a person eats and lives."
    )
    yield (
        "In simulated people of other patient models, whose true changes are known, replays had the right direction. "
        "They said 0.5 to 0.9 of the change of mean glucose in people of the models for which they were set, and 0.2 "
        "of it in more sensitive people of another one: read a replay as a direction with a range."
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
            "Record": f"{results.plain['days']} days with {results.plain['meals']} meals",
            "Meals": "not announced" if config.unannounced else "announced when they were entered",
            "People": f"the twin, both ends of its sensitivity, the twin as found, and {config.draws} drawn",
        },
        script=True,
        plot=days_plot(days, "range of all people"),
        rows=[(name, [("", row) for row in rows]) for name, rows in _lines(results)],
        columns=_COLUMNS,
    )
    return {"page.html": page.encode(), **figure_files("figure", plot_days(days))}


def _days_of_picture(replayed: _Replayed) -> DayTraces:
    """The last days: each therapy on the twin, and both ends of its sensitivity as the band."""
    record = replayed.record
    end_min = SAMPLE_MIN * record.reading_mg_dl.size
    begin = max(_WARM_UP_MIN, end_min - _SHOWN_DAYS * MIN_PER_DAY)
    t_min = replayed.arms[0].t_min
    chosen = t_min >= begin
    there = np.isfinite(record.reading_mg_dl)
    read_min = SAMPLE_MIN * (np.flatnonzero(there) + 1.0)
    eaten = np.flatnonzero(record.carbs_g)
    return DayTraces(
        first=record.first,
        t_min=t_min[chosen],
        reading_mg_dl=np.interp(t_min[chosen], read_min, record.reading_mg_dl[there]),
        trajectory_mg_dl={arm.name: arm.glucose_mg_dl[0, chosen] for arm in replayed.arms},
        band_mg_dl={
            arm.name: (arm.glucose_mg_dl[:, chosen].min(axis=0), arm.glucose_mg_dl[:, chosen].max(axis=0))
            for arm in replayed.arms
        },
        meals=[(SAMPLE_MIN * at, float(record.carbs_g[at])) for at in eaten.tolist() if SAMPLE_MIN * at >= begin],
    )
