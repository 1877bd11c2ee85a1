"""Replays where the truth is known: what twins say of other doses, beside what these doses do.

    python validation/replay_truth.py
    python validation/replay_truth.py --people 4 --seed 7000 --rows rows.jsonl

A person of one family of patients lives 14 days, and a twin of another family is found from the record: the person's
equations are not the twin's. Half of the meals are neither announced nor in the record, the others are counted with an
error of 25 %, sensitivity to insulin changes by the time of day and from day to day (`visentin-2015`), readings are
those of a Dexcom G6. In two conditions the person doses by the usual formula, in two the controller `loop-like` does.
The basal rate, and with it the other numbers of the therapy, is such that mean glucose is 165 mg/dl.

Then the recorded basal rate, and all recorded boluses, are 20 % less and 20 % more, four changes of each person. The
true change is that of the same person with the same meals and the same sensitivity; the predicted one is that of
`glucoloop replay --change`, with its range.

The constants of `twins.replayed` were chosen on the first four conditions, with seeds 101 to 108; on people of
`hovorka-2004`, whose twins are of `wilinska-2010`, nothing was.

For each condition the table has, with intervals of 95 % by a bootstrap over people: the slope of predicted on true
changes (through 0; 1 is right), the mean absolute error of the changes, the share of true changes within the range, the
largest fall by 1 U in the replay over the person's mean one with the share of people in whose range it is, that of the
person times the daily dose, and how many twins say not to be relied on. With ``--rows`` the numbers of each person are
kept in a file, and those that are there are not computed again.
"""

from __future__ import annotations

import argparse
import dataclasses
import datetime as dt
import itertools
import json
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
import polars as pl

from glucoloop._pytree import pytree, static
from glucoloop.build.assemble import close_loop
from glucoloop.build.designs import controller_of
from glucoloop.build.surroundings import Surroundings, surroundings_of
from glucoloop.component.request import configuration_from
from glucoloop.control import Decision, Observation, Status
from glucoloop.forecasts.grid import SAMPLE_MIN, GriddedRecord, gridded_record
from glucoloop.patients.catalogue import patient_entry
from glucoloop.patients.population import population, virtual_people
from glucoloop.physiology.rhythm import changes_of
from glucoloop.pumps import DoseLimits, LimitedPump
from glucoloop.pumps.limits import BolusLimits
from glucoloop.records import DeviceRecord
from glucoloop.records.record import SCHEMA
from glucoloop.refusal import Refusal
from glucoloop.simulation import Trace
from glucoloop.situations.run import Run
from glucoloop.therapy import Profile, given_profile
from glucoloop.twins import (
    StoredTwin,
    change_range,
    explained_people,
    find_twin,
    prior_of,
    replay_people,
    under_doses,
)
from glucoloop.twins.extended import ExtendedPatient, working_mg_dl
from glucoloop.units import MU_MIN_PER_U_H, MU_PER_U

Values = npt.NDArray[np.float64]

SEED: Final = 63_000
"""First seed of the people who are reported; no setting was chosen on them."""
DAYS: Final = 14
MEAN_MG_DL: Final = 165.0
MEASURES: Final = ("mean", "in_range", "below_70")
CHANGES: Final = ((0.8, 1.0), (1.2, 1.0), (1.0, 0.8), (1.0, 1.2))
"""Factors on the basal rate and on boluses."""
_FIRST: Final = dt.datetime(2026, 3, 2)
_MEALS: Final = ((25, "7h"), (40, "12.5h"), (15, "16h"), (45, "19h"), (10, "21.5h"))
_HALVINGS: Final = 6
_FACTORS: Final = (0.7, 3.0)
"""Range in which the factor on a person's basal rate is sought."""
_WARM_UP: Final = 144
"""Samples, 12 h, that are not counted, as in a replay."""
_UNLIMITED: Final = 1e9


