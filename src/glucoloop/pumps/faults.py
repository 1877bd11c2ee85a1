"""Faults of a pump: small objects that wrap any `inner` pump, by default one with the limits of the paper."""

from __future__ import annotations

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp

from glucoloop._pytree import pytree, static
from glucoloop.arguments import checked
from glucoloop.episodes import Episodes, Within, begin, recurring
from glucoloop.faults import MisreportedSettings, OcclusionSettings
from glucoloop.pumps.expiring import expiring
from glucoloop.pumps.limits import LimitedPump
from glucoloop.pumps.protocol import Delivery, Pump, deliver


@pytree
class FaultyPump:
    """A pump with a fault around another one."""

    inner: Pump
    episodes: Episodes

    def init(self, insulin_mU_min: jax.Array, key: jax.Array) -> Any:
        """State of the inner pump and of the fault before the first command."""
        return begin(self.inner, self.episodes, insulin_mU_min, key)


def deliver_within(
    fault: FaultyPump, state: Within, command_mU_min: jax.Array, key: jax.Array, bolus_mU: jax.Array | None
) -> tuple[Within, jax.Array, Delivery]:
    """Let the inner pump deliver; the age of the fault comes with the result, -1 while the fault is absent."""
    inner, delivery = deliver(fault.inner, state.inner, command_mU_min, key, bolus_mU)
    episode, age = fault.episodes.step(state.episode, key)
    return Within(inner=inner, episode=episode), age, delivery


def _or_limited(inner: Pump | None) -> Pump:
    """The given pump, or one with the limits of the paper for None."""
    return LimitedPump() if inner is None else inner


@pytree
class BatteryGap(FaultyPump):
    """Delivers neither rate nor bolus and reports nothing; then the inner pump starts from rest at no insulin.

    All inner parts start again, faults and their planned times included: put other faults around this one.
    """

    def deliver(
        self, state: Within, command_mU_min: jax.Array, key: jax.Array, bolus_mU: jax.Array | None = None
    ) -> tuple[Within, Delivery]:
        """Deliver as the inner pump does, or nothing while the fault is present."""
        state, age, delivery = deliver_within(self, state, command_mU_min, key, bolus_mU)
        off = age >= 0.0
        at_rest = self.inner.init(jnp.zeros_like(delivery.insulin_mU_min), key)
        inner = jax.tree.map(lambda rest, running: jnp.where(off, rest, running), at_rest, state.inner)
        given, reported = (
            (delivery.insulin_mU_min, delivery.bolus_mU),
            (delivery.reported_mU_min, delivery.reported_bolus_mU),
        )
        insulin, bolus = jax.tree.map(lambda dose: jnp.where(off, 0.0, dose), given)
        reported_rate, reported_bolus = jax.tree.map(lambda dose: jnp.where(off, jnp.nan, dose), reported)
        return Within(inner=inner, episode=state.episode), Delivery(
            insulin_mU_min=insulin, reported_mU_min=reported_rate, bolus_mU=bolus, reported_bolus_mU=reported_bolus
        )


@checked
def battery_gap(episodes: Episodes, inner: Pump | None = None) -> BatteryGap:
    """Pump that has no power during the episodes."""
    return BatteryGap(inner=_or_limited(inner), episodes=episodes)


@pytree
class Occlusion(FaultyPump):
    """Delivers a fraction of the basal rate and of the bolus of the inner pump."""

    open_fraction: jax.Array | float
    noticed: bool = static(default=False)
    """Whether the pump reports the rate that passes the line, rather than the intended one."""

    def deliver(
        self, state: Within, command_mU_min: jax.Array, key: jax.Array, bolus_mU: jax.Array | None = None
    ) -> tuple[Within, Delivery]:
        """Deliver as the inner pump does, or a fraction of it while the fault is present."""
        state, age, delivery = deliver_within(self, state, command_mU_min, key, bolus_mU)
        there = age >= 0.0
        through = jax.tree.map(
            lambda pushed: jnp.where(there, self.open_fraction * pushed, pushed),
            (delivery.insulin_mU_min, delivery.bolus_mU),
        )
        reported = delivery.reported_mU_min, delivery.reported_bolus_mU
        if self.noticed:
            reported = jax.tree.map(lambda passed, intended: jnp.where(there, passed, intended), through, reported)
        insulin, bolus = through
        reported_rate, reported_bolus = reported
        return state, Delivery(
            insulin_mU_min=insulin, reported_mU_min=reported_rate, bolus_mU=bolus, reported_bolus_mU=reported_bolus
        )


