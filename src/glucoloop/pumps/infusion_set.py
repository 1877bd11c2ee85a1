"""Infusion set that is worn for days, of which less and less insulin is taken up, and then changed."""

from __future__ import annotations

import math
from typing import Annotated, Any, Final

from glucoloop._lazy_jax import jax, jnp
from glucoloop._pytree import pytree
from glucoloop.component.pytree_component import HOST, derived, derived_static
from glucoloop.component.setting import About
from glucoloop.pumps.limits import PumpAround
from glucoloop.pumps.protocol import Delivery, deliver
from glucoloop.refusal import Refusal
from glucoloop.units import MIN_PER_DAY

_LONGEST_WEAR_MIN: Final = 30.0 * MIN_PER_DAY

_AGE: Final = 0x53495445
"""Number by which the key of the age at the start differs from that of the inner pump."""


@pytree
class _State:
    inner: Any
    age: jax.Array
    """Samples from the change of the set to the coming one."""


class InfusionSet(PumpAround, name="infusion-set"):
    """Loses more insulin the longer its infusion set is worn, until it is changed.

    The lost part of rate and bolus is 0 while the set is sound, and then grows evenly to its largest at the change. The
    pump reports what it drives. Times are rounded up to samples.
    """

    wear_min: Annotated[
        float, About("Time from one change of the set to the next.", above=0.0, at_most=_LONGEST_WEAR_MIN), HOST
    ] = 3.0 * MIN_PER_DAY
    sound_min: Annotated[
        float, About("Time after a change in which nothing is lost.", at_least=0.0, at_most=_LONGEST_WEAR_MIN), HOST
    ] = 1.5 * MIN_PER_DAY
    loss_pct: Annotated[
        float,
        About("Part of the insulin that is lost at the end of the wear.", at_least=0.0, at_most=100.0),
        HOST,
    ] = 20.0
    worn_min: Annotated[
        float | None,
        About(
            "Time since the change at the start; by default drawn for each person.",
            at_least=0.0,
            at_most=_LONGEST_WEAR_MIN,
        ),
        HOST,
    ] = None

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("sound_min", "worn_min"):
            minutes = getattr(self, name)
            if minutes is not None and minutes >= self.wear_min:
                raise Refusal(
                    f"{name} is {minutes:g} min, but the set is changed after {self.wear_min:g} min; give less"
                )

    @derived
    def loss(self) -> float:
        """Largest part that is lost."""
        return self.loss_pct / 100.0

    @derived_static
    def wear(self) -> int:
        """Samples from one change to the next."""
        return max(1, self._samples(self.wear_min))

    @derived_static
    def sound(self) -> int:
        """Samples after a change without loss."""
        return min(self._samples(self.sound_min), self.wear)

    @derived_static
    def worn(self) -> int | None:
        """Samples since the change at the start; None for a number that is drawn."""
        if self.worn_min is None:
            return None
        return min(math.floor(self.worn_min / self.sample_time_min + 1e-9), self.wear - 1)

    def _samples(self, minutes: float) -> int:
        return math.ceil(minutes / self.sample_time_min - 1e-9)

    def init(self, insulin_mU_min: jax.Array, key: jax.Array) -> _State:
        """State before the first command; unless it is set, the time since the change is drawn."""
        shape, dtype = jnp.shape(insulin_mU_min), jnp.result_type(float, insulin_mU_min)
        if self.worn is None:
            drawn = jax.random.uniform(jax.random.fold_in(key, _AGE), shape, dtype)
            age = jnp.minimum(jnp.floor(self.wear * drawn), self.wear - 1.0)
        else:
            age = jnp.full(shape, float(self.worn), dtype)
        return _State(inner=self.inner.init(insulin_mU_min, key), age=age)

    def deliver(
        self, state: _State, command_mU_min: jax.Array, key: jax.Array, bolus_mU: jax.Array | None = None
    ) -> tuple[_State, Delivery]:
        """Deliver as the inner pump does, less what is lost at this age."""
        inner, driven = deliver(self.inner, state.inner, command_mU_min, key, bolus_mU)
        growth = jnp.maximum(state.age - self.sound, 0.0) / max(1, self.wear - self.sound)
        taken_up = 1.0 - self.loss * growth
        age = state.age + 1.0
        return _State(inner=inner, age=jnp.where(age >= self.wear, 0.0, age)), Delivery(
            insulin_mU_min=taken_up * driven.insulin_mU_min,
            reported_mU_min=driven.reported_mU_min,
            bolus_mU=None if driven.bolus_mU is None else taken_up * driven.bolus_mU,
            reported_bolus_mU=driven.reported_bolus_mU,
        )
