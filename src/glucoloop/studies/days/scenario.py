"""Scenario in a file by the habits of a record: its keys are those of a configuration, its comments say what is behind.

Meals that are entered are the plan of a day; each has its spread, and is skipped on the days on which it is not eaten.
What is not entered is a snack of which nobody is told.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Final

from glucoloop.forecasts.grid import GriddedRecord
from glucoloop.studies.days.habits import LOW_ONSET_MG_DL, MIN_SHARE, RISE_MG_DL, RISE_MIN, Habits, Occasion
from glucoloop.text import how_many
from glucoloop.therapy import CARB_RULE
from glucoloop.units import MIN_PER_H

_ALWAYS: Final = 0.97
"""Share of the days from which on a meal counts as eaten on each."""
_SELDOM: Final = 0.02
"""Share of the days up to which another meal of the same occasion is left out."""
_SD_TO_HALF_WIDTH: Final = math.sqrt(3.0)
"""Half of the width of a uniform distribution over its standard deviation."""
_MOST_SPREAD_PCT, _MOST_SPREAD_MIN, _MOST_SD_MIN, _MOST_SD_PCT = 95.0, 360.0, 180.0, 200.0
_WIDTH: Final = 118


def scenario_text(habits: Habits, record: GriddedRecord) -> str:
    """Text of the file."""
    meals, skipped, varied = list[str](), list[str](), list[str]()
    for occasion, probability in _meals(habits.entered):
        text = f"{habits.eaten_over_entered * occasion.carbs_g:.3g}g@{occasion.time_min / MIN_PER_H:.2f}h"
        meals.append(f'    "{text}",  # on {_share(probability)} of the days')
        number = len(meals)
        sd_pct, sd_min = min(occasion.size_sd_pct, _MOST_SD_PCT), min(occasion.time_sd_min, _MOST_SD_MIN)
        varied.append(f"varied, meal={number}, size_sd={sd_pct:.0f}, time_sd={sd_min:.0f}")
        if probability < _ALWAYS:
            skipped.append(f"skipped, meal={number}, probability={1.0 - probability:.2f}")
    snacks = [_snack(occasion, probability) for occasion, probability in _meals(habits.not_entered)]
    lines = [
        *_comments(_head(habits, record)),
        f"days = {habits.days}",
        'start = "00:00"',
        "announce_meals = true",
        *_on_entries(habits, record),
        "meals = [",
        *meals,
        "]",
        "habits = [",
        *(f'    "{text}",' for text in varied),
        *_indented(f"Weekends: {habits.weekends_differ_by}."),
        *(f'    "{text}",' for text in _weekend(habits)),
        *(f'    "{text}",' for text in skipped),
        *_indented(_on_boluses(habits)),
        *(f'    "{text}",' for text in _missed(habits)),
        *_indented(_on_rises(habits)),
        *(f'    "{text}",' for text in snacks),
        "]",
        *_comments([_on_gaps(habits)]),
        *_events(habits),
    ]
    return "\n".join(lines) + "\n"


def _meals(occasions: tuple[Occasion, ...]) -> Iterator[tuple[Occasion, float]]:
    """Each occasion with the probability of its meal, and of a second one and more where there are some."""
    for occasion in occasions:
        for share in occasion.shares:
            if share >= _SELDOM:
                yield occasion, share


def _snack(occasion: Occasion, probability: float) -> str:
    size = min(_SD_TO_HALF_WIDTH * occasion.size_sd_pct, _MOST_SPREAD_PCT)
    time = min(_SD_TO_HALF_WIDTH * occasion.time_sd_min, _MOST_SPREAD_MIN)
    return (
        f"snack, time={occasion.time_min / MIN_PER_H:.2f}h, carbs={occasion.carbs_g:.3g}, "
        f"probability={probability:.2f}, size_spread={size:.0f}, time_spread={time:.0f}"
    )


def _weekend(habits: Habits) -> Iterator[str]:
    if habits.weekend is not None:
        yield f"weekend, size={habits.weekend.size_pct:.0f}, later={habits.weekend.later_min:.0f}"


def _missed(habits: Habits) -> Iterator[str]:
    if habits.without_bolus >= MIN_SHARE:
        yield f"unannounced, probability={habits.without_bolus:.2f}"
    if habits.late >= MIN_SHARE:
        yield f"announced-late, probability={habits.late:.2f}, minutes={habits.late_min:.0f}"


def _events(habits: Habits) -> Iterator[str]:
    if habits.gaps is not None:
        yield f'events = ["missing, per_day={habits.gaps.per_day:.2g}, duration={habits.gaps.duration_min:.0f}min"]'


def _head(habits: Habits, record: GriddedRecord) -> Iterator[str]:
    yield f"Days of a person, by {how_many(habits.days, 'day')} of a record of {how_many(record.days, 'day')}."
    yield "glucoloop trial, run, compare, stress and league live them with --scenario and the path of this file."
    yield (
        f"Entered: {habits.carbs_g_day:.0f} g of carbohydrate a day. Meals have the mean size and time of those of a "
        "part of the day, their standard deviations, and the share of the days on which they are eaten. Day 1 is a "
        "Monday."
    )
    yield (
        "Not learnt: errors of counting, since nobody knows what was eaten (give --carb-error); exercise, illness and "
        "alcohol, of which the record says nothing; how long eating takes."
    )


def _on_entries(habits: Habits, record: GriddedRecord) -> Iterator[str]:
    """Lines on what is eaten for what is entered."""
    factor = habits.eaten_over_entered
    if factor == 1.0:
        return
    yield from _comments(
        [
            f"A unit is given for {habits.carb_ratio_g_U:.3g} g that are entered, {record.total_daily_dose_U:.0f} U a "
            f"day; by the rule of {CARB_RULE:.0f} that is a unit for {factor * habits.carb_ratio_g_U:.3g} g. So meals "
            f"are {factor:.2g} times what is entered, here and for a bolus by the rule. To take entries for what is "
            "eaten, divide the meals by that."
        ]
    )


def _on_boluses(habits: Habits) -> str:
    return (
        f"Entered meals without a bolus within 30 min: {_share(habits.without_bolus)}. Entered after glucose rose by "
        f"30 mg/dl or more: {_share(habits.late)} more than at other moments. Shares under {_share(MIN_SHARE)} are "
        "left out."
    )


def _share(part: float) -> str:
    return f"{100.0 * part:.0f} %"


def _on_rises(habits: Habits) -> str:
    if not habits.rises:
        return f"No rise of glucose by {RISE_MG_DL:g} mg/dl or more in {RISE_MIN:g} min."
    return (
        f"Of {how_many(habits.rises, 'rise')} of glucose by {RISE_MG_DL:g} mg/dl or more in {RISE_MIN:g} min "
        f"{habits.rises_not_entered} have no carbohydrate entered near them. {habits.rises_from_low} of these begin "
        f"below {LOW_ONSET_MG_DL:g} mg/dl, as after carbohydrate against low glucose, and are left to --rescue. The "
        f"others are snacks here, of a gram for each {habits.raise_mg_dl_g:.1f} mg/dl by the rules of 1800 and 500; "
        "waking, stress or a failing set raise glucose too. Smaller ones are not seen."
    )


def _on_gaps(habits: Habits) -> str:
    if habits.gaps is None:
        return "The sensor is never off for 20 min or more."
    longer = f"; {how_many(habits.gaps.longer, 'gap')} of over a day left out" if habits.gaps.longer else ""
    return (
        f"The sensor is off for 20 min or more {habits.gaps.per_day:.2g} times a day, for "
        f"{habits.gaps.duration_min:.0f} min on average{longer}."
    )


def _comments(sentences: Iterator[str] | list[str]) -> list[str]:
    return [f"# {line}" for sentence in sentences for line in _wrapped(sentence, _WIDTH)]


def _indented(sentence: str) -> list[str]:
    return [f"    # {line}" for line in _wrapped(sentence, _WIDTH - 4)]


def _wrapped(sentence: str, width: int) -> list[str]:
    import textwrap

    return textwrap.wrap(sentence, width)
