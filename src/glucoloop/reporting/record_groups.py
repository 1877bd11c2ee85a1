"""Records of glucose that are reported, one by one or as groups, and the goals of the consensus of 2019.

References
----------
T. Battelino et al., "Clinical targets for continuous glucose monitoring data interpretation: recommendations from the
international consensus on time in range", Diabetes Care 42(8), 1593-1603, 2019.
"""

from __future__ import annotations

import functools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

from glucoloop.metrics.readings.catalogue import PeopleSpread, over_people
from glucoloop.metrics.readings.given import NOTHING_GIVEN, Amounts, Given, given_numbers, known_results
from glucoloop.metrics.readings.profile import DayProfile, day_profile
from glucoloop.metrics.readings.series import Readings
from glucoloop.reporting._style import RANGE_COLOURS
from glucoloop.text import how_many, percent, the_first

MIN_DAYS: Final = 14.0
MIN_ACTIVE_PCT: Final = 70.0
"""Minimum days, and minimum share of the readings, for which the consensus takes a record to stand for other days."""
HIGHEST_CV_PCT: Final = 36.0


class _Goal(NamedTuple):
    """Goal of the consensus for a number: less, or more, than a bound."""

    bound: float
    more: bool = False

    @property
    def text(self) -> str:
        """The goal in words."""
        return f"{'more' if self.more else 'less'} than {self.bound:g}\N{NO-BREAK SPACE}%"

    def reached(self, value: float) -> bool:
        """Whether a value is as aimed at."""
        return value > self.bound if self.more else value < self.bound


class _GlucoseRange(NamedTuple):
    """A range of the bar of times in ranges."""

    name: str
    bounds: str
    result: str
    colour: str


@dataclass(frozen=True)
class Goals:
    """Ranges and goals of one kind of people."""

    name: str
    target_mg_dl: tuple[float, float]
    ranges: tuple[_GlucoseRange, ...]
    """Ranges from the highest on; together they hold all readings."""
    goals: Mapping[str, _Goal]

    @property
    def lines(self) -> Iterator[_GlucoseRange]:
        """Ranges from the highest on, with the sums that have goals of their own, which have no name and no colour."""
        sums = [name for name in _SUMS if name in self.goals]
        for one in self.ranges:
            yield one
            side = {"Very low": "below", "High": "above_180"}.get(one.name)
            yield from (_GlucoseRange("", _SUMS[name], name, "") for name in sums if side and side in name)


_SUMS: Final = {
    "time_above_180_pct": "All above 180 mg/dl",
    "time_below_70_pct": "All below 70 mg/dl",
    "time_below_63_pct": "All below 63 mg/dl",
}
_COLOURS: Final = tuple(RANGE_COLOURS.values())
_RANGES: Final = (
    _GlucoseRange("Very high", "above 250 mg/dl", "time_above_250_pct", _COLOURS[4]),
    _GlucoseRange("High", "181 to 250 mg/dl", "time_180_250_pct", _COLOURS[3]),
    _GlucoseRange("Target", "70 to 180 mg/dl", "time_70_180_pct", _COLOURS[2]),
    _GlucoseRange("Low", "54 to 69 mg/dl", "time_54_70_pct", _COLOURS[1]),
    _GlucoseRange("Very low", "below 54 mg/dl", "time_below_54_pct", _COLOURS[0]),
)
_PREGNANCY: Final = (
    _GlucoseRange("High", "above 140 mg/dl", "time_above_140_pct", _COLOURS[3]),
    _GlucoseRange("Target", "63 to 140 mg/dl", "time_63_140_pct", _COLOURS[2]),
    _GlucoseRange("Low", "54 to 62 mg/dl", "time_54_63_pct", _COLOURS[1]),
    _GlucoseRange("Very low", "below 54 mg/dl", "time_below_54_pct", _COLOURS[0]),
)
GOALS: Final = {
    "adult": Goals(
        "adults with type 1 or type 2 diabetes",
        (70.0, 180.0),
        _RANGES,
        {
            "time_above_250_pct": _Goal(5.0),
            "time_above_180_pct": _Goal(25.0),
            "time_70_180_pct": _Goal(70.0, more=True),
            "time_below_70_pct": _Goal(4.0),
            "time_below_54_pct": _Goal(1.0),
        },
    ),
    "older": Goals(
        "older people or people at high risk",
        (70.0, 180.0),
        _RANGES,
        {
            "time_above_250_pct": _Goal(10.0),
            "time_70_180_pct": _Goal(50.0, more=True),
            "time_below_70_pct": _Goal(1.0),
        },
    ),
    "pregnancy": Goals(
        "pregnancy with type 1 diabetes",
        (63.0, 140.0),
        _PREGNANCY,
        {
            "time_above_140_pct": _Goal(25.0),
            "time_63_140_pct": _Goal(70.0, more=True),
            "time_below_63_pct": _Goal(4.0),
            "time_below_54_pct": _Goal(1.0),
        },
    ),
}
"""Ranges and goals of the consensus of 2019."""


