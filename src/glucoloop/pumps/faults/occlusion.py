"""Infusion line that is partly or fully blocked."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from glucoloop._pytree import pytree, static
from glucoloop.arguments import checked
from glucoloop.episodes import Episodes, recurring
from glucoloop.parts.faults import OcclusionSettings
from glucoloop.pumps.faults.wrapping import Within, begin, deliver_within, or_limited
from glucoloop.pumps.protocol import Delivery, Pump


@pytree
class Occlusion:
    """Delivers a fraction of the basal rate and of the bolus of the inner pump."""

    inner: Pump
    episodes: Episodes
    open_fraction: jax.Array | float
    noticed: bool = static(default=False)
    """Whether the pump reports the rate that passes the line, rather than the intended one."""

    def init(self, insulin_mU_min: jax.Array, key: jax.Array) -> Within:
        """State of the inner pump and of the fault before the first command."""
        return begin(self, insulin_mU_min, key)

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
            reported = jax.tree.map(lambda passed, told: jnp.where(there, passed, told), through, reported)
        insulin, bolus = through
        told, told_bolus = reported
        return state, Delivery(
            insulin_mU_min=insulin, reported_mU_min=told, bolus_mU=bolus, reported_bolus_mU=told_bolus
        )


@checked
def occlusion(
    episodes: Episodes, inner: Pump | None = None, *, open_fraction: float = 0.0, noticed: bool = False
) -> Occlusion:
    """Pump whose line is blocked during the episodes.

    Insulin that does not pass is lost, not delivered later: of the basal rate, and of a bolus given during an episode.

    Parameters
    ----------
    episodes : Episodes
    inner : Pump, optional
        Inner pump; one with the limits of the paper by default.
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
    return Occlusion(inner=or_limited(inner), episodes=episodes, open_fraction=open_fraction, noticed=noticed)


@checked
def missed_pulses(share: float, inner: Pump | None = None, *, noticed: bool = False, key: int = 0) -> Occlusion:
    """Pump that delivers nothing in random single samples, neither its basal rate nor a bolus.

    Parameters
    ----------
    share : float
        Probability that the insulin of a sample does not reach the person; samples are independent.
    inner : Pump, optional
        Inner pump; one with the limits of the paper by default.
    noticed : bool
        Whether the pump reports that no insulin passed.
    key : int
        Number that makes the random draws of this fault differ from those of others around the same pump; 0 to 65535.

    Raises
    ------
    ValueError
        For a number out of its range.
    """
    return occlusion(recurring(share, key=key), inner, noticed=noticed)
