"""Long runs: in pieces they are the same to the bit, and what is counted over time does not grow with the days."""

from types import SimpleNamespace

import numpy as np
import pytest

from glucoloop.simulation import cohort
from glucoloop.situations.situation import configured
from glucoloop.trials import engine
from glucoloop.trials import people as people_in_blocks
from glucoloop.trials import trial as trials
from glucoloop.trials.engine import prepare, run_people
from glucoloop.trials.statistics import bin_numbers, glucose_edges, insulin_edges, times_pct
from glucoloop.trials.trial import Trial

KEYS = {
    "people": 3,
    "patient": "hovorka-2004",
    "controller": ["basal-bolus"],
    "announce_meals": True,
    "carb_error_pct": 20.0,
    "sensor": ["dexcom-g6"],
    "meal_time_spread_min": 30.0,
    "habits": ["snack, time=23.5h, probability=1, time_spread_min=60", "announced-late, minutes=20, spread_min=30"],
    "faults": ["missed-pulses, share=0.05"],
    "warm_up_min": 300.0,
}


@pytest.fixture(scope="module")
def trial():
    return configured(Trial, KEYS, days=2)


@pytest.fixture(scope="module")
def whole(trial):
    return run_people(prepare(trial), "basal-bolus", trial.shard(0), traces=True)


def count(values, edges):
    counts = np.zeros((len(values), edges.size - 1), np.int64)
    np.add.at(counts, (np.arange(len(values))[:, None], bin_numbers(values, edges)), 1)
    return counts


def same(one, other):
    np.testing.assert_array_equal(one.glucose_mg_dl, other.glucose_mg_dl)
    np.testing.assert_array_equal(one.insulin_mU_min, other.insulin_mU_min)
    for name, values in one.metrics.items():
        np.testing.assert_array_equal(values, other.metrics[name], err_msg=name)


@pytest.mark.long
@pytest.mark.parametrize("samples", [100, 47])
def test_a_run_in_pieces_is_the_run_to_the_bit(monkeypatch, trial, whole, samples):
    monkeypatch.setattr(cohort, "MAX_AT_ONCE", samples)
    monkeypatch.setattr(cohort, "_PEOPLE_AT_ONCE", 1)
    told = []
    pieces = run_people(prepare(trial), "basal-bolus", trial.shard(0), traces=True, done=told.append)
    same(pieces, whole)
    np.testing.assert_array_equal(pieces.glucose_counts, whole.glucose_counts)
    np.testing.assert_array_equal(pieces.insulin_counts, whole.insulin_counts)
    assert len(told) >= 576 // samples
    assert sum(told) == pytest.approx(3.0)


@pytest.mark.long
def test_a_person_is_the_same_in_a_block_of_any_number(monkeypatch, trial, whole):
    monkeypatch.setattr(people_in_blocks, "MIN_BLOCK", 1024)
    same(run_people(prepare(trial), "basal-bolus", trial.shard(0), traces=True), whole)


@pytest.mark.long
def test_the_other_engine_goes_on_from_a_piece_too(monkeypatch, trial):
    case = prepare(trial).cases["basal-bolus"]
    loop = engine.loop_of(
        trial, case.controller, prepare(trial).accumulator, surroundings=case.surroundings, engine="xla"
    )
    people = engine.people_of(trial, trial.shard(0))
    brought = engine.brought(trial, trial.drawn_days(trial.shard(0)))
    once = loop.run(people, **brought)
    monkeypatch.setattr(cohort, "MAX_AT_ONCE", 211)
    again = loop.run(people, **brought)
    np.testing.assert_allclose(again.glucose_mg_dl, once.glucose_mg_dl, rtol=1e-12)
    np.testing.assert_allclose(again.insulin_mU_min, once.insulin_mU_min, rtol=1e-12)