_MAX_WARNED: Final = 3


@dataclass(frozen=True)
class ReportedRecord:
    """One record, or one period of it."""

    label: str
    readings: Readings
    numbers: Mapping[str, float]
    notes: Sequence[str] = ()
    group: str = ""
    """Group of people that it belongs to."""
    period: str = ""
    """Days that were asked for, in words."""
    given: Given = NOTHING_GIVEN
    """Insulin, carbohydrate and glucagon of the whole record."""

    @property
    def glucagon_ug(self) -> Amounts:
        """Doses of glucagon from the first reading to the last."""
        return self.given.glucagon_ug.within(self.readings)

    @property
    def dates(self) -> str:
        """First and last day."""
        first, last = (self.readings.date(int(self.readings.day[end])) for end in (0, -1))
        return first if first == last else f"{first} to {last}"

    @functools.cached_property
    def profile(self) -> DayProfile:
        """Percentiles over the day."""
        return day_profile(self.readings)

    @property
    def sufficient(self) -> bool:
        """Whether it is as long, in whole days, and as complete as the consensus asks for."""
        return round(self.numbers["days"]) >= MIN_DAYS and self.numbers["active_pct"] >= MIN_ACTIVE_PCT


@dataclass(frozen=True)
class ReportedGroup:
    """Records of several people, or of the same period of each."""

    label: str
    records: Sequence[ReportedRecord]

    @property
    def dates(self) -> str:
        """Number of its people."""
        return how_many(len(self.records), "person", "people")

    @property
    def glucagon_ug(self) -> Amounts:
        """Doses of all."""
        return Amounts.of_all(record.glucagon_ug for record in self.records)

    @functools.cached_property
    def spreads(self) -> Mapping[str, PeopleSpread]:
        """Spread of each number over the people."""
        return over_people([record.numbers for record in self.records])

    @property
    def numbers(self) -> Mapping[str, float]:
        """Mean of each number."""
        return {name: spread.mean for name, spread in self.spreads.items()}

    @property
    def medians(self) -> Mapping[str, float]:
        """Median of each number."""
        return {name: spread.median for name, spread in self.spreads.items()}

    @functools.cached_property
    def profile(self) -> DayProfile:
        """Percentiles over the day of the readings of all."""
        return day_profile(*(record.readings for record in self.records))


Reported = ReportedRecord | ReportedGroup


def with_given(records: Sequence[ReportedRecord]) -> list[ReportedRecord]:
    """Records with the numbers of insulin, carbohydrate and glucagon that any of them tells."""
    numbers = [given_numbers(one.given, one.readings) for one in records]
    names = [result.name for result in known_results(numbers)]
    return [
        replace(one, numbers={**one.numbers, **{name: of[name] for name in names}})
        for one, of in zip(records, numbers, strict=True)
    ]


def groups_of(records: Sequence[ReportedRecord]) -> list[ReportedGroup]:
    """Groups of records, in each period that was asked for, in the order of the records."""
    results: dict[str, list[ReportedRecord]] = {}
    for record in records:
        if record.group:
            results.setdefault(": ".join(filter(None, (record.group, record.period))), []).append(record)
    return [ReportedGroup(label, own) for label, own in results.items()]


def warnings(records: Sequence[ReportedRecord]) -> Iterator[str]:
    """Sentences on records that are too short or have too many gaps."""
    short = [record for record in records if not record.sufficient]
    config = f"at least {MIN_DAYS:g} days with {MIN_ACTIVE_PCT:g} % of the readings"
    if len(short) > _MAX_WARNED:
        yield (
            f"{len(short)} of {len(records)} records are shorter than the consensus asks for, or have more gaps: "
            f"{the_first([record.label for record in short])}. It asks for {config}, so the numbers of these may not "
            "stand for other days."
        )
        return
    for record in short:
        days, active = record.numbers["days"], percent(record.numbers["active_pct"])
        yield (
            f"{record.label} has {days:.1f} days with {active} of the readings. The consensus asks for {config}, so "
            "these numbers may not stand for other days."
        )
