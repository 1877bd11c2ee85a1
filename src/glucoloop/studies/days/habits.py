"""Habits of a person by a record: when and how much is eaten and entered, what is not entered, and sensor gaps.

Entered carbohydrate within half an hour is one meal. The times of day of all meals fall into *occasions*, such as
breakfast: the division of the ordered times into contiguous groups with the largest classification likelihood of normal
distributions, less the penalty of Schwarz for three numbers of each group (their number by the same criterion); times
of an occasion have a standard deviation of two hours at most where six occasions will do.

A *rise* is one of 60 mg/dl or more within 90 min. Without carbohydrate from an hour before its onset to its peak it is
taken for something that was eaten and not entered, unless it begins below 80 mg/dl, as after carbohydrate against low
glucose. How much was eaten follows from the rise: by the rule of 1800 a gram raises glucose by the correction factor
over the carbohydrate ratio, of which the share that two compartments of 40 min have absorbed by the peak is there.

Entries are in a unit of the person's own: who enters half of what is eaten has half the ratio. Where the ratio times
the daily dose is far from the rule of 500, meals are taken to be as much larger, or smaller, as it is off the rule.

A meal is *late* if glucose rises by 30 mg/dl or more in the hour before its entry, with no other meal in three hours;
from the share of such entries that of other moments with such a rise is taken off.

References
----------
C. Fraley, A. E. Raftery, "Model-based clustering, discriminant analysis, and density estimation", J. Am. Stat. Assoc.
97(458), 2002, 611-631: the number of groups by the criterion of Schwarz.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from glucoloop._lazy_jax import scipy
from glucoloop.forecasts.grid import SAMPLE_MIN, SAMPLES_PER_DAY, GriddedRecord, apart
from glucoloop.metrics.readings.series import LONGEST_FILLED_MIN, stretches
from glucoloop.refusal import Refusal
from glucoloop.text import how_many
from glucoloop.therapy import CARB_RULE, CORRECTION_RULE
from glucoloop.units import MIN_PER_DAY

Values = npt.NDArray[np.float64]
Places = npt.NDArray[np.int64]

MIN_DAYS: Final = 5
"""Minimum number of days with readings for half of the time."""
RISE_MG_DL: Final = 60.0
RISE_MIN: Final = 90.0
LOW_ONSET_MG_DL: Final = 80.0
"""Glucose below which a rise may follow carbohydrate eaten against low glucose."""
MIN_SHARE: Final = 0.1
"""Share of the meals from which on a habit is one."""
_MIN_ACTIVE: Final = 0.5
_ONE_MEAL: Final = 6
"""Samples, 30 min, within which entries are one meal."""
_WITH_BOLUS: Final = 6
_RISE: Final = round(RISE_MIN / SAMPLE_MIN)
_BEFORE: Final = 12
"""Samples, 1 h, before the onset of a rise in which its carbohydrate may be entered."""
_GOES_ON: Final = 12
"""Samples, 1 h, within which glucose has to rise further for the same rise to go on."""
_FURTHER_MG_DL: Final = 10.0
_MIN_GAP: Final = 4
"""Samples without a reading, 20 min, from which on the sensor is off."""
_LONGEST_GAP: Final = SAMPLES_PER_DAY
_LATE_MG_DL: Final = 30.0
"""Rise of glucose before an entry from which on it is late."""
_FLAT_MG_DL: Final = 5.0
"""Glucose above its minimum up to which a rise has not begun."""
_LATE: Final = 12
"""Samples, 1 h, in which this rise is looked for."""
_AFTER_ANOTHER: Final = 36
"""Samples, 3 h, in which another meal may be what raises glucose."""
_ONSET_MIN: Final = 15.0
"""Time from eating to the onset of the rise in the readings of a sensor."""
_GUT_MIN: Final = 40.0
_NEAR_THE_RULE: Final = (0.8, 1.25)
_MIN_EATEN, _MAX_EATEN = 0.5, 4.0
_MAX_OCCASIONS: Final = 6
_MIN_OF_OCCASION: Final = 3
_MIN_SD_MIN: Final = 20.0
"""Standard deviation of times below which groups are no better."""
_MAX_SD_MIN: Final = 120.0
"""Standard deviation of times above which a group is hardly one."""
_WIDE: Final = 5.0
"""Cost of that, a meal and unit of the logarithm of the variance above it."""
_MIN_ON_WEEKENDS: Final = 8
_WEEKEND_P: Final = 0.01
_SATURDAY: Final = 5


class Occasion(NamedTuple):
    """Meals of one time of day."""

    time_min: float
    """Mean time of the day at which they begin."""
    time_sd_min: float
    carbs_g: float
    """Mean size of them."""
    size_sd_pct: float
    shares: tuple[float, ...]
    """Share of the days with at least one of these meals, with at least two, and so on."""
    meals: int

    @property
    def per_day(self) -> float:
        """Mean number of these meals on a day."""
        return sum(self.shares)


class Gaps(NamedTuple):
    """Times without readings for 20 min or more, and a day at most."""

    per_day: float
    duration_min: float
    """Mean duration of a gap."""
    longer: int
    """Number of gaps of over a day, which are left out."""


class WeekendDifference(NamedTuple):
    """Difference of Saturday and Sunday."""

    size_pct: float
    later_min: float


class Rise(NamedTuple):
    """A rise of glucose by its samples."""

    onset: int
    peak: int
    size_mg_dl: float
    entered: bool
    """Whether carbohydrate is entered near it."""


@dataclass(frozen=True, kw_only=True)
class Habits:
    """Habits of a person by a record."""

    days: int
    """Number of days of the record that were used: with readings for half of the time or more."""
    carb_ratio_g_U: float
    """Carbohydrate for a unit of the boluses that were given with meals; by the rule of 500 where there are none."""
    eaten_over_entered: float
    """Carbohydrate that is eaten for a gram that is entered; 1 near the rule of 500."""
    raise_mg_dl_g: float
    """Rise of glucose by a gram that is eaten, by the rules."""
    entered: tuple[Occasion, ...]
    """Meals with carbohydrate as it is entered."""
    not_entered: tuple[Occasion, ...]
    without_bolus: float
    """Share of the entered meals without a bolus within 30 min."""
    bolus_alone: float
    """Share of the user's boluses without carbohydrate entered within 30 min."""
    late: float
    """Share of the entered meals before which glucose rises already."""
    late_min: float
    """Mean time from eating to the entry of these meals."""
    weekend: WeekendDifference | None
    """Difference of weekends; None where none can be told."""
    weekends_differ_by: str
    """Clause on what is known of weekends."""
    gaps: Gaps | None
    rises: int
    rises_not_entered: int
    rises_from_low: int
    """Rises without carbohydrate that begin below 80 mg/dl."""

    @property
    def carbs_g_day(self) -> float:
        """Entered carbohydrate of a day."""
        return sum(one.per_day * one.carbs_g for one in self.entered)


