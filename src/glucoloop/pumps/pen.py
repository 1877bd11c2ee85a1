"""Pens in place of a pump: the basal rate becomes injections of a long-acting insulin, and boluses are injected too.

The duration and the peak of the action of long-acting insulins are those of cgmsim-lib (https://github.com/lsandini/
cgmsim-lib, `src/drug.ts`, Apache-2.0), which draws the course between them as the exponential curve of
`glucoloop.therapy`. A pen is no new patient: what leaves the depot of the long-acting insulin enters the patient
as the rate of a pump does.
"""

from __future__ import annotations

import math
from typing import Any, Final

from glucoloop._lazy_jax import jax, jnp
from glucoloop._pytree import pytree, static
from glucoloop.arguments import checked
from glucoloop.pumps.limits import LimitedPump
from glucoloop.pumps.protocol import Delivery, Pump, deliver
from glucoloop.pumps.settings import LongActing, PenSettings
from glucoloop.refusal import Refusal
from glucoloop.therapy import insulin_left
from glucoloop.units import MIN_PER_DAY, MIN_PER_H, MU_PER_U

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


@pytree
class Pen:
    """Injects basal insulin some times a day, and boluses when they are asked for; make it with `pen`."""

    inner: Pump
    dose_step_mU: jax.Array | float
    action_min: float = static()
    """Time from an injection of long-acting insulin to the end of its action."""
    peak_min: float = static()
    every: int = static()
    """Samples from one injection to the next."""
    first: int = static()
    """Samples from the start to the first injection."""
    sample_time_min: float = static()

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
        return insulin_left(since_min, self.action_min, self.peak_min)

    def _rounded(self, dose_mU: jax.Array) -> jax.Array:
        """The nearest dose of whole steps."""
        return jnp.floor(dose_mU / self.dose_step_mU + 0.5) * self.dose_step_mU


@checked
def pen(
    insulin: LongActing = "glargine",
    injections: int = 1,
    at_min: float = 1320.0,
    dose_step_U: float = 0.5,
    dose_U_kg: float = 0.25,
    inner: Pump | None = None,
    *,
    sample_time_min: float = 5.0,
) -> Pen:
    """Pens with a long-acting and a rapid-acting insulin.

    Parameters
    ----------
    insulin : str
        Long-acting insulin: glargine, glargine-u300, detemir or degludec.
    injections : int
        Injections of it a day, at even distances.
    at_min : float
        Time of one of the daily injections, from the start.
    dose_step_U : float
        Step to which a long-acting dose is rounded.
    dose_U_kg : float
        Daily dose for each kg of body weight from which the duration of the action follows.

    Raises
    ------
    ValueError
        For a setting beyond its bounds.

    Examples
    --------
    >>> round(pen("glargine", dose_U_kg=0.25).action_min / 60.0)
    25
    """
    PenSettings(insulin=insulin, injections=injections, at_min=at_min, dose_step_U=dose_step_U, dose_U_kg=dose_U_kg)
    if not 0.0 < sample_time_min < math.inf:
        raise Refusal(f"a sample time of {sample_time_min:g} min is not possible; give a finite one above 0 min")
    hours, per_U_kg, to_peak = LONG_ACTING[insulin]
    action_min = MIN_PER_H * (hours + per_U_kg * dose_U_kg / injections)
    every = max(1, round(MIN_PER_DAY / injections / sample_time_min))
    return Pen(
        inner=LimitedPump() if inner is None else inner,
        dose_step_mU=MU_PER_U * dose_step_U,
        action_min=action_min,
        peak_min=action_min / to_peak,
        every=every,
        first=round(at_min / sample_time_min) % every,
        sample_time_min=sample_time_min,
    )