class Condition(NamedTuple):
    """Families of a person and of the twin, and who doses."""

    truth: str
    twin: str
    controller: str
    carbs: float
    """Factor on the meals, with which glucose has the standard deviation of real records."""

    @property
    def name(self) -> str:
        """Name of the condition."""
        return f"{self.truth} by {self.twin}, {self.controller}"


CONDITIONS: Final = (
    Condition("uva-padova-2008", "hovorka-2004", "basal-bolus", 1.0),
    Condition("uva-padova-2008", "hovorka-2004", "loop-like", 1.0),
    Condition("wilinska-2010", "hovorka-2004", "basal-bolus", 0.6),
    Condition("wilinska-2010", "hovorka-2004", "loop-like", 0.6),
    Condition("hovorka-2004", "wilinska-2010", "basal-bolus", 0.6),
    Condition("hovorka-2004", "wilinska-2010", "loop-like", 0.6),
)


@pytree
class _Doses:
    """Controller that gives doses one after the other, whatever the readings."""

    basal_mU_min: jax.Array
    bolus_mU: jax.Array
    sample_time_min: float = static(default=SAMPLE_MIN)

    @property
    def gives_boluses(self) -> bool:
        return True

    def init(self, observation: Observation) -> jax.Array:
        del observation
        return jnp.asarray(0)

    def step(self, state: jax.Array, observation: Observation) -> tuple[jax.Array, Decision]:
        del observation
        status = jnp.asarray(int(Status.OK))
        return state + 1, Decision(
            insulin_mU_min=self.basal_mU_min[state], bolus_mU=self.bolus_mU[state], status=status
        )


@dataclasses.dataclass(frozen=True)
class Life:
    """Days of a person, and how to simulate them again."""

    run: Run
    trace: Trace

    @property
    def glucose_mg_dl(self) -> Values:
        """Glucose ``(samples,)`` after each sample."""
        return _at_samples(self.trace)

    @property
    def mean_sensitivity(self) -> float:
        """Mean of the factor by which the rhythm changes the sensitivity to insulin."""
        scenario = self.run.as_scenario()
        clock_min = np.arange(0.0, scenario.horizon_min, SAMPLE_MIN)
        changes = changes_of(scenario.rhythms, clock_min, scenario.rhythm_seed, [scenario.rhythm_person])
        return float(np.mean(1.0 if changes.sensitivity is None else changes.sensitivity))

    def under(self, basal: float, boluses: float) -> Values:
        """The same with factors on all doses, which no pump limits or rounds."""
        pump = LimitedPump(
            limits=DoseLimits(max_change_mU_min=_UNLIMITED, min_mU_min=0.0, max_mU_min=_UNLIMITED),
            bolus=BolusLimits(max_mU=_UNLIMITED, min_mU=1e-6, step_mU=1e-6),
        )
        assert self.trace.bolus_mU is not None
        doses = _Doses(basal_mU_min=basal * self.trace.insulin_mU_min, bolus_mU=boluses * self.trace.bolus_mU)
        surroundings = Surroundings(sensor=surroundings_of(self.run).sensor, pump=pump)
        return _at_samples(close_loop(self.run, doses, self.run.as_scenario(), surroundings=surroundings))

    def record(self) -> DeviceRecord:
        """The record as devices keep it; doses and meals stand one minute after the reading that they follow."""
        trace = self.trace.to_polars()
        t_min = trace["t_min"]
        given = trace.select(
            _times(t_min, 1.0).alias("time"),
            pl.when(pl.col("announced_carbs_g") > 0.0).then("announced_carbs_g").alias("carbs_g"),
            pl.when(pl.col("bolus_mU") > 0.0).then(pl.col("bolus_mU") / MU_PER_U).alias("bolus_U"),
            (pl.col("insulin_mU_min") / MU_MIN_PER_U_H).alias("basal_U_h"),
        )
        if self.run.case.controller.name != "basal-bolus":
            alone = pl.col("bolus_U").is_not_null() & pl.col("carbs_g").is_null()
            given = given.with_columns(pl.when(alone).then(pl.lit("automatic")).alias("bolus_type"))
        readings = trace.select(_times(t_min, 0.0).alias("time"), glucose_mg_dl="reading_mg_dl")
        frame = pl.concat([readings, given], how="diagonal").sort("time")
        empty = [pl.lit(None).alias(name) for name in SCHEMA if name not in frame.columns]
        frame = frame.with_columns(*empty).select(pl.col(name).cast(kind) for name, kind in SCHEMA.items())
        return DeviceRecord(frame=frame, rows=frame.height)


