"""Limits of a pump: the constraints (17) and (18) of Parker, Doyle and Peppas (1999), and those of a bolus."""

from __future__ import annotations

import math
from typing import Final

from glucoloop._lazy_jax import jax, jnp
from glucoloop._pytree import pytree
from glucoloop.arguments import checked, is_traced
from glucoloop.component.routes import PUMP_OF_1999
from glucoloop.pumps.protocol import Delivery
from glucoloop.refusal import Refusal
from glucoloop.unit_guess import LARGEST_RATE, RATE_CHANGE, refuse_unusual
from glucoloop.units import MU_PER_U


@pytree
class DoseLimits:
    """Bounds on the infusion and on its change from one sample to the next."""

    max_change_mU_min: jax.Array | float = PUMP_OF_1999.max_change_mU_min
    min_mU_min: jax.Array | float = PUMP_OF_1999.min_mU_min
    max_mU_min: jax.Array | float = PUMP_OF_1999.max_mU_min

    def clip(self, insulin_mU_min: jax.Array, previous_mU_min: jax.Array) -> jax.Array:
        """Clip the change first and the magnitude second, as the paper does."""
        change = jnp.clip(insulin_mU_min - previous_mU_min, -self.max_change_mU_min, self.max_change_mU_min)
        return jnp.clip(previous_mU_min + change, self.min_mU_min, self.max_mU_min)

    def allow(self, insulin_mU_min: jax.Array, previous_mU_min: jax.Array, slack_mU_min: float = 0.0) -> jax.Array:
        """Whether a rate keeps both limits, compared with the limits themselves, since a clipped rate is rounded."""
        change = jnp.abs(insulin_mU_min - previous_mU_min)
        return (
            (change <= self.max_change_mU_min + slack_mU_min)
            & (insulin_mU_min >= self.min_mU_min - slack_mU_min)
            & (insulin_mU_min <= self.max_mU_min + slack_mU_min)
        )


PARKER_1999_LIMITS: Final = DoseLimits()
"""Limits of the paper."""


@checked
def dose_limits(
    *,
    max_change_mU_min: float = PUMP_OF_1999.max_change_mU_min,
    min_mU_min: float = PUMP_OF_1999.min_mU_min,
    max_mU_min: float = PUMP_OF_1999.max_mU_min,
    allow_unusual: bool = False,
) -> DoseLimits:
    """Limits with the given bounds; those of Parker et al. (1999) for the others.

    Raises
    ------
    ValueError
        Unless ``0 < max_change`` and ``0 <= min < max``, all finite; for a greatest rate or change so small that U/h
        were probably meant, unless `allow_unusual`.
    """
    if not is_traced(max_change_mU_min) and not 0.0 < max_change_mU_min < math.inf:
        raise Refusal(
            f"a rate limit of {max_change_mU_min:g} mU/min per sample is not possible; give a finite value above 0"
        )
    if not is_traced(min_mU_min, max_mU_min) and not 0.0 <= min_mU_min < max_mU_min < math.inf:
        raise Refusal(
            f"a dose range of {min_mU_min:g} to {max_mU_min:g} mU/min is not possible; "
            "give 0 or more as the lower and a larger finite value as the upper bound"
        )
    for name, value, quantity in (
        ("max_mU_min", max_mU_min, LARGEST_RATE),
        ("max_change_mU_min", max_change_mU_min, RATE_CHANGE),
    ):
        if not allow_unusual and not is_traced(value) and value < quantity.least:  # a large one is no bound
            refuse_unusual(value, quantity, name)
    return DoseLimits(max_change_mU_min=max_change_mU_min, min_mU_min=min_mU_min, max_mU_min=max_mU_min)


_HAIR: Final = 1e-9  # of a step: a whole number of steps may come out just below itself


@pytree
class BolusLimits:
    """Bounds and resolution of one bolus. The limits of the basal rate do not bind it."""

    max_mU: jax.Array | float = 25_000.0
    min_mU: jax.Array | float = 50.0
    step_mU: jax.Array | float = 50.0

    def allowed(self, bolus_mU: jax.Array) -> jax.Array:
        """Bolus that a pump gives for a requested one, which may be any number or NaN.

        It is rounded down to whole steps, and the remainder is not given later. A bolus above the largest one is cut to
        it. One that is below the least, below zero or not finite is not given at all.
        """
        wanted = jnp.where(jnp.isfinite(bolus_mU) & (bolus_mU > 0.0), bolus_mU, 0.0)
        whole = jnp.floor(jnp.minimum(wanted, self.max_mU) / self.step_mU + _HAIR) * self.step_mU
        return jnp.where(whole >= self.min_mU - _HAIR * self.step_mU, whole, 0.0)


DEFAULT_BOLUS_LIMITS: Final = BolusLimits()
"""Largest bolus of 25 U, as of the t:slim X2 (Tandem), in steps of 0.05 U, the pulse of the Omnipod (Insulet); the
usual pumps can give every bolus within these limits.
"""


@checked
def bolus_limits(*, max_U: float = 25.0, min_U: float = 0.05, step_U: float = 0.05) -> BolusLimits:
    """Limits of boluses in units of insulin.

    Parameters
    ----------
    max_U : float
        Largest bolus [U].
    min_U : float
        Least bolus that is given at all [U].
    step_U : float
        Step of which boluses are multiples [U].

    Raises
    ------
    ValueError
        Unless ``0 < step <= max`` and ``0 <= min <= max``, all finite.
    """
    if not is_traced(max_U, step_U) and not 0.0 < step_U <= max_U < math.inf:
        raise Refusal(
            f"boluses in steps of {step_U:g} U up to {max_U:g} U are not possible; "
            "give a step above 0 U and a finite largest bolus of at least one step"
        )
    if not is_traced(min_U, max_U) and not 0.0 <= min_U <= max_U:
        raise Refusal(
            f"a least bolus of {min_U:g} U is not possible; give 0 U or more, and at most the largest, {max_U:g} U"
        )
    return BolusLimits(max_mU=MU_PER_U * max_U, min_mU=MU_PER_U * min_U, step_mU=MU_PER_U * step_U)


@pytree
class LimitedPump:
    """Clips rate of change and magnitude of the basal rate, and keeps the limits of a bolus.

    A commanded rate that is not a number moves toward the least rate. A bolus does not count as a change of the rate.
    """

    limits: DoseLimits = PARKER_1999_LIMITS
    bolus: BolusLimits = DEFAULT_BOLUS_LIMITS

    def init(self, insulin_mU_min: jax.Array, key: jax.Array) -> jax.Array:
        """State of the pump: the last delivered rate."""
        return jnp.clip(insulin_mU_min, self.limits.min_mU_min, self.limits.max_mU_min)

    def deliver(
        self, state: jax.Array, command_mU_min: jax.Array, key: jax.Array, bolus_mU: jax.Array | None = None
    ) -> tuple[jax.Array, Delivery]:
        """Deliver the nearest allowed rate, and the bolus as far as it is allowed."""
        command = jnp.where(jnp.isnan(command_mU_min), self.limits.min_mU_min, command_mU_min)
        delivered = self.limits.clip(command, state)
        bolus = None if bolus_mU is None else self.bolus.allowed(bolus_mU)
        return delivered, Delivery(
            insulin_mU_min=delivered, reported_mU_min=delivered, bolus_mU=bolus, reported_bolus_mU=bolus
        )
