"""Therapy of a person: the profile that whoever doses insulin knows, and the action of rapid-acting insulin.

It stands below patients and controllers, so that a population can hold a profile and a controller can ask for it
without knowing a patient.

References
----------
J. Walsh, R. Roberts, T. Bailey, "Guidelines for optimal bolus calculator settings in adults", J. Diabetes Sci. Technol.
5(1), 2011, 129-135 (the rules of 500 and 1800 and their variants).
The exponential curve of action is that of D. Maksimovic (2017), which oref0 (`lib/iob/calculate.js`) and LoopKit
(`ExponentialInsulinModel`) use. It is given by the time at which the action is largest and that at which it ends.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
from typing import Any, Final, NamedTuple

from glucoloop._lazy_jax import jax, jnp
from glucoloop._pytree import pytree
from glucoloop.units import MIN_PER_DAY, MU_PER_U

CARB_RULE: Final = 500.0
"""Carbohydrate [g] that 1 U covers, times the total daily dose [U]; 450 to 500 are in use."""
CORRECTION_RULE: Final = 1800.0
"""Fall of glucose [mg/dl] by 1 U, times the total daily dose [U]; 1700 to 1960 are in use."""
BASAL_SHARE: Final = 0.5
"""Part of the total daily dose that is the basal rate."""
_MIN_DAILY_BASAL_U: Final = 0.5
"""Minimum daily basal dose that the rules take, so that a person without a basal rate has finite numbers."""


@pytree
class Profile:
    """Profile of one person, or of people ``(people,)``; None is known of nobody, and NaN is not known of the person.

    The basal rate and the setpoint are always known: where no table gives them, they are those at which the person
    rests.
    """

    basal_mU_min: Any
    setpoint_mg_dl: Any
    carb_ratio_g_U: Any = None
    """Carbohydrate that 1 U covers."""
    correction_mg_dl_U: Any = None
    """Fall of glucose by 1 U."""
    weight_kg: Any = None
    total_daily_dose_U: Any = None
    past_basal_mU_min: Any = None
    """Basal rate of a schedule that held since the last sample; None where the basal rate is constant."""
    max_daily_basal_mU_min: Any = None
    """Largest basal rate of the day of a schedule; None where the basal rate is constant."""
    own_basal_mU_min: Any = None
    """Basal rate without the schedule; None where the basal rate is constant."""

    def daily_dose_U(self) -> jax.Array:
        """Total daily dose; where it is not known, twice the daily basal dose."""
        basal_U = jnp.asarray(self.basal_mU_min) * (MIN_PER_DAY / MU_PER_U)
        by_basal = jnp.maximum(basal_U, _MIN_DAILY_BASAL_U) / BASAL_SHARE
        return _known(self.total_daily_dose_U, by_basal)

    def carb_ratio(self) -> jax.Array:
        """Carbohydrate that 1 U covers [g/U]; where it is not known, by the rule of 500."""
        return _known(self.carb_ratio_g_U, CARB_RULE / self.daily_dose_U())

    def correction_factor(self) -> jax.Array:
        """Fall of glucose by 1 U [mg/dl/U]; where it is not known, by the rule of 1800."""
        return _known(self.correction_mg_dl_U, CORRECTION_RULE / self.daily_dose_U())

    def like(self, other: Profile) -> Profile:
        """The same profile of one person with just the fields that another one has; NaN where they are not known."""
        own = {name: getattr(self, name) for name in other.by_name()}
        return Profile(**{name: jnp.nan if value is None else value for name, value in own.items()})

    def by_name(self) -> dict[str, Any]:
        """The fields that are known of anybody, by name."""
        return {
            field.name: value for field in dataclasses.fields(self) if (value := getattr(self, field.name)) is not None
        }


def _known(value: Any, otherwise: jax.Array) -> jax.Array:
    """A value where it is known, and another one elsewhere."""
    return otherwise if value is None else jnp.where(jnp.isnan(value), otherwise, value)


class TherapyChange(NamedTuple):
    """A number of a therapy in some hours of each day: a value, or a factor on what holds without it."""

    field: str
    """``basal_mU_min``, ``carb_ratio_g_U``, ``correction_mg_dl_U`` or `TARGET`."""
    from_min: float
    """Time of day at which it begins."""
    to_min: float
    """Time of day at which it ends, on the next day if that is not later; 0 and 1440 are the whole day."""
    value: float | None = None
    """The value, or None for a factor."""
    factor: float = 1.0
    temporary: bool = False
    """Whether it is a temporary target, as of an override, and not one of the therapy."""

    @property
    def all_day(self) -> bool:
        """Whether it holds at every time of day."""
        return self.from_min == 0.0 and self.to_min == MIN_PER_DAY

    def holds(self, time_of_day_min: float) -> bool:
        """Whether it holds at a time of day."""
        if self.from_min < self.to_min:
            return self.from_min <= time_of_day_min < self.to_min
        return time_of_day_min >= self.from_min or time_of_day_min < self.to_min


TARGET: Final = "target_mg_dl"
"""Field of a change of the target, which is no part of a profile."""


class Schedule(NamedTuple):
    """Therapy by the time of day: changes of a profile, of which later ones act on what earlier ones leave."""

    changes: tuple[TherapyChange, ...] = ()

    @property
    def by_clock(self) -> bool:
        """Whether anything depends on the time of day."""
        return not all(change.all_day for change in self.changes)

    def starts_min(self, sample_time_min: float = 0.0) -> tuple[float, ...]:
        """Times of day from which each segment holds, the first of them 0.

        The first sample of each new segment is one of its own, since another basal rate held before it.
        """
        timed = [change for change in self.changes if not change.all_day]
        ends = {time % MIN_PER_DAY for change in timed for time in (change.from_min, change.to_min)}
        after = {(end + sample_time_min) % MIN_PER_DAY for end in ends} if self.varies("basal_mU_min") else set()
        return tuple(sorted({0.0, *ends, *after}))

    def varies(self, field: str) -> bool:
        """Whether any change concerns a field."""
        return any(change.field == field for change in self.changes)

    def value(self, field: str, own: Any, time_of_day_min: float, *, values_alone: bool = False) -> Any:
        """Value of a field at a time of day, from that without the schedule; `values_alone` leaves factors out."""
        for change in self.changes:
            if change.field == field and change.holds(time_of_day_min % MIN_PER_DAY):
                if change.value is not None:
                    own = change.value + jnp.zeros_like(jnp.asarray(own))
                elif not values_alone:
                    own = own * change.factor
        return own

    def temporary(self, time_of_day_min: float) -> bool:
        """Whether the target at a time of day is a temporary one."""
        result = False
        for change in self.changes:
            if change.field == TARGET and change.holds(time_of_day_min):
                result = change.temporary or (result and change.value is None)
        return result

    def profiles(self, profile: Profile, sample_time_min: float) -> tuple[Profile, ...]:
        """Profile of each segment, whose daily dose is that of all segments.

        Factors on the basal rate, as of an override, do not change the daily dose from which unknown ratios follow.
        """
        starts, basal = self.starts_min(sample_time_min), profile.basal_mU_min
        changes: dict[str, Any] = {}
        if self.varies("basal_mU_min"):
            minutes = [end - start for start, end in itertools.pairwise((*starts, MIN_PER_DAY))]
            rates = [self.value("basal_mU_min", basal, start, values_alone=True) for start in starts]
            # in this form the mean of equal rates is that rate, to the bit
            mean = rates[0] + sum((r - rates[0]) * t for r, t in zip(rates, minutes, strict=True)) / MIN_PER_DAY
            by_mean = dataclasses.replace(profile, basal_mU_min=mean)
            highest = [jnp.asarray(self.value("basal_mU_min", basal, start)) for start in starts]
            changes["max_daily_basal_mU_min"] = functools.reduce(jnp.maximum, highest)
            profile = dataclasses.replace(profile, total_daily_dose_U=by_mean.daily_dose_U())
        if self.varies("carb_ratio_g_U"):
            profile = dataclasses.replace(profile, carb_ratio_g_U=profile.carb_ratio())
        if self.varies("correction_mg_dl_U"):
            profile = dataclasses.replace(profile, correction_mg_dl_U=profile.correction_factor())

        def at(start: float) -> Profile:
            fields = [field for field in _SCHEDULED if self.varies(field)]
            now = {field: self.value(field, getattr(profile, field), start) for field in fields}
            if "basal_mU_min" in now:
                now["past_basal_mU_min"] = self.value("basal_mU_min", basal, start - sample_time_min)
                now["own_basal_mU_min"] = basal
            return dataclasses.replace(profile, **changes, **now)

        return tuple(map(at, starts))


_SCHEDULED: Final = ("basal_mU_min", "carb_ratio_g_U", "correction_mg_dl_U")


def given_profile(controller: Any, profile: Profile) -> Any:
    """A controller for a person, or for people, with a profile.

    A controller that doses by the profile has a method ``with_profile``, and one that only holds the basal rate at
    which the person rests ``with_basal``, which no schedule changes; others take the rate from the pump when they
    start, and are returned unchanged.
    """
    if hasattr(controller, "with_profile"):
        return controller.with_profile(profile)
    if hasattr(controller, "with_basal"):
        own = profile.own_basal_mU_min
        return controller.with_basal(jnp.asarray(profile.basal_mU_min if own is None else own))
    return controller


class _RapidInsulin(NamedTuple):
    """Times of a kind of insulin, in minutes."""

    action_min: float
    """Time from the beginning of the action to its end."""
    peak_min: float
    """Time from the beginning of the action to its peak, less than half of that to the end."""
    delay_min: float
    """Time from the dose to the beginning of the action."""


INSULINS: Final = {
    "rapid-adult": _RapidInsulin(360.0, 75.0, 10.0),
    "rapid-child": _RapidInsulin(360.0, 65.0, 10.0),
    "fiasp": _RapidInsulin(360.0, 55.0, 10.0),
    "lyumjev": _RapidInsulin(360.0, 55.0, 10.0),
}
"""Insulins under the skin by name, of LoopKit's `ExponentialInsulinModelPreset`."""