@pytest.mark.long
def test_a_long_run_is_counted_by_the_time_of_day(monkeypatch, trial, whole):
    monkeypatch.setattr(trials, "LONGEST_COUNTED_MIN", 1440.0)
    assert trial.one_day_of_counts
    assert trial.counted_samples == 288
    found = run_people(prepare(trial), "basal-bolus", trial.shard(0), traces=True)
    same(found, whole)
    glucose, insulin = np.asarray(found.glucose_mg_dl, float), np.asarray(found.insulin_mU_min, float)
    of_glucose, of_insulin = (
        count(glucose, glucose_edges()),
        count(insulin, insulin_edges(float(trial.limits.max_mU_min))),
    )
    # float32 traces may lie in the bin beside
    expected = of_glucose[:288] + of_glucose[288:576]
    assert found.glucose_counts.shape[0] == 289
    np.testing.assert_array_equal(found.week_counts, found.glucose_counts[:288].sum(axis=0, keepdims=True))
    assert np.abs(np.cumsum(found.glucose_counts[:288] - expected, axis=1)).sum() <= 2
    assert np.abs(np.cumsum(found.glucose_counts[288] - of_glucose[288] - of_glucose[576])).sum() <= 1
    assert np.abs(np.cumsum(found.insulin_counts - of_insulin[:288] - of_insulin[288:], axis=1)).sum() <= 2


@pytest.mark.parametrize("piece", [504, 2016, 1000])
def test_glucose_of_a_long_run_is_counted_by_week_too(piece):
    trial = configured(Trial, days=31)
    assert (trial.counted_weeks, trial.samples_a_week) == (5, 2016)
    glucose = np.random.default_rng(1).uniform(-20.0, 700.0, (trial.samples, 3))
    counts, feasible = engine._Counts(trial), np.array([True, False, True])
    for first in range(0, trial.samples, piece):
        some = glucose[first : first + piece]
        counts.add(first, some, np.ones_like(some), feasible)
    edges = glucose_edges()
    for week, found in enumerate(counts.weeks):
        of_week = np.clip(glucose[2016 * week : 2016 * (week + 1), feasible], edges[0], edges[-1])
        np.testing.assert_array_equal(found, np.histogram(of_week, edges)[0])
    low, high = glucose[:2016, feasible] < 70.0, glucose[:2016, feasible] >= 180.0
    shares = {name: share[0] for name, share in times_pct(counts.weeks).items()}
    assert shares["time_below_70_pct"] == pytest.approx(100.0 * low.mean())
    assert shares["time_above_180_pct"] == pytest.approx(100.0 * high.mean())
    assert shares["time_70_180_pct"] == pytest.approx(100.0 * (~low & ~high).mean())


@pytest.mark.parametrize(
    ("days", "people"), [(1, 1024), (8, 1024), (14, 512), (28, 256), (57, 128), (364, 64), (366, 64)]
)
def test_a_block_of_a_long_run_has_fewer_people(days, people):
    assert configured(Trial, days=days).people_a_block == people


def test_up_to_four_weeks_every_sample_is_counted_by_itself():
    assert configured(Trial, days=28).counted_samples == 28 * 288
    assert configured(Trial, days=29).counted_samples == 288
    assert configured(Trial, duration_min=50_000.0).counted_samples == 10_000


@pytest.mark.long
def test_who_does_not_stay_finite_is_not_counted(monkeypatch, trial, whole):
    prepared = prepare(trial)
    accumulator = prepared.accumulator
    finish = type(accumulator).finish

    def without_the_second(self, *args, **kwargs):
        values = finish(self, *args, **kwargs).by_name()
        mean = np.array(values["mean_mg_dl"])
        mean[1] = np.nan
        return SimpleNamespace(by_name=lambda: {**values, "mean_mg_dl": mean})

    monkeypatch.setattr(type(accumulator), "finish", without_the_second)
    found = run_people(prepared, "basal-bolus", trial.shard(0), traces=True)
    alone = count(np.asarray(whole.glucose_mg_dl[:, [0, 2]], float), glucose_edges())
    assert found.glucose_counts.sum() == 2 * 577
    assert np.abs(np.cumsum(found.glucose_counts - alone, axis=1)).sum() <= 2
