"""Schedule: a controller whose profile and target follow the time of day.

The controller of each segment is made once, on the host, by the profile that holds in it; a step takes the numbers of
the segment in which its time of day lies. So no controller knows of schedules, and all that dose by a profile have
them.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable
from typing import Any, TypeVar

from glucoloop._lazy_jax import jax, jnp
from glucoloop._pytree import pytree, static
from glucoloop.component.effects import TIME_OF_DAY, Need
from glucoloop.control.around import AroundAnother
from glucoloop.control.protocol import (
    Controller,
    Decision,
    DoseForecast,
    Observation,
    forecast_of,
    uses_of,
)
from glucoloop.therapy import TARGET, Profile, Schedule, given_profile

T = TypeVar("T")


@pytree
class Scheduled(AroundAnother):
    """A controller by the clock; see `scheduled`."""

    inner: Controller
    """Controller of the first segment."""
    segments: tuple[tuple[Any, ...], ...]
    """Numbers of the controller that depend on the profile, for each segment after the first."""
    schedule: Schedule = static()
    varies: tuple[bool, ...] = static()
    """Whether each number of the controller depends on the profile."""

    @property
    def sample_time_min(self) -> float:
        """Sample time of the inner controller."""
        return self.inner.sample_time_min

    @property
    def uses(self) -> frozenset[Need]:
        """Needs that the inner controller meets, and the time of day where the schedule depends on it."""
        return uses_of(self.inner) | ({TIME_OF_DAY} if self.schedule.by_clock else frozenset())

    @property
    def needs_time_of_day(self) -> bool:
        """Whether the schedule or the inner controller goes by the time of day."""
        return self.schedule.by_clock or super().needs_time_of_day

    def with_profile(self, profile: Profile) -> Scheduled:
        """The same for a person, or people, with another profile, which the schedule changes likewise."""
        return scheduled(self.inner, self.schedule, profile)

    def with_basal(self, insulin_mU_min: jax.Array) -> Scheduled:
        """The same for a person of whom the basal rate alone is known."""
        return self.with_profile(Profile(basal_mU_min=insulin_mU_min, setpoint_mg_dl=jnp.nan))

    def init(self, observation: Observation) -> Any:
        """State of the controller of the first segment."""
        return self._now(observation).init(self._aimed(observation))

    def step(self, state: Any, observation: Observation) -> tuple[Any, Decision]:
        """Decide by the profile and the target of this time of day."""
        return self._now(observation).step(state, self._aimed(observation))

    def forecast(self, state: Any, observation: Observation) -> DoseForecast | None:
        """Forecast of the inner controller by the profile and the target of this time of day, as if they lasted."""
        return forecast_of(self._now(observation), state, self._aimed(observation))

    def _now(self, observation: Observation) -> Controller:
        """Controller of the segment of an observation."""
        leaves, tree = jax.tree.flatten(self.inner)
        first = tuple(itertools.compress(leaves, self.varies))
        own = iter(_of_segment(self._starts, observation, lambda number: (first, *self.segments)[number]))
        now = [next(own) if varies else leaf for leaf, varies in zip(leaves, self.varies, strict=True)]
        controller: Controller = jax.tree.unflatten(tree, now)
        return controller

    def _aimed(self, observation: Observation) -> Observation:
        """Observation with the target of its time of day."""
        if not self.schedule.varies(TARGET):
            return observation
        own, starts = observation.setpoint_mg_dl, self._starts
        target = _of_segment(starts, observation, lambda number: self.schedule.value(TARGET, own, starts[number]))
        temporary = None
        if any(change.temporary for change in self.schedule.changes):
            temporary = _of_segment(
                starts, observation, lambda number: jnp.asarray(self.schedule.temporary(starts[number]))
            )
        return dataclasses.replace(observation, setpoint_mg_dl=target, temporary_target=temporary)

    @property
    def _starts(self) -> tuple[float, ...]:
        return self.schedule.starts_min(self.sample_time_min)


def _of_segment(starts_min: tuple[float, ...], observation: Observation, values: Callable[[int], T]) -> T:
    """Numbers of the segment in which the time of day of an observation lies."""
    result, time = values(0), observation.time_of_day_min
    for number, start in enumerate(starts_min[1:], start=1):
        assert time is not None  # which the design refuses
        result = jax.tree.map(lambda new, old, at=start: jnp.where(time >= at, new, old), values(number), result)
    return result


def scheduled(controller: Controller, schedule: Schedule, profile: Profile) -> Scheduled:
    """Make a controller follow the time of day.

    Parameters
    ----------
    controller : Controller
        Controller by the profile without the schedule; in a loop it has to be told of the time of day.
    schedule : Schedule
        Changes of profile and target.
    profile : Profile
        Profile without the schedule, of one person or of people ``(people,)``.

    Examples
    --------
    >>> from glucoloop.control.basal_bolus import BasalBolus
    >>> from glucoloop.therapy import Profile, Schedule, TherapyChange
    >>> profile = Profile(basal_mU_min=10.0, setpoint_mg_dl=110.0)
    >>> night = Schedule((TherapyChange("basal_mU_min", 0.0, 360.0, factor=1.1),))
    >>> by_clock = scheduled(BasalBolus().of_person(profile), night, profile)
    >>> len(by_clock.segments)
    3
    """
    dtype = jnp.asarray(profile.basal_mU_min).dtype
    numbers = jax.tree.map(lambda value: jnp.asarray(value, dtype), profile)
    profiles = schedule.profiles(numbers, controller.sample_time_min)
    first, *others = (given_profile(controller, of_segment) for of_segment in profiles)
    leaves, rows = jax.tree.leaves(first), [jax.tree.leaves(other) for other in others]
    # what no segment changes is the same array in all, whoever the people are
    varies = tuple(any(row[number] is not leaf for row in rows) for number, leaf in enumerate(leaves))
    segments = tuple(tuple(itertools.compress(row, varies)) for row in rows)
    return Scheduled(inner=first, segments=segments, schedule=schedule, varies=varies)