def action_per_min(
    t_min: jax.typing.ArrayLike, action_min: jax.typing.ArrayLike, peak_min: jax.typing.ArrayLike
) -> jax.Array:
    """Part of a dose that acts in a minute, at a time after its action began; its area is 1.

    ::

        a(t) = S / tau^2 t (1 - t / t_d) exp(-t / tau),   tau = t_p (1 - t_p / t_d) / (1 - 2 t_p / t_d)
        S = 1 / (1 - 2 tau / t_d + (1 + 2 tau / t_d) exp(-t_d / tau))
    """
    tau, _, S = _shape(action_min, peak_min, jnp)
    t = jnp.clip(jnp.asarray(t_min, float), 0.0, action_min)
    rate: jax.Array = S / tau**2 * t * (1.0 - t / action_min) * jnp.exp(-t / tau)
    return rate


def insulin_left(
    t_min: jax.typing.ArrayLike, action_min: jax.typing.ArrayLike, peak_min: jax.typing.ArrayLike, xp: Any = jnp
) -> Any:
    """Part of a dose that has not acted yet, at a time after its action began: 1 before it, and 0 after its end.

    `xp` is the module that computes it, NumPy for numbers that JAX never traces.
    """
    tau, a, S = _shape(action_min, peak_min, xp)
    t = xp.clip(xp.asarray(t_min, float), 0.0, action_min)
    trajectory = (t**2 / (tau * action_min * (1.0 - a)) - t / tau - 1.0) * xp.exp(-t / tau) + 1.0
    return 1.0 - S * (1.0 - a) * trajectory


def _shape(action_min: jax.typing.ArrayLike, peak_min: jax.typing.ArrayLike, xp: Any) -> tuple[Any, Any, Any]:
    """Time constant, twice that over the time of action, and scale of the curve."""
    action, peak = xp.asarray(action_min, float), xp.asarray(peak_min, float)
    tau = peak * (1.0 - peak / action) / (1.0 - 2.0 * peak / action)
    a = 2.0 * tau / action
    return tau, a, 1.0 / (1.0 - a + (1.0 + a) * xp.exp(-action / tau))