@dataclass(frozen=True)
class _Eaten:
    """Meals: day of the record, time of day and size of each."""

    day: Places
    time_min: Values
    carbs_g: Values

    def only(self, chosen: npt.NDArray[np.bool_]) -> _Eaten:
        return _Eaten(self.day[chosen], self.time_min[chosen], self.carbs_g[chosen])


def habits_of(record: GriddedRecord) -> Habits:
    """Habits by a record.

    Raises
    ------
    Refusal
        If fewer than five days have readings for half of the time, or there is no carbohydrate or no insulin.
    """
    gaps = _gaps(np.isfinite(record.reading_mg_dl))
    record = filled(record)
    readings = np.isfinite(record.reading_mg_dl).reshape(record.days, -1)
    used = readings.mean(axis=1) >= _MIN_ACTIVE
    days = int(used.sum())
    if days < MIN_DAYS:
        raise Refusal(
            f"it has {how_many(days, 'day')} with readings for half of the time; habits need {MIN_DAYS} or more, so "
            "give a longer record"
        )
    if not record.carbs_g.any():
        raise Refusal("it has no meals, so it does not tell how the person eats; give a record with carbohydrate")
    if not record.insulin_U.any():
        raise Refusal("it has no insulin, so it does not tell the therapy; give a record with boluses and basal rates")
    at = meals_of(record)
    at = at[used[at // SAMPLES_PER_DAY]]
    if at.size < _MIN_OF_OCCASION:
        raise Refusal(
            f"it has {how_many(at.size, 'meal')} on the days with readings; habits need {_MIN_OF_OCCASION} or more"
        )
    carbs_g = np.array([record.carbs_g[one : one + _ONE_MEAL].sum() for one in at])
    bolus = np.array([_near(record.user_bolus_U + record.automatic_bolus_U, one) for one in at])
    late, late_min = _late(record, at)
    eaten = _Eaten(at // SAMPLES_PER_DAY, _time_of_day(SAMPLE_MIN * (at + 0.5) - late_min), carbs_g)
    covered = bolus > 0.0
    ratio = float(carbs_g[covered].sum() / bolus[covered].sum()) if covered.any() else np.nan
    if not np.isfinite(ratio):
        ratio = CARB_RULE / record.total_daily_dose_U
    eaten_over_entered = CARB_RULE / (ratio * record.total_daily_dose_U)
    if _NEAR_THE_RULE[0] <= eaten_over_entered <= _NEAR_THE_RULE[1]:
        eaten_over_entered = 1.0
    eaten_over_entered = min(max(eaten_over_entered, _MIN_EATEN), _MAX_EATEN)
    raise_mg_dl_g = CORRECTION_RULE / (record.total_daily_dose_U * ratio * eaten_over_entered)
    rises = [rise for rise in rises_of(record) if used[rise.onset // SAMPLES_PER_DAY]]
    missing = [rise for rise in rises if not rise.entered]
    by_snack = [rise for rise in missing if record.reading_mg_dl[rise.onset] >= LOW_ONSET_MG_DL]
    weekend, in_words = _weekend(record, eaten)
    if weekend is not None:
        eaten = _as_on_weekdays(record, eaten, weekend)
    active = float(readings[used].mean())
    return Habits(
        days=days,
        carb_ratio_g_U=ratio,
        eaten_over_entered=eaten_over_entered,
        raise_mg_dl_g=raise_mg_dl_g,
        entered=_occasions(eaten, days),
        not_entered=_occasions(_of_rises(by_snack, raise_mg_dl_g), days * active),
        without_bolus=float(1.0 - covered.mean()),
        bolus_alone=_alone(record),
        late=late,
        late_min=float(late_min[late_min > 0.0].mean()) if late_min.any() else 0.0,
        weekend=weekend,
        weekends_differ_by=in_words,
        gaps=gaps,
        rises=len(rises),
        rises_not_entered=len(missing),
        rises_from_low=len(missing) - len(by_snack),
    )


def filled(record: GriddedRecord) -> GriddedRecord:
    """The record with glucose between readings that are at most 45 min apart, as those of some sensors always are."""
    there = np.flatnonzero(np.isfinite(record.reading_mg_dl))
    if not there.size:
        return record
    place = np.arange(record.reading_mg_dl.size)
    after = np.minimum(np.searchsorted(there, place), there.size - 1)
    apart = there[after] - there[np.maximum(after - 1, 0)]
    inside = (place > there[0]) & (place < there[-1]) & (apart <= LONGEST_FILLED_MIN / SAMPLE_MIN)
    glucose = np.interp(place, there, record.reading_mg_dl[there])
    readings = np.where(inside | np.isfinite(record.reading_mg_dl), glucose, np.nan)
    return dataclasses.replace(record, reading_mg_dl=readings)


def _time_of_day(t_min: npt.NDArray[Any]) -> Values:
    return np.asarray(np.mod(t_min, MIN_PER_DAY), np.float64)


def meals_of(record: GriddedRecord) -> Places:
    """Samples of the first entry of each meal, of which entries within half an hour are one."""
    return apart(np.flatnonzero(record.carbs_g > 0.0), _ONE_MEAL)


def _near(amount: Values, at: int) -> float:
    """Sum of an amount within 30 min of a sample."""
    return float(amount[max(at - _WITH_BOLUS, 0) : at + _WITH_BOLUS + 1].sum())


def _alone(record: GriddedRecord) -> float:
    """Share of the user's boluses without carbohydrate entered within 30 min; 0 where there are none."""
    boluses = np.flatnonzero(record.user_bolus_U > 0.0)
    return float(np.mean([not _near(record.carbs_g, int(at)) for at in boluses])) if boluses.size else 0.0


def _late(record: GriddedRecord, at: Places) -> tuple[float, Values]:
    """Share of the entries that are late, and time from eating to each entry, 0 for one in time."""
    n, entries = record.reading_mg_dl.size, np.concatenate([[0], np.cumsum(record.carbs_g > 0.0)])
    alone = entries[:-1] == entries[np.maximum(np.arange(n) - _AFTER_ANOTHER, 0)]
    padded = np.concatenate([np.full(_LATE, np.nan), record.reading_mg_dl])
    hour = np.lib.stride_tricks.sliding_window_view(padded, _LATE + 1)
    known = np.where(np.isfinite(hour), hour, np.inf)
    risen = record.reading_mg_dl - known.min(axis=1) >= _LATE_MG_DL  # false for a missing reading
    there = alone & np.isfinite(record.reading_mg_dl)
    other = there & (entries[np.minimum(np.arange(n) + _LATE, n)] == entries[:-1])
    by_chance = float(risen[other].mean()) if other.any() else 0.0
    of_entries = risen[at[there[at]]]
    share = (float(of_entries.mean()) - by_chance) / (1.0 - by_chance) if of_entries.size and by_chance < 1.0 else 0.0
    flat = hour[at] <= known.min(axis=1, keepdims=True)[at] + _FLAT_MG_DL
    since_onset = SAMPLE_MIN * np.argmax(flat[:, ::-1], axis=1)
    return max(share, 0.0), np.where((risen & alone)[at], since_onset + _ONSET_MIN, 0.0)


def rises_of(record: GriddedRecord) -> list[Rise]:
    """Rises of 60 mg/dl or more within 90 min, from their onset to their peak; one that goes on is one.

    Glucose is that of each sample, see `filled`.
    """
    readings, entries = record.reading_mg_dl, np.concatenate([[0], np.cumsum(record.carbs_g > 0.0)])
    result: list[Rise] = []
    sample = 0
    while sample + _RISE < readings.size:
        ahead = readings[sample : sample + _RISE + 1]
        if not np.nanmax(np.append(ahead, -np.inf)) - ahead[0] >= RISE_MG_DL:
            sample += 1
            continue
        peak = sample + int(np.nanargmax(ahead))
        onset = sample + int(np.flatnonzero(ahead[: peak - sample + 1] <= np.nanmin(ahead[: peak - sample + 1]))[-1])
        while True:
            further = readings[peak : peak + _GOES_ON + 1]
            if not np.nanmax(further) > readings[peak] + _FURTHER_MG_DL:
                break
            peak += int(np.nanargmax(further))
        entered = bool(entries[peak + 1] > entries[max(onset - _BEFORE, 0)])
        result.append(Rise(onset, peak, float(readings[peak] - readings[onset]), entered))
        sample = peak
    return result


def _of_rises(rises: Sequence[Rise], raise_mg_dl_g: float) -> _Eaten:
    """Meals that rises tell of."""
    onset = np.array([rise.onset for rise in rises], np.int64)
    over = SAMPLE_MIN * np.array([rise.peak - rise.onset for rise in rises]) + _ONSET_MIN
    absorbed = 1.0 - (1.0 + over / _GUT_MIN) * np.exp(-over / _GUT_MIN)
    carbs_g = np.array([rise.size_mg_dl for rise in rises]) / (absorbed * raise_mg_dl_g)
    return _Eaten(onset // SAMPLES_PER_DAY, _time_of_day(SAMPLE_MIN * (onset + 1.0) - _ONSET_MIN), carbs_g)


def _occasions(eaten: _Eaten, days: float) -> tuple[Occasion, ...]:
    """Occasions of meals in the order of the day."""
    if not eaten.day.size:
        return ()
    begin_min = _quietest_min(eaten.time_min)
    since = _time_of_day(eaten.time_min - begin_min)
    order = np.argsort(since, kind="stable")
    result = []
    for group in np.split(order, divisions(since[order])):
        sizes = eaten.carbs_g[group]
        result.append(
            Occasion(
                time_min=float(np.mod(begin_min + since[group].mean(), MIN_PER_DAY)),
                time_sd_min=float(since[group].std()),
                carbs_g=float(sizes.mean()),
                size_sd_pct=float(100.0 * sizes.std() / sizes.mean()),
                shares=_shares(eaten.day[group], days),
                meals=int(group.size),
            )
        )
    return tuple(sorted(result))


def _shares(day: Places, days: float) -> tuple[float, ...]:
    """Share of the days with at least one meal, with at least two, and so on, of the days of meals."""
    _, counts = np.unique(day, return_counts=True)
    return tuple(min(1.0, int((counts > number).sum()) / days) for number in range(int(counts.max())))


def _quietest_min(time_min: Values) -> float:
    """Middle of the longest time of day without meals."""
    ordered = np.sort(time_min)
    gaps = np.diff(ordered, append=ordered[0] + MIN_PER_DAY)
    longest = int(np.argmax(gaps))
    return float(np.mod(ordered[longest] + gaps[longest] / 2.0, MIN_PER_DAY))


def divisions(ordered: Values) -> Places:
    """Places at which ordered times are divided into occasions."""
    n = ordered.size
    sums, squares = (np.concatenate([[0.0], np.cumsum(values)]) for values in (ordered, ordered**2))
    penalty = 1.5 * math.log(n)
    cost = np.full((_MAX_OCCASIONS + 1, n + 1), np.inf)
    before = np.zeros((_MAX_OCCASIONS + 1, n + 1), np.int64)
    cost[0, 0] = 0.0
    for end in range(min(_MIN_OF_OCCASION, n), n + 1):
        begins = np.arange(0, end - min(_MIN_OF_OCCASION, n) + 1)
        size = (end - begins).astype(np.float64)
        mean = (sums[end] - sums[begins]) / size
        variance = (squares[end] - squares[begins]) / size - mean**2
        own = size * (0.5 * np.log(np.maximum(variance, _MIN_SD_MIN**2)) - np.log(size / n)) + penalty
        own += _WIDE * size * np.log(np.maximum(variance / _MAX_SD_MIN**2, 1.0))
        for groups in range(1, _MAX_OCCASIONS + 1):
            total = cost[groups - 1, begins] + own
            best = int(np.argmin(total))
            cost[groups, end], before[groups, end] = total[best], begins[best]
    groups, end = int(np.argmin(cost[:, n])), n
    places: list[int] = []
    while groups > 1:
        end = int(before[groups, end])
        places.append(end)
        groups -= 1
    return np.array(places[::-1], np.int64)


def _on_weekends(record: GriddedRecord, eaten: _Eaten) -> npt.NDArray[np.bool_]:
    result: npt.NDArray[np.bool_] = (record.first.weekday() + eaten.day) % 7 >= _SATURDAY
    return result


def _weekend(record: GriddedRecord, eaten: _Eaten) -> tuple[WeekendDifference | None, str]:
    """Difference of weekends where both size and time, each within its occasion, do not show it by chance."""
    there = _on_weekends(record, eaten)
    weekends = np.unique(eaten.day[there]).size
    if weekends < 4 or there.sum() < _MIN_ON_WEEKENDS or (~there).sum() < _MIN_ON_WEEKENDS:
        return None, f"there are {how_many(weekends, 'day')} of weekends with meals, too few to tell a difference"
    begin_min = _quietest_min(eaten.time_min)
    since = _time_of_day(eaten.time_min - begin_min)
    order = np.argsort(since, kind="stable")
    later, size = np.empty(since.size), np.empty(since.size)
    for group in np.split(order, divisions(since[order])):
        later[group] = since[group] - since[group].mean()
        size[group] = np.log(eaten.carbs_g[group]) - np.log(eaten.carbs_g[group]).mean()
    differences = []
    for values in (size, later):
        clear = scipy.stats.ttest_ind(values[there], values[~there], equal_var=False).pvalue < _WEEKEND_P
        differences.append(float(values[there].mean() - values[~there].mean()) if clear else 0.0)
    if not any(differences):
        return None, f"{how_many(weekends, 'day')} of weekends do not differ from the others more than by chance"
    weekend = WeekendDifference(100.0 * math.exp(differences[0]), differences[1])
    return weekend, f"by {how_many(weekends, 'day')} of weekends"


def _as_on_weekdays(record: GriddedRecord, eaten: _Eaten, weekend: WeekendDifference) -> _Eaten:
    there = _on_weekends(record, eaten)
    return dataclasses.replace(
        eaten,
        time_min=_time_of_day(eaten.time_min - weekend.later_min * there),
        carbs_g=eaten.carbs_g / np.where(there, weekend.size_pct / 100.0, 1.0),
    )


def _gaps(there: npt.NDArray[np.bool_]) -> Gaps | None:
    """Gaps between the first and the last reading."""
    inside = there[np.argmax(there) : there.size - np.argmax(there[::-1])]
    lengths = np.array([after - first for first, after in stretches(~inside)], int)
    lengths = lengths[lengths >= _MIN_GAP]
    kept = lengths[lengths <= _LONGEST_GAP]
    if not kept.size:
        return None
    days = (inside.size - int(lengths[lengths > _LONGEST_GAP].sum())) / SAMPLES_PER_DAY
    return Gaps(kept.size / days, SAMPLE_MIN * float(kept.mean()), int(lengths.size - kept.size))
