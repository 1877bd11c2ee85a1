"""Limits of a bolus: a largest dose, a least dose, and a step."""

from __future__ import annotations

import math
from typing import Final

import jax
import jax.numpy as jnp

from glucoloop._pytree import pytree
from glucoloop.arguments import checked, is_traced
from glucoloop.refusal import Refusal
from glucoloop.units import MU_PER_U

_HAIR: Final = 1e-9  # of a step: a whole number of steps may come out just below itself


@pytree
class BolusLimits:
    """Bounds and resolution of one bolus. The limits of the basal rate do not bind it."""

    max_mU: jax.Array | float = 25_000.0
    min_mU: jax.Array | float = 50.0
    step_mU: jax.Array | float = 50.0

    def allowed(self, bolus_mU: jax.Array) -> jax.Array:
        """Bolus that a pump gives for a requested one.

        It is rounded down to whole steps, and the remainder is not given later. A bolus above the largest one is cut to
        it. One that is below the least, below zero or not finite is not given at all.

        Parameters
        ----------
        bolus_mU : (...) array
            Requested bolus; any number or NaN.
        """
        wanted = jnp.where(jnp.isfinite(bolus_mU) & (bolus_mU > 0.0), bolus_mU, 0.0)
        whole = jnp.floor(jnp.minimum(wanted, self.max_mU) / self.step_mU + _HAIR) * self.step_mU
        return jnp.where(whole >= self.min_mU - _HAIR * self.step_mU, whole, 0.0)


USUAL_BOLUS_LIMITS: Final = BolusLimits()
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
