"""Basal rate that a pump really had, from what it logged: usual rates, temporary ones, suspensions."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Literal

_SAME_TIME = timedelta(minutes=1)


@dataclass(frozen=True, kw_only=True)
class BasalEvent:
    """One entry of the log of a pump about its basal rate."""

    row: int
    """Row of the file."""
    time: datetime
    what: Literal["usual", "absolute", "percent", "end", "suspend", "resume"]
    value: float = math.nan
    """Rate [U/h], or percentage of the usual rate."""
    minutes: float = math.inf
    """Duration of a temporary rate."""


def basal_rates(events: Iterable[BasalEvent]) -> list[tuple[int, datetime, float]]:
    """Row of the file, time and basal rate [U/h] of each change; NaN where the rate is not known from there on.

    A temporary rate ends after its duration or with the next one, and then the usual rate holds, which may be unknown.
    """
    rates: list[tuple[int, datetime, float]] = []
    usual, suspended = math.nan, False
    temporary: BasalEvent | None = None

    def rate() -> float:
        if suspended:
            return 0.0
        if temporary is None:
            return usual
        return temporary.value if temporary.what == "absolute" else usual * temporary.value / 100.0

    def end_of(event: BasalEvent) -> datetime:
        return event.time + timedelta(minutes=min(event.minutes, 1e7))

    for event in sorted(events, key=lambda event: event.time):
        if temporary is not None and end_of(temporary) <= event.time:
            ended, temporary = temporary, None
            if event.time - end_of(ended) > _SAME_TIME:
                rates.append((ended.row, end_of(ended), rate()))
        if event.what == "usual":
            usual = event.value
        elif event.what in ("absolute", "percent"):
            temporary = event
        elif event.what == "end":
            temporary = None
        else:
            suspended = event.what == "suspend"
        rates.append((event.row, event.time, rate()))
    if temporary is not None and math.isfinite(temporary.minutes):
        ended, temporary = temporary, None
        rates.append((ended.row, end_of(ended), rate()))
    return rates