def _times(t_min: pl.Series, after_min: float) -> pl.Series:
    return pl.Series([_FIRST + dt.timedelta(minutes=float(t) + after_min) for t in t_min])


def _at_samples(trace: Trace) -> Values:
    each = round(SAMPLE_MIN)
    return np.asarray(trace.fine_glucose_mg_dl, np.float64)[each::each]


def lived(condition: Condition, seed: int, days: int = DAYS) -> Life:
    """Days of a person with a therapy by which mean glucose is 165 mg/dl."""
    run = configuration_from(
        Run,
        {
            "patient": {"name": condition.truth, "person": str(seed)},
            "controller": [{"name": condition.controller}],
            "announce_meals": True,
            "days": days,
            "meals": [f"{condition.carbs * grams:g}g@{time}" for grams, time in _MEALS],
            "meal_size_spread_pct": 25.0,
            "meal_time_spread_min": 40.0,
            "habits": [{"name": "unannounced", "probability": 0.5}],
            "carb_error_pct": 25.0,
            "rhythm": [{"name": "visentin-2015"}],
            "sensor": [{"name": "ideal", "site": "interstitial"}, {"name": "dexcom-g6"}],
            "seed": seed,
            "start": "00:00",
        },
    )
    designed, scenario, own = controller_of(run, run.case), run.as_scenario(), run.profile
    low, high = _FACTORS
    for _ in range(_HALVINGS):
        factor = float(np.sqrt(low * high))
        profile = Profile(
            basal_mU_min=jnp.asarray(factor * float(own.basal_mU_min)),
            setpoint_mg_dl=jnp.asarray(float(own.setpoint_mg_dl)),
        )
        trace = close_loop(run, given_profile(designed, profile), scenario)
        above = float(np.asarray(trace.fine_glucose_mg_dl).mean()) > MEAN_MG_DL
        low, high = (factor, high) if above else (low, factor)
    return Life(run, trace)


def numbers(glucose_mg_dl: Values) -> Values:
    """Mean, time from 70 to 180 and time below 70 mg/dl [%] of glucose ``(..., samples)``."""
    counted = glucose_mg_dl[..., _WARM_UP:]
    inside = (counted >= 70.0) & (counted <= 180.0)
    return np.stack(
        [counted.mean(axis=-1), 100.0 * inside.mean(axis=-1), 100.0 * (counted < 70.0).mean(axis=-1)], axis=-1
    )


def fall_mg_dl_U(patient: str, seed: int, mean_mg_dl: float) -> float:
    """Largest fall of a person by 1 U without a rhythm, as that of a twin; NaN where no rate holds the mean."""
    people = population(patient_entry(patient).default_population, patient=patient)
    prior = prior_of(people)
    extended, values = ExtendedPatient.of(people, prior), virtual_people(people, seed, [seed]).draw.values
    p = np.zeros(extended.coordinates)
    own = {**patient_entry(patient).nominal, **{name: value[0] for name, value in values.items()}}
    p[: len(prior.parameters)] = prior.coordinates({name: own[name] for name in prior.parameters})
    return extended.fall_mg_dl_U(p, working_mg_dl(mean_mg_dl))


def changed_doses(record: GriddedRecord, basal: float, boluses: float) -> GriddedRecord:
    """The record with factors on its basal rate and on all boluses."""
    return dataclasses.replace(
        record,
        basal_U=basal * record.basal_U,
        user_bolus_U=boluses * record.user_bolus_U,
        automatic_bolus_U=boluses * record.automatic_bolus_U,
    )


