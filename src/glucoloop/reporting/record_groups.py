"""Records of glucose that are reported, one by one or as groups of people."""

from __future__ import annotations

import functools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from glucoloop.metrics.readings.catalogue import PeopleSpread, over_people
from glucoloop.metrics.readings.profile import DayProfile, day_profile
from glucoloop.metrics.readings.series import Readings
from glucoloop.reporting.record_goals import MIN_ACTIVE_PCT, MIN_DAYS
from glucoloop.text import how_many, percent, the_first

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
