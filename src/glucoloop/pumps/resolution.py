"""Pump that delivers only multiples of a smallest step, from a least rate on."""

from __future__ import annotations

import dataclasses
from typing import Any, Final

from glucoloop._lazy_jax import jax, jnp, np
from glucoloop._pytree import pytree
from glucoloop.arguments import checked, is_traced
from glucoloop.pumps.limits import PARKER_1999_LIMITS, DoseLimits, LimitedPump
from glucoloop.pumps.protocol import Delivery, Pump, deliver
from glucoloop.pumps.settings import ResolutionPumpSettings
from glucoloop.refusal import Refusal

_HAIR: Final = 1e-9  # of a step: a whole number of steps may come out just below itself


@pytree
class _Carry:
    inner: Any
    owed_mU_min: jax.Array


@pytree
class Resolution:
    """Rounds the rate of the inner pump down to whole steps, and carries the remainder to the next sample.

    A rate below the least one is not delivered but carried over as well. The carried insulin, at most one step or the
    least rate, keeps the mean dose right to that much unless the upper limit is in the way. The dose stays at or below
    that limit, while a change may exceed the rate limit by less than two steps, or two least rates.

    It reports what it delivers, unless the inner pump reports something else, which is passed on. A bolus has a step of
    its own, see `BolusLimits`, and passes as the inner pump delivers it.
    """

    inner: Pump
    limits: DoseLimits
    step_mU_min: jax.Array | float
    least_mU_min: jax.Array | float
    """Least delivered rate, a multiple of the step."""

    def init(self, insulin_mU_min: jax.Array, key: jax.Array) -> _Carry:
        """State without carried insulin."""
        return _Carry(inner=self.inner.init(insulin_mU_min, key), owed_mU_min=jnp.zeros_like(insulin_mU_min))

    def deliver(
        self, state: _Carry, command_mU_min: jax.Array, key: jax.Array, bolus_mU: jax.Array | None = None
    ) -> tuple[_Carry, Delivery]:
        """Deliver a whole number of steps."""
        inner, wanted = deliver(self.inner, state.inner, command_mU_min, key, bolus_mU)
        due = wanted.insulin_mU_min + state.owed_mU_min
        most = jnp.minimum(due, self.limits.max_mU_min)
        whole = jnp.floor(most / self.step_mU_min + _HAIR) * self.step_mU_min
        # both are whole steps, but for rounding
        enough = whole > self.least_mU_min - 0.5 * self.step_mU_min
        delivered = jnp.where(enough, whole, 0.0)
        owed = jnp.minimum(due - delivered, jnp.maximum(self.step_mU_min, self.least_mU_min))
        honest = wanted.reported_mU_min == wanted.insulin_mU_min
        reported = jnp.where(honest, delivered, wanted.reported_mU_min)
        delivery = dataclasses.replace(wanted, insulin_mU_min=delivered, reported_mU_min=reported)
        return _Carry(inner=inner, owed_mU_min=owed), delivery


@checked
def with_resolution(
    step_mU_min: float, inner: Pump | None = None, *, least_mU_min: float = 0.0, limits: DoseLimits | None = None
) -> Resolution:
    """Pump with a delivery resolution and a least dose.

    Parameters
    ----------
    step_mU_min : float
        Step of which doses are multiples.
    least_mU_min : float
        Smallest dose that is delivered at all, rounded up to whole steps.
    limits : DoseLimits, optional
        Limits whose maximum is kept when carried insulin is delivered; by default those of the inner pump if it has
        any, else those of the paper.

    Raises
    ------
    ValueError
        Unless the step is positive and finite, and the least dose from 0 to the largest dose of the limits.
    """
    traced = is_traced(step_mU_min, least_mU_min, inner, limits)
    ResolutionPumpSettings(step_mU_min=step_mU_min, least_mU_min=least_mU_min)
    pump = LimitedPump() if inner is None else inner
    pump_limits = getattr(pump, "limits", PARKER_1999_LIMITS) if limits is None else limits
    whole = jnp.ceil if traced else np.ceil
    least = whole(least_mU_min / step_mU_min - _HAIR) * step_mU_min
    if not traced and not jnp.all(least <= pump_limits.max_mU_min):
        raise Refusal(
            f"a least dose of {least_mU_min:g} mU/min is not possible; give whole steps that stay within the largest "
            "dose"
        )
    return Resolution(
        inner=pump, limits=pump_limits, step_mU_min=step_mU_min, least_mU_min=least if traced else float(least)
    )
