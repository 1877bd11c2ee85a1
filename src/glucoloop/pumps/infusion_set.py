"""Infusion set that is worn for days, of which less and less insulin is taken up, and then changed."""

from __future__ import annotations

import math
from typing import Any, Final

from glucoloop._lazy_jax import jax, jnp
from glucoloop._pytree import pytree, static
from glucoloop.arguments import checked
from glucoloop.pumps.limits import LimitedPump
from glucoloop.pumps.protocol import Delivery, Pump, deliver
from glucoloop.pumps.settings import InfusionSetSettings
from glucoloop.refusal import Refusal

_AGE: Final = 0x53495445
"""Number by which the key of the age at the start differs from that of the inner pump."""


@pytree
class _State:
    inner: Any
    age: jax.Array
    """Samples from the change of the set to the coming one."""


@pytree
class InfusionSet:
    """Loses a part of rate and bolus that grows with the wear; make it with `infusion_set`.

    The lost part is 0 while the set is sound, and then grows evenly to its largest at the change. The pump reports what
    it drives.
    """

    inner: Pump
    loss: jax.Array | float
    """Largest part that is lost."""
    wear: int = static()
    """Samples from one change to the next."""
    sound: int = static()
    """Samples after a change without loss."""
    worn: int | None = static()
    """Samples since the change at the start; None for a number that is drawn."""

    def init(self, insulin_mU_min: jax.Array, key: jax.Array) -> _State:
        """State before the first command; unless it is given, the time since the change is drawn."""
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


@checked
def infusion_set(
    wear_min: float = 4320.0,
    sound_min: float = 2160.0,
    loss_pct: float = 20.0,
    worn_min: float | None = None,
    inner: Pump | None = None,
    *,
    sample_time_min: float = 5.0,
) -> InfusionSet:
    """Pump whose infusion set is worn and changed.

    Parameters
    ----------
    wear_min : float
        Time from one change to the next, rounded up to samples.
    sound_min : float
        Time after a change in which nothing is lost.
    loss_pct : float
        Part of the insulin that is lost at the end of the wear.
    worn_min : float, optional
        Time since the change at the start; by default drawn for each person.

    Raises
    ------
    ValueError
        For a setting beyond its bounds, or settings at odds with one another.
    """
    InfusionSetSettings(wear_min=wear_min, sound_min=sound_min, loss_pct=loss_pct, worn_min=worn_min)
    if not 0.0 < sample_time_min < math.inf:
        raise Refusal(f"a sample time of {sample_time_min:g} min is not possible; give a finite one above 0 min")

    def samples(minutes: float) -> int:
        return math.ceil(minutes / sample_time_min - 1e-9)

    wear = max(1, samples(wear_min))
    return InfusionSet(
        inner=LimitedPump() if inner is None else inner,
        loss=loss_pct / 100.0,
        wear=wear,
        sound=min(samples(sound_min), wear),
        worn=None if worn_min is None else min(math.floor(worn_min / sample_time_min + 1e-9), wear - 1),
    )
