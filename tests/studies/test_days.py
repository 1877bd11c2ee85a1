"""Habits of a record: what was drawn is learnt again, and the scenario that is written gives it again."""

import itertools
import math
import tomllib

import numpy as np
import pytest

from forecast_records import gridded
from glucoloop.forecasts.grid import SAMPLES_PER_DAY, gridded_record
from glucoloop.refusal import Refusal
from glucoloop.situations.run import Run
from glucoloop.situations.situation import configured
from glucoloop.studies.days.habits import divisions, filled, habits_of, rises_of
from glucoloop.studies.days.scenario import scenario_text
from glucoloop.trials.trial import Trial
from lived_records import lived

BREAKFAST, LUNCH, DINNER = (450.0, 50.0, 0.9), (765.0, 60.0, 1.0), (1110.0, 80.0, 0.8)
"""Time of day, carbohydrate and probability of each meal."""


def eaten(days=28, seed=3, *, later_min=20.0, spread_g=10.0, weekend_g=0.0):
    """Record of flat glucose with meals that are drawn, each with a bolus of 1 U for 10 g, and the meals themselves."""
    random = np.random.default_rng(seed)
    carbs_g, meals = np.zeros(days * SAMPLES_PER_DAY), []
    for day, (number, (at_min, grams, probability)) in itertools.product(
        range(days), enumerate((BREAKFAST, LUNCH, DINNER))
    ):
        if random.random() < probability:
            time = at_min + later_min * random.standard_normal()
            size = grams + spread_g * np.clip(random.standard_normal(), -2.0, 2.0) + weekend_g * (day % 7 > 4)
            sample = day * SAMPLES_PER_DAY + int(time // 5)
            carbs_g[sample] = size
            meals.append((number, 5.0 * (sample % SAMPLES_PER_DAY) + 2.5, size))
    readings = np.full(carbs_g.size, 120.0)
    return gridded(readings, basal_U=np.full(carbs_g.size, 20.0 / 288), bolus_U=carbs_g / 10.0, carbs_g=carbs_g), meals


def test_occasions_are_the_meals_that_were_drawn():
    record, meals = eaten()
    habits = habits_of(record)
    assert len(habits.entered) == 3
    for number, occasion in enumerate(habits.entered):
        times, sizes = np.array([(time, size) for which, time, size in meals if which == number]).T
        assert occasion.meals == times.size
        assert occasion.time_min == pytest.approx(times.mean())
        assert occasion.time_sd_min == pytest.approx(times.std())
        assert occasion.carbs_g == pytest.approx(sizes.mean())
        assert occasion.size_sd_pct == pytest.approx(100.0 * sizes.std() / sizes.mean())
        assert occasion.per_day == pytest.approx(times.size / 28)
    assert (habits.without_bolus, habits.late, habits.gaps, habits.weekend) == (0.0, 0.0, None, None)
    assert habits.carb_ratio_g_U == pytest.approx(10.0)


def cost(groups, n):
    """Cost of a division in plain Python: the classification likelihood and the penalty of Schwarz."""
    total = 0.0
    for group in groups:
        mean = sum(group) / len(group)
        variance = sum((one - mean) ** 2 for one in group) / len(group)
        total += len(group) * (0.5 * math.log(max(variance, 400.0)) - math.log(len(group) / n)) + 1.5 * math.log(n)
        total += 5.0 * len(group) * max(0.0, math.log(variance / 14400.0)) if variance > 0.0 else 0.0
    return total


def test_a_division_is_the_best_of_all():
    random = np.random.default_rng(0)
    for spread in (10.0, 60.0, 200.0):
        times = np.sort(
            np.concatenate([centre + spread * random.standard_normal(4) for centre in (300.0, 700.0, 1200.0)])
        )
        every = [
            [list(part) for part in np.split(times, places)]
            for number in range(4)
            for places in itertools.combinations(range(1, 12), number)
        ]
        possible = [groups for groups in every if min(map(len, groups)) >= 3]
        best = min(possible, key=lambda groups: cost(groups, times.size))
        assert [list(part) for part in np.split(times, divisions(times))] == best


def test_meals_on_weekends_are_larger_where_they_are():
    record, _ = eaten(weekend_g=40.0)
    weekend = habits_of(record).weekend
    assert weekend is not None
    assert 140.0 < weekend.size_pct < 185.0
    assert weekend.later_min == 0.0
    assert habits_of(eaten(days=7)[0]).weekends_differ_by.endswith("too few to tell a difference")


def bump(at, size_mg_dl, *, days=6, entered=(), level_mg_dl=120.0):
    """Record in which glucose rises by an amount in an hour from each sample on, and falls in two."""
    readings = np.full(days * SAMPLES_PER_DAY, level_mg_dl)
    shape = size_mg_dl * np.concatenate([np.linspace(0.0, 1.0, 13), np.linspace(1.0, 0.0, 25)[1:]])
    for sample in at:
        readings[sample : sample + shape.size] += shape
    carbs_g = np.zeros(readings.size)
    carbs_g[list(entered)] = 40.0
    flat = np.full(readings.size, 40.0 / 288)
    return gridded(readings, basal_U=flat, bolus_U=carbs_g / 12.5, carbs_g=carbs_g)


def test_a_rise_is_entered_or_not():
    places = [100, 400, 700, 1000]
    rises = rises_of(bump(places, 90.0, entered=(95, 710)))
    assert [(rise.onset, rise.peak) for rise in rises] == [(place, place + 12) for place in places]
    assert [rise.entered for rise in rises] == [True, False, True, False]
    assert [rise.size_mg_dl for rise in rises] == pytest.approx([90.0] * 4)
    assert rises_of(bump(places, 59.0)) == []


def test_what_was_not_entered_is_as_much_as_its_rise_tells():
    """40 U of basal insulin a day and 12.5 g/U: the rule of 500, so that a gram raises glucose by 1800 / 500 mg/dl."""
    at = [day * SAMPLES_PER_DAY + 192 for day in range(6)]
    habits = habits_of(bump(at, 90.0, entered=[one - 100 for one in at]))
    [snack] = habits.not_entered
    absorbed = 1.0 - (1.0 + 75.0 / 40.0) * math.exp(-75.0 / 40.0)
    assert habits.eaten_over_entered == 1.0
    daily_U = 40.0 + 40.0 / 12.5
    assert snack.carbs_g == pytest.approx(90.0 / (absorbed * 1800.0 / daily_U / 12.5))
    assert snack.time_min == pytest.approx(192 * 5.0 + 5.0 - 15.0)
    assert snack.per_day == pytest.approx(1.0)
    low = habits_of(bump(at, 90.0, entered=[one - 100 for one in at], level_mg_dl=70.0))
    assert (low.rises_from_low, low.not_entered) == (6, ())


def test_entries_far_from_the_rule_are_in_a_unit_of_their_own():
    at = [day * SAMPLES_PER_DAY + 192 for day in range(6)]
    record = bump(at, 90.0, entered=[one - 100 for one in at])
    habits = habits_of(
        gridded(record.reading_mg_dl, basal_U=record.basal_U, carbs_g=record.carbs_g, bolus_U=record.carbs_g / 4.0)
    )
    assert habits.eaten_over_entered == pytest.approx(500.0 / (4.0 * 50.0))
    keys = tomllib.loads(scenario_text(habits, record))
    assert float(keys["meals"][0].partition("g@")[0]) == pytest.approx(40.0 * 2.5)


def test_meals_without_a_bolus_and_gaps_are_told():
    record, meals = eaten()
    bolus_U = record.user_bolus_U.copy()
    without = np.flatnonzero(bolus_U)[::4]
    bolus_U[without] = 0.0
    readings = record.reading_mg_dl.copy()
    for day in range(2, 28, 4):
        readings[day * SAMPLES_PER_DAY : day * SAMPLES_PER_DAY + 20] = np.nan
    habits = habits_of(gridded(readings, basal_U=record.basal_U, bolus_U=bolus_U, carbs_g=record.carbs_g))
    assert habits.without_bolus == pytest.approx(without.size / len(meals))
    assert habits.bolus_alone == 0.0
    boluses = np.flatnonzero(bolus_U)
    carbs_g = record.carbs_g.copy()
    for at in boluses[::5]:
        carbs_g[at - 6 : at + 7] = 0.0
    fewer = habits_of(gridded(readings, basal_U=record.basal_U, bolus_U=bolus_U, carbs_g=carbs_g))
    assert fewer.bolus_alone == pytest.approx(boluses[::5].size / boluses.size)
    assert habits.gaps is not None
    assert habits.gaps.per_day == pytest.approx(7 / 28)
    assert habits.gaps.duration_min == pytest.approx(100.0)


def test_a_sensor_that_reads_every_quarter_of_an_hour_tells_the_same():
    record = bump([100, 400, 700, 1000], 90.0, entered=(95, 710))
    readings = np.where(np.arange(record.reading_mg_dl.size) % 3 == 0, record.reading_mg_dl, np.nan)
    sparse = gridded(readings, basal_U=record.basal_U, bolus_U=record.user_bolus_U, carbs_g=record.carbs_g)
    rises = rises_of(filled(sparse))
    assert [rise.entered for rise in rises] == [True, False, True, False]
    assert [rise.size_mg_dl for rise in rises] == pytest.approx([90.0] * 4, abs=10.0)
    readings[500:520] = np.nan
    assert np.isnan(filled(gridded(readings)).reading_mg_dl[501:519]).all()
    assert filled(gridded(np.full(576, np.nan))).reading_mg_dl.size == 576


def test_an_entry_after_a_rise_is_late():
    at = [day * SAMPLES_PER_DAY + 144 for day in range(6)]
    habits = habits_of(bump(at, 90.0, entered=[one + 8 for one in at]))
    assert habits.late > 0.9
    assert habits.late_min == pytest.approx(15.0 + 40.0, abs=5.0)


def test_a_record_has_to_tell_habits():
    record, _ = eaten(days=4)
    with pytest.raises(Refusal, match="4 days with readings for half of the time; habits need 5 or more"):
        habits_of(record)
    record, _ = eaten()
    with pytest.raises(Refusal, match="no meals"):
        habits_of(gridded(record.reading_mg_dl, basal_U=record.basal_U))
    with pytest.raises(Refusal, match="no insulin"):
        habits_of(gridded(record.reading_mg_dl, carbs_g=record.carbs_g))


def test_the_scenario_has_what_was_learnt(tmp_path):
    record, _ = eaten()
    habits = habits_of(record)
    (tmp_path / "days.toml").write_text(scenario_text(habits, record))
    trial = configured(Trial, {"patient": "hovorka-2004", "scenario": str(tmp_path / "days.toml")})
    days = trial.drawn_days(np.arange(400))
    meals = days.announced_g > 0.0
    assert meals.sum() / (28 * 400) == pytest.approx(sum(one.per_day for one in habits.entered), rel=0.02)
    grams = days.announced_g.sum() / (28 * 400)
    assert grams == pytest.approx(habits.eaten_over_entered * habits.carbs_g_day, rel=0.02)
    for number, occasion in enumerate(habits.entered):
        own = (days.which == number)[:, None] & meals
        clock = np.mod(days.t_min[own], 1440.0)
        assert clock.mean() == pytest.approx(occasion.time_min, abs=2.0)
        assert clock.std() == pytest.approx(occasion.time_sd_min, rel=0.05)
        assert days.carbs_g[own].std() / days.carbs_g[own].mean() == pytest.approx(
            occasion.size_sd_pct / 100.0, rel=0.05
        )


KNOWN = {
    "meals": ["45g@7.5h", "60g@12.5h", "70g@18.5h"],
    "meal_size_spread_pct": 0.0,
    "habits": [
        {"name": "varied", "meal": 1, "size_sd_pct": 25.0, "time_sd_min": 30.0},
        {"name": "varied", "meal": 2, "size_sd_pct": 40.0, "time_sd_min": 45.0},
        {"name": "varied", "meal": 3, "size_sd_pct": 30.0, "time_sd_min": 60.0},
        {"name": "skipped", "meal": 1, "probability": 0.3},
        {"name": "unannounced", "probability": 0.3},
    ],
    "rescue": {"name": "carbs"},
    "events": [{"name": "missing", "per_day": 0.5, "duration_min": 90.0}],
}


@pytest.mark.long
@pytest.mark.parametrize(("patient", "people"), [("hovorka-2004", "boiroux2017"), ("uva-padova-2008", "lognormal")])
def test_a_life_that_is_known_is_learnt_from_its_record(patient, people):
    """The person's own meals are those that the loop was given, not those that its record tells."""
    record, _ = lived(patient, people, 1, days=28, time_spread_min=0.0, **KNOWN)
    run = configured(Run, {"patient": patient, "days": 28, "announce_meals": True, "seed": 1, **KNOWN})
    days = run.drawn_days([0])
    habits = habits_of(gridded_record(record))
    entered, eaten_at = days.announced_g[:, 0] > 0.0, days.carbs_g[:, 0] > 0.0
    assert sum(one.meals for one in habits.entered) == entered.sum()
    for number, occasion in enumerate(habits.entered):
        own = (days.which == number) & entered
        assert occasion.carbs_g == pytest.approx(days.carbs_g[own, 0].mean(), rel=0.1)
        assert occasion.time_min == pytest.approx(np.mod(days.t_min[own, 0], 1440.0).mean(), abs=10.0)
    not_entered = (eaten_at & ~entered).sum() / 28
    assert sum(one.per_day for one in habits.not_entered) == pytest.approx(not_entered, rel=0.35)
    assert habits.late < 0.1
    assert habits.gaps is not None
    assert habits.gaps.duration_min == pytest.approx(90.0, abs=15.0)
