"""Prior knowledge of meals: how often they begin, which may depend on the time of day, and how large they are."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final

from glucoloop._lazy_jax import jax, jnp, np
from glucoloop._pytree import pytree
from glucoloop.arguments import checked
from glucoloop.meals.stomach import SERVED_G_PER_MIN
from glucoloop.refusal import Refusal
from glucoloop.units import HOURS_PER_DAY, MIN_PER_DAY, MIN_PER_H, number_of, parse_time_of_day

DailyValues = tuple[tuple[float, float], ...]
"""Times of day in minutes after midnight, in their order, and the value from each of them on until the next."""
_DAILY: Final = "write values and times, like '0.6@06:30 0.02@22:00', or 24 numbers, one for each hour"


@pytree
class DailyRates:
    """Periods of the day, each with one of a few rates; make it with `daily_rates`."""

    starts_min: jax.Array
    """(periods,) beginning of each period, in minutes after midnight; the last one ends as the first begins."""
    rate: jax.Array
    """(periods, rates) indicator of the rate of each period; the first rate is for a time that is not known."""

    def at(self, values: Any, time_of_day_min: jax.Array | None) -> Any:
        """Values at a time of day, of arrays with a first axis of rates; the first holds at an unknown time."""
        share = self._share(time_of_day_min)
        return jax.tree.map(lambda leaf: jnp.tensordot(share, leaf, axes=1), values)

    def _share(self, time_of_day_min: jax.Array | None) -> jax.Array:
        """Indicator ``(rates,)`` of the rate at a time of day."""
        unknown = jnp.zeros(self.rate.shape[1]).at[0].set(1.0)
        if time_of_day_min is None:
            return unknown
        begun = (time_of_day_min >= self.starts_min) * 1.0
        now = begun - jnp.append(begun[1:], 0.0)
        now = now.at[-1].add(1.0 - begun[0])  # before the first period the last one of yesterday goes on
        known = (time_of_day_min >= 0.0) & (time_of_day_min < MIN_PER_DAY)
        return jnp.where(known, now @ self.rate, unknown)


def earlier(time_of_day_min: jax.Array, minutes: float) -> jax.Array:
    """Time of day some minutes before a time of day."""
    then = time_of_day_min - minutes % MIN_PER_DAY
    return jnp.where(then < 0.0, then + MIN_PER_DAY, then)


def daily_rates(values: DailyValues, otherwise: float) -> tuple[DailyRates, tuple[float, ...]]:
    """Periods of the day, from their beginnings and rates in order, and the rates ``(rates,)`` that occur in them.

    The first of these is `otherwise`, which holds while the time of day is not known.
    """
    rates = (otherwise, *sorted({rate for _, rate in values} - {otherwise}))
    which = [rates.index(rate) for _, rate in values]
    return (
        DailyRates(
            starts_min=jnp.asarray([start_min for start_min, _ in values], float),
            rate=jnp.asarray(np.eye(len(rates))[which]),
        ),
        rates,
    )


@checked
@dataclass(frozen=True)
class MealHabits:
    """Prior of meals: how often they begin, which may depend on the time of day, and how soon they end.

    Parameters
    ----------
    meals_per_h : float
        Expected number of meals in an hour, above 0. A higher figure makes an estimator quicker and less certain.
    mean_carbs_g : float
        Mean size, above 0.
    by_time : str
        Expected number of meals in an hour by the time of day, where it is known, in place of `meals_per_h`: values and
        times like ``"0.6@06:30 0.02@22:00"``, each from its time on, or 24 numbers, one for each hour from midnight on.
        ``""``: the same at all times.

    Raises
    ------
    ValueError
        Outside these bounds, or for a text that is no table of a day.

    Examples
    --------
    >>> MealHabits(by_time="0.6@06:30 0.02@22:00").rates_per_h
    (0.57, 0.02, 0.6)
    """

    meals_per_h: float = 0.57
    mean_carbs_g: float = 20.0
    by_time: str = ""

    def __post_init__(self) -> None:
        for value, what in ((self.meals_per_h, "meals per hour"), (self.mean_carbs_g, "g of a mean meal")):
            if not 0.0 < value < math.inf:
                raise Refusal(f"{value:g} {what} are not possible; give a finite value above 0")
        for start_min, value in self._by_time:
            if not value > 0.0:
                hours, minutes = divmod(int(start_min), int(MIN_PER_H))
                raise Refusal(
                    f"{value:g} meals per hour from {hours:02d}:{minutes:02d} on are not possible; give a finite "
                    "value above 0, like 0.01 where hardly anybody eats"
                )

    @property
    def _by_time(self) -> DailyValues:
        if not self.by_time:
            return ()
        try:
            return parse_daily(self.by_time)
        except Refusal as error:
            raise Refusal(f"meals by the time of day cannot be read: {error}") from None

    @property
    def rates_per_h(self) -> tuple[float, ...]:
        """Expected numbers of meals in an hour that occur: `meals_per_h`, and those of `by_time`."""
        return self._daily[1]

    @property
    def daily(self) -> DailyRates | None:
        """Periods of the day with their rates among `rates_per_h`; None if the rate is the same at all times."""
        return self._daily[0]

    @property
    def _daily(self) -> tuple[DailyRates | None, tuple[float, ...]]:
        by_time = self._by_time
        return daily_rates(by_time, self.meals_per_h) if by_time else (None, (self.meals_per_h,))

    def begins(self, sample_time_min: float) -> float:
        """Probability that a meal begins in a sample, at a time of day that is not known."""
        return _begins(self.meals_per_h, sample_time_min)

    def begins_at_rates(self, sample_time_min: float) -> tuple[float, ...]:
        """Probability that a meal begins in a sample, for each of `rates_per_h`."""
        return tuple(_begins(rate, sample_time_min) for rate in self.rates_per_h)

    def ends(self, sample_time_min: float) -> float:
        """Probability that a meal under way ends in a sample."""
        return -math.expm1(-SERVED_G_PER_MIN * sample_time_min / self.mean_carbs_g)


def _begins(meals_per_h: float, sample_time_min: float) -> float:
    return -math.expm1(-meals_per_h * sample_time_min / 60.0)


def parse_daily(text: str) -> DailyValues:
    """Values by time of day from a text; the last of them holds until the first time of the next day.

    The text holds values with times, ``0.6@06:30 0.02@22:00``, or 24 numbers, one for each hour.
    """
    items = text.split()
    if not items:
        raise Refusal(f"there is no value for any time of day; {_DAILY}")
    timed = ["@" in item for item in items]
    if not any(timed):
        numbers = list(map(_finite, items))
        if len(numbers) != HOURS_PER_DAY:
            count = "1 number is" if len(numbers) == 1 else f"{len(numbers)} numbers are"
            raise Refusal(f"{count} not one for each hour of the day; {_DAILY}")
        return tuple((hour * MIN_PER_H, number) for hour, number in enumerate(numbers))
    if not all(timed):
        raise Refusal(f"{items[timed.index(False)]!r} has no time of day, unlike others; {_DAILY}")
    values: dict[float, float] = {}
    for item in items:
        value, _, time = item.partition("@")
        start_min = parse_time_of_day(time)
        if start_min in values:
            raise Refusal(f"the time {time} has two values; leave one out")
        values[start_min] = _finite(value)
    return tuple(sorted(values.items()))


def _finite(text: str) -> float:
    try:
        value = number_of(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise Refusal(f"{text!r} is no finite number; {_DAILY}")
    return value