class Predicted(NamedTuple):
    """What a replay says of the changes, and how strongly insulin acts in it."""

    changes: Values
    """``(changes, measures)`` of the twin."""
    range: Values
    """``(2, changes, measures)`` lowest and highest."""
    fall_mg_dl_U: tuple[float, float, float]
    """Largest fall by 1 U of the twin, lowest and highest."""


def predicted(twin: StoredTwin, record: GriddedRecord, draws: int, seed: int) -> Predicted:
    """What a replay of the record says."""
    people = explained_people(list(replay_people(twin, draws, seed)), record, twin.mean_mg_dl)
    drawn, doses = [of.drawn for of in people], [changed_doses(record, *change) for change in CHANGES]
    changes, falls = [], []
    for patient, p, _, _, of in people:
        after = [under_doses(patient, p, of, changed) for changed in doses]
        changes.append(numbers(np.stack(after)) - numbers(of.glucose_mg_dl))
        falls.append(patient.fall_mg_dl_U(p, working_mg_dl(twin.mean_mg_dl), returned=True))
    low, high = change_range(np.array(falls), drawn)
    range_of_changes = np.stack(change_range(np.stack(changes), drawn))
    return Predicted(changes[0], range_of_changes, (falls[0], float(low), float(high)))


def result_of(condition: Condition, seed: int, *, days: int = DAYS, draws: int = 10) -> dict[str, Any]:
    """Numbers of a person; Refusal where the person or the twin cannot be."""
    life = lived(condition, seed, days)
    record = gridded_record(life.record())
    before = numbers(life.glucose_mg_dl)
    true = numbers(np.stack([life.under(*change) for change in CHANGES])) - before
    people = population(patient_entry(condition.twin).default_population, patient=condition.twin)
    twin = find_twin(record, people, held_out_days=max(1, days // 3))
    stored = StoredTwin.of(twin.plain())
    of_replay = predicted(stored, record, draws, seed)
    return {
        "condition": condition.name,
        "seed": seed,
        "numbers": before.tolist(),
        "daily_dose_U": record.total_daily_dose_U,
        "true": true.tolist(),
        "predicted": of_replay.changes.tolist(),
        "range": of_replay.range.tolist(),
        "predicts": twin.predicts,
        "fall_mg_dl_U": list(of_replay.fall_mg_dl_U),
        "true_fall_mg_dl_U": fall_mg_dl_U(condition.truth, seed, stored.mean_mg_dl) * life.mean_sensitivity,
    }


def _over_people(rows: Sequence[dict[str, Any]], measure: Callable[[Sequence[dict[str, Any]]], float]) -> str:
    """A measure of some people with its interval of 95 % by a bootstrap over them."""
    places = np.random.default_rng(0).integers(0, len(rows), (1000, len(rows)))
    drawn = np.array([measure([rows[place] for place in some]) for some in places])
    there = drawn[np.isfinite(drawn)]
    if not there.size:
        return "unknown"
    low, high = np.percentile(there, (2.5, 97.5))
    return f"{measure(rows):.2f} ({low:.2f} to {high:.2f})"


def _changes(rows: Sequence[dict[str, Any]], name: str, measure: str) -> Values:
    return np.array([row[name] for row in rows])[..., MEASURES.index(measure)]


def slope(rows: Sequence[dict[str, Any]], measure: str) -> float:
    """Slope through 0 of predicted on true changes; NaN where nothing changes."""
    true = _changes(rows, "true", measure)
    square = float((true**2).sum())
    return float((_changes(rows, "predicted", measure) * true).sum()) / square if square else float("nan")


def error(rows: Sequence[dict[str, Any]], measure: str) -> float:
    """Mean absolute error of predicted changes."""
    return float(np.abs(_changes(rows, "predicted", measure) - _changes(rows, "true", measure)).mean())


def covered_pct(rows: Sequence[dict[str, Any]], measure: str) -> float:
    """Percentage of true changes within the range."""
    low, high = np.moveaxis(_changes(rows, "range", measure), 1, 0)
    true = _changes(rows, "true", measure)
    return float(100.0 * ((low <= true) & (true <= high)).mean())


def _sensitivity(rows: Sequence[dict[str, Any]]) -> float:
    return float(np.nanmedian([row["fall_mg_dl_U"][0] / row["true_fall_mg_dl_U"] for row in rows]))


def sensitivity_covered_pct(rows: Sequence[dict[str, Any]]) -> float:
    """Percentage of people whose true fall by 1 U is within the range of the replay, of those who have one."""
    falls = [(row["fall_mg_dl_U"], row["true_fall_mg_dl_U"]) for row in rows if np.isfinite(row["true_fall_mg_dl_U"])]
    return 100.0 * sum(low <= true <= high for (_, low, high), true in falls) / len(falls) if falls else float("nan")


def _sizes(rows: Sequence[dict[str, Any]], measure: str) -> float:
    return float(np.abs(_changes(rows, "true", measure)).mean())


def lines(rows: Sequence[dict[str, Any]]) -> Iterator[str]:
    """Lines on the people of each condition."""
    for name in dict.fromkeys(row["condition"] for row in rows):
        some = [row for row in rows if row["condition"] == name]
        before = np.median([row["numbers"] for row in some], axis=0)
        failed = sum(not row["predicts"] for row in some)
        yield (
            f"{name}: {len(some)} people, mean {before[0]:.0f} mg/dl, {before[1]:.0f} % in range, {before[2]:.1f} % "
            "below"
        )
        for measure in MEASURES:
            yield (
                f"  {measure}: slope {_over_people(some, lambda rows, of=measure: slope(rows, of))}, error "  # type: ignore[misc]
                f"{_over_people(some, lambda rows, of=measure: error(rows, of))} of changes by "  # type: ignore[misc]
                f"{_sizes(some, measure):.1f}, within the range {covered_pct(some, measure):.0f} %"
            )
        rule = np.nanmedian([row["true_fall_mg_dl_U"] * row["daily_dose_U"] for row in some])
        sensitivity = _over_people(some, _sensitivity)
        yield (
            f"  sensitivity over the true one {sensitivity}, within the range {sensitivity_covered_pct(some):.0f} %; "
            f"true fall times daily dose {rule:.0f} mg/dl; do not rely: {failed} of {len(some)}"
        )


def results(
    conditions: Iterable[Condition], seeds: Sequence[int], done: Sequence[dict[str, Any]]
) -> Iterator[dict[str, Any]]:
    """Numbers of each person that are not there yet."""
    there = {(row["condition"], row["seed"]) for row in done}
    for seed, condition in itertools.product(seeds, conditions):
        if (condition.name, seed) in there:
            continue
        try:
            yield result_of(condition, seed)
        except Refusal as error:
            print(f"{condition.name}, {seed} is left out: {error}", flush=True)


def main() -> None:
    """Compute what is missing, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--people", type=int, default=12, help="people of each condition")
    parser.add_argument("--seed", type=int, default=SEED, help="seed of the first person")
    parser.add_argument("--condition", type=int, action="append", choices=range(1, len(CONDITIONS) + 1))
    parser.add_argument("--rows", type=Path, help="file of the numbers of each person, one in a line")
    options = parser.parse_args()
    rows: list[dict[str, Any]] = []
    if options.rows is not None and options.rows.exists():
        rows = [json.loads(line) for line in options.rows.read_text(encoding="utf-8").splitlines()]
    chosen = [CONDITIONS[number - 1] for number in options.condition or range(1, len(CONDITIONS) + 1)]
    for row in results(chosen, range(options.seed, options.seed + options.people), rows):
        rows.append(row)
        if options.rows is not None:
            with options.rows.open("a", encoding="utf-8") as file:
                file.write(json.dumps(row) + "\n")
    print("\n".join(lines(rows)))


if __name__ == "__main__":
    main()
