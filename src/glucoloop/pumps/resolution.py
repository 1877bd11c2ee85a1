"""Pump that delivers only multiples of a smallest step, from a minimum rate on."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import KW_ONLY
from typing import Annotated, Any, Final

from glucoloop._lazy_jax import jax, jnp, np
from glucoloop._pytree import pytree
from glucoloop.arguments import is_traced
from glucoloop.component.pytree_component import DATA, HOST, derived, wired
from glucoloop.component.setting import About
from glucoloop.pumps.limits import PARKER_1999_LIMITS, DoseLimits, PumpAround
from glucoloop.pumps.protocol import Delivery, Pump, deliver
from glucoloop.refusal import Refusal
from glucoloop.unit_guess import RATE_STEP

_HAIR: Final = 1e-9  # of a step: a whole number of steps may come out just below itself

Step = Annotated[float, About("Step of the rate.", above=0.0, quantity=RATE_STEP)]
MinimumRate = Annotated[float, About("Minimum rate that is delivered.", at_least=0.0), HOST]


@pytree
class _Carry:
    inner: Any
    owed_mU_min: jax.Array


class WholeSteps:
    """Rounds the rate of the inner pump down to whole steps, and carries the remainder to the next sample.

    A rate below the minimum is not delivered but carried over as well. The carried insulin, at most one step or the
    minimum rate, keeps the mean dose right to that much unless the upper limit is in the way. The dose stays at or
    below that limit, while a change may exceed the rate limit by less than two steps, or two minimum rates.

    It reports what it delivers, unless the inner pump reports something else, which is passed on. A bolus has a step of
    its own, see `BolusLimits`, and passes as the inner pump delivers it.
    """

    inner: Pump
    limits: DoseLimits
    """Limits whose maximum is kept when carried insulin is delivered: those of the inner pump, if it has any."""
    step_mU_min: float
    least_mU_min: float

    @classmethod
    def resolved(cls, values: Mapping[str, Any]) -> dict[str, Any]:
        """The attributes, with the limits of the pump inside."""
        result: dict[str, Any] = super().resolved(values)  # type: ignore[misc]
        if result.get("limits") is None:
            result["limits"] = getattr(result.get("inner"), "limits", PARKER_1999_LIMITS)
        return result

    @derived
    def minimum_mU_min(self) -> Any:
        """Minimum rate, rounded up to whole steps."""
        traced = is_traced(self.step_mU_min, self.least_mU_min, self.limits)
        whole = jnp.ceil if traced else np.ceil
        minimum = whole(self.least_mU_min / self.step_mU_min - _HAIR) * self.step_mU_min
        if not traced and not np.all(minimum <= self.limits.max_mU_min):
            raise Refusal(
                f"a minimum dose of {self.least_mU_min:g} mU/min is not possible; give whole steps that stay within "
                "the largest dose"
            )
        return minimum

    def init(self, insulin_mU_min: jax.Array, key: jax.Array) -> _Carry:
        """State without carried insulin."""
        return _Carry(inner=self.inner.init(insulin_mU_min, key), owed_mU_min=jnp.zeros_like(insulin_mU_min))

    def deliver(
        self, state: _Carry, command_mU_min: jax.Array, key: jax.Array, bolus_mU: jax.Array | None = None
    ) -> tuple[_Carry, Delivery]:
        """Deliver a whole number of steps."""
        inner, request = deliver(self.inner, state.inner, command_mU_min, key, bolus_mU)
        due = request.insulin_mU_min + state.owed_mU_min
        possible = jnp.minimum(due, self.limits.max_mU_min)
        whole = jnp.floor(possible / self.step_mU_min + _HAIR) * self.step_mU_min
        # both are whole steps, but for rounding
        enough = whole > self.minimum_mU_min - 0.5 * self.step_mU_min
        delivered = jnp.where(enough, whole, 0.0)
        owed = jnp.minimum(due - delivered, jnp.maximum(self.step_mU_min, self.minimum_mU_min))
        honest = request.reported_mU_min == request.insulin_mU_min
        reported = jnp.where(honest, delivered, request.reported_mU_min)
        delivery = dataclasses.replace(request, insulin_mU_min=delivered, reported_mU_min=reported)
        return _Carry(inner=inner, owed_mU_min=owed), delivery


class Resolution(WholeSteps, PumpAround, name="resolution"):
    """Delivers whole steps of the rate, and the remainder later."""

    step_mU_min: Step = 0.5
    least_mU_min: MinimumRate = 0.0

    _: KW_ONLY
    limits: DoseLimits = wired(DATA, default=None)


def with_resolution(
    step_mU_min: float, inner: Pump | None = None, *, least_mU_min: float = 0.0, limits: DoseLimits | None = None
) -> Resolution:
    """Pump with a delivery resolution and a minimum dose, see `Resolution`.

    Raises
    ------
    ValueError
        Unless the step is positive and finite, and the minimum dose from 0 to the largest dose of the limits.
    """
    around: dict[str, Any] = {
        name: value for name, value in (("inner", inner), ("limits", limits)) if value is not None
    }
    pump = Resolution(step_mU_min, least_mU_min, **around)
    _ = pump.minimum_mU_min  # refuses what is not possible
    return pump
