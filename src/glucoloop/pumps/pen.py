"""Pens in place of a pump: the basal rate becomes injections of a long-acting insulin, and boluses are injected too.

The duration and the peak of the action of long-acting insulins are those of cgmsim-lib (https://github.com/lsandini/
cgmsim-lib, `src/drug.ts`, Apache-2.0), which draws the course between them as the exponential curve of
`glucoloop.therapy`. A pen is no new patient: what leaves the depot of the long-acting insulin enters the patient
as the rate of a pump does.
"""

from __future__ import annotations

import math
from dataclasses import KW_ONLY
from typing import Annotated, Any, Final, Literal

from glucoloop._lazy_jax import jax, jnp
from glucoloop._pytree import pytree
from glucoloop.component.pytree_component import HOST, STATIC, derived, derived_static, wired
from glucoloop.component.setting import About
from glucoloop.pumps.limits import PumpAround
from glucoloop.pumps.protocol import Delivery, deliver
from glucoloop.therapy import insulin_left
from glucoloop.unit_guess import BOLUS_STEP
from glucoloop.units import MIN_PER_DAY, MIN_PER_H, MU_PER_U

LongActing = Literal["glargine", "glargine-u300", "detemir", "degludec"]
LONG_ACTING: Final[dict[LongActing, tuple[float, float, float]]] = {
    "glargine": (22.0, 12.0, 2.5),
    "glargine-u300": (24.0, 14.0, 2.5),
    "detemir": (14.0, 24.0, 3.0),
    "degludec": (42.0, 0.0, 3.0),
}
"""Long-acting insulins: hours for which one acts, further hours for each U/kg of the dose, and the number by which the
duration is divided to give the time of the peak."""


@pytree
class _State:
    inner: Any
    dose_mU: jax.Array
    """(injections, ...) long-acting doses, the newest first."""
    since_min: jax.Array
    """(injections, ...) time since each."""
    requested_mU: jax.Array
    """Basal insulin that was asked for since the newest injection."""


class Pen(PumpAround, name="pen"):
    """Pens: the basal rate is injected as long-acting insulin, and boluses in steps of half a unit.

    Injections are some times a day, and a long-acting dose is the basal insulin that was requested since the last one.

    Examples
    --------
    >>> round(Pen("glargine", dose_U_kg=0.25).action_min / 60.0)
    25
    """

    insulin: Annotated[LongActing, About("Long-acting insulin."), HOST] = "glargine"
    injections: Annotated[int, About("Injections of it a day, at even distances.", at_least=1, at_most=4), HOST] = 1
    at_min: Annotated[
        float,
        About("Time of one of the daily injections, from the start; 22h.", at_least=0.0, below=MIN_PER_DAY),
        HOST,
    ] = 1320.0
    dose_step_U: Annotated[
        float,
        About("Step to which a long-acting dose is rounded.", above=0.0, at_most=10.0, quantity=BOLUS_STEP),
        HOST,
    ] = 0.5
    dose_U_kg: Annotated[
        float,
        About("Daily dose in U for each kg, from which the duration of the action follows.", above=0.0, at_most=3.0),
        HOST,
    ] = 0.25

    _: KW_ONLY
    min_bolus_U: float = 0.5
    bolus_step_U: float = 0.5
    sample_time_min: float = wired(STATIC, default=5.0)

    @derived
    def dose_step_mU(self) -> float:
        """Step of a long-acting dose."""
        return MU_PER_U * self.dose_step_U

    @derived_static
    def action_min(self) -> float:
        """Time from an injection of long-acting insulin to the end of its action."""
        hours, per_U_kg, _ = LONG_ACTING[self.insulin]
        return MIN_PER_H * (hours + per_U_kg * self.dose_U_kg / self.injections)

    @derived_static
    def peak_min(self) -> float:
        """Time from an injection to the largest action."""
        return self.action_min / LONG_ACTING[self.insulin][2]

    @derived_static
    def every(self) -> int:
        """Samples from one injection to the next."""
        return max(1, round(MIN_PER_DAY / self.injections / self.sample_time_min))

    @derived_static
    def first(self) -> int:
        """Samples from the start to the first injection."""
        return round(self.at_min / self.sample_time_min) % self.every

    @property
    def _every_min(self) -> float:
        return self.every * self.sample_time_min

    def init(self, insulin_mU_min: jax.Array, key: jax.Array) -> _State:
        """State of a person who has long injected what the given rate is in a day."""
        number = math.ceil(self.action_min / self._every_min) + 1
        since_min = self._every_min - self.first * self.sample_time_min
        zero = jnp.zeros_like(insulin_mU_min)
        dose = self._rounded(insulin_mU_min * self._every_min)
        return _State(
            inner=self.inner.init(insulin_mU_min, key),
            dose_mU=jnp.stack([dose] * number),
            since_min=jnp.stack([zero + since_min + i * self._every_min for i in range(number)]),
            requested_mU=insulin_mU_min * since_min,
        )

    def deliver(
        self, state: _State, command_mU_min: jax.Array, key: jax.Array, bolus_mU: jax.Array | None = None
    ) -> tuple[_State, Delivery]:
        """Deliver what the long-acting insulin releases until the next command, after an injection if one is due.

        A dose is the basal insulin that was asked for since the last one, and is reported as a constant rate.
        """
        inner, delivery = deliver(self.inner, state.inner, command_mU_min, key, bolus_mU)
        due = state.since_min[0] > self._every_min - 0.5 * self.sample_time_min
        dose = jnp.concatenate([self._rounded(state.requested_mU)[None], state.dose_mU[:-1]])
        since = jnp.concatenate([jnp.zeros_like(state.since_min[:1]), state.since_min[:-1]])
        dose, since = jnp.where(due, dose, state.dose_mU), jnp.where(due, since, state.since_min)
        later = jnp.minimum(since + self.sample_time_min, 2.0 * self.action_min + self._every_min)
        released = jnp.sum(dose * (self._left(since) - self._left(later)), axis=0)
        requested_mU = jnp.where(due, 0.0, state.requested_mU) + delivery.insulin_mU_min * self.sample_time_min
        return _State(inner=inner, dose_mU=dose, since_min=later, requested_mU=requested_mU), Delivery(
            insulin_mU_min=released / self.sample_time_min,
            reported_mU_min=dose[0] / self._every_min,
            bolus_mU=delivery.bolus_mU,
            reported_bolus_mU=delivery.reported_bolus_mU,
        )

    def _left(self, since_min: jax.Array) -> jax.Array:
        left: jax.Array = insulin_left(since_min, self.action_min, self.peak_min)
        return left

    def _rounded(self, dose_mU: jax.Array) -> jax.Array:
        """The nearest dose of whole steps."""
        return jnp.floor(dose_mU / self.dose_step_mU + 0.5) * self.dose_step_mU