@checked
def occlusion(
    episodes: Episodes, inner: Pump | None = None, *, open_fraction: float = 0.0, noticed: bool = False
) -> Occlusion:
    """Pump whose line is blocked during the episodes.

    Insulin that does not pass is lost, not delivered later: of the basal rate, and of a bolus given during an episode.

    Parameters
    ----------
    open_fraction : float
        Fraction of the insulin that still passes.
    noticed : bool
        Whether the pump reports the rate that passes the line; otherwise it reports the intended rate.

    Raises
    ------
    ValueError
        Unless ``0 <= open_fraction < 1``.
    """
    OcclusionSettings(open_fraction=open_fraction)
    return Occlusion(inner=_or_limited(inner), episodes=episodes, open_fraction=open_fraction, noticed=noticed)


@checked
def missed_pulses(share: float, inner: Pump | None = None, *, noticed: bool = False, key: int = 0) -> Occlusion:
    """Pump that delivers nothing in random single samples, neither its basal rate nor a bolus.

    Parameters
    ----------
    share : float
        Probability that the insulin of a sample does not reach the person; samples are independent.
    noticed : bool
        Whether the pump reports that no insulin passed.
    key : int
        Number that makes the random draws of this fault differ from those of others around the same pump; 0 to 65535.
    """
    return occlusion(recurring(share, key=key), inner, noticed=noticed)


@pytree
class Unheard(FaultyPump):
    """Gives the inner pump NaN as rate and bolus during the episodes, so that it gives no bolus."""

    def deliver(
        self, state: Within, command_mU_min: jax.Array, key: jax.Array, bolus_mU: jax.Array | None = None
    ) -> tuple[Within, Delivery]:
        """Deliver as the inner pump does, with the command or with none."""
        episode, age = self.episodes.step(state.episode, key)
        there = age >= 0.0
        heard = jnp.where(there, jnp.nan, command_mU_min)
        bolus = None if bolus_mU is None else jnp.where(there, jnp.nan, bolus_mU)
        inner, delivery = deliver(self.inner, state.inner, heard, key, bolus)
        return Within(inner=inner, episode=episode), delivery


def unheard(episodes: Episodes, inner: Pump | None = None) -> Unheard:
    """Pump that receives no commands during the episodes.

    Parameters
    ----------
    inner : Pump, optional
        Inner pump; by default one whose commands expire after two samples.
    """
    return Unheard(inner=expiring() if inner is None else inner, episodes=episodes)


@pytree
class _Reports:
    within: Within
    rate_mU_min: jax.Array
    """Rate that the inner pump reported at the sample before."""
    bolus_mU: jax.Array
    """The same of the bolus; 0 without boluses."""


@pytree
class Misreported(FaultyPump):
    """Delivers as the inner pump does, and reports a part of that or of the delivery before."""

    rate_part: jax.Array | float
    bolus_part: jax.Array | float
    late_samples: jax.Array | float

    def init(self, insulin_mU_min: jax.Array, key: jax.Array) -> _Reports:
        """State of the inner pump and of the fault, after a long time at the given rate without a bolus."""
        return _Reports(
            within=super().init(insulin_mU_min, key),
            rate_mU_min=insulin_mU_min,
            bolus_mU=jnp.zeros_like(insulin_mU_min),
        )

    def deliver(
        self, state: _Reports, command_mU_min: jax.Array, key: jax.Array, bolus_mU: jax.Array | None = None
    ) -> tuple[_Reports, Delivery]:
        """Deliver as the inner pump does, and report something else while the fault is present."""
        within, age, delivery = deliver_within(self, state.within, command_mU_min, key, bolus_mU)
        there, late = age >= 0.0, jnp.asarray(self.late_samples) > 0.5

        def report(true: jax.Array, before: jax.Array, part: jax.Array | float) -> jax.Array:
            return jnp.where(there, part * jnp.where(late, before, true), true)

        rate, bolus = delivery.reported_mU_min, delivery.reported_bolus_mU
        after = _Reports(within=within, rate_mU_min=rate, bolus_mU=jnp.zeros_like(rate) if bolus is None else bolus)
        reported_bolus = None if bolus is None else report(bolus, state.bolus_mU, self.bolus_part)
        return after, dataclasses.replace(
            delivery,
            reported_mU_min=report(rate, state.rate_mU_min, self.rate_part),
            reported_bolus_mU=reported_bolus,
        )


@checked
def misreported(
    episodes: Episodes,
    inner: Pump | None = None,
    *,
    rate_part: float = 0.0,
    bolus_part: float = 0.0,
    late_samples: int = 0,
) -> Misreported:
    """Pump that delivers what it is asked for and reports something else during the episodes.

    Parameters
    ----------
    rate_part : float
        Part of the basal rate that is reported; 2 for twice as much.
    bolus_part : float
        Part of a bolus that is reported.
    late_samples : int
        1 if the report is that of the sample before, else 0.

    Raises
    ------
    ValueError
        For a part outside 0 to 10, or a report that is late by more than a sample.
    """
    MisreportedSettings(rate_part=rate_part, bolus_part=bolus_part, late_samples=late_samples)
    return Misreported(
        inner=_or_limited(inner),
        episodes=episodes,
        rate_part=rate_part,
        bolus_part=bolus_part,
        late_samples=float(late_samples),
    )
