"""Promises that every loop keeps at every sample, whatever fails in it, and the count of broken ones."""

from __future__ import annotations

import functools
import operator
from typing import Final, cast

import jax
import jax.numpy as jnp

from glucoloop._pytree import pytree, static
from glucoloop.control.protocol import Status
from glucoloop.patients.model import Sound
from glucoloop.pumps.limits import PARKER_1999_LIMITS, USUAL_BOLUS_LIMITS, BolusLimits, DoseLimits
from glucoloop.simulation.loop import Sampled
from glucoloop.studies.verification.caps import Caps, Counted
from glucoloop.studies.verification.watched import WatchedDecision, WatchedDelivery, WatchedReading

DOSE: Final = "dose delivered, rate and bolus: finite, and within the pump's range"
COMMAND: Final = "dose asked for, rate and bolus: finite, and within the pump's range"
RATE: Final = "dose asked for: within the rate limit of what the pump reported"
CAPS: Final = "dose asked for by a guard: within its caps on board and per hour"
STATUS: Final = "status: a known one"
CONTROLLER: Final = "state of the controller: finite"
PUMP: Final = "state of the pump: finite"
FAULTS: Final = "clock of every fault: a whole number of samples"
PATIENT: Final = "state of the patient: finite"
INSULIN_THERE: Final = "insulin in every organ, and glucagon: not below zero"
GLUCOSE_THERE: Final = "glucose in every organ: not below what uptake explains"

PROMISES: Final = (
    *(DOSE, COMMAND, RATE, CAPS, STATUS, CONTROLLER),
    *(PUMP, FAULTS, PATIENT, INSULIN_THERE, GLUCOSE_THERE),
)

LOW_MG_DL: Final = 60.0
_ROUNDING_MU_MIN: Final = 1e-9


@pytree
class Kept:
    """Observations of a loop so far."""

    lowest_mg_dl: jax.Array
    """Least arterial glucose on the fine grid."""
    below_60: jax.Array
    """Number of points of the fine grid below 60 mg/dl."""
    broken: jax.Array
    """(promises, ...) number of samples at which each was broken."""
    first_min: jax.Array
    """(promises, ...) time at which each was first broken; infinite for never."""
    counted: Counted | None
    """State of the caps of a guard; None without one."""


@pytree
class Promises:
    """Checks every promise at every sample; implements `simulation.cohort.Fold`.

    Controller, sensor and pump have to be watched, see `watched`.
    """

    limits: DoseLimits = PARKER_1999_LIMITS
    sound: Sound = static()
    """Promises of the patient about its states; see `PatientModel`."""
    bolus: BolusLimits = USUAL_BOLUS_LIMITS
    caps: Caps | None = None
    """Caps of the guard; None without one, for which that promise counts as kept."""

    def init(self, glucose_mg_dl: jax.Array, insulin_mU_min: jax.Array) -> Kept:
        """State with no promise broken."""
        none = jnp.zeros((len(PROMISES), *jnp.shape(glucose_mg_dl)), jnp.result_type(float, glucose_mg_dl))
        return Kept(
            lowest_mg_dl=glucose_mg_dl,
            below_60=jnp.zeros_like(glucose_mg_dl),
            broken=none,
            first_min=none + jnp.inf,
            counted=None if self.caps is None else self.caps.init(insulin_mU_min),
        )

    def step(self, kept: Kept, happened: Sampled, t_min: jax.Array) -> Kept:
        """Check a sample, and include the time until the next."""
        counted, within_caps = self._within_caps(kept.counted, happened)
        held = self.held(happened, kept.lowest_mg_dl, within_caps)
        broken = jnp.where(jnp.stack([held[name] for name in PROMISES]), 0.0, 1.0)
        below = jnp.where(happened.inside_mg_dl < LOW_MG_DL, 1.0, 0.0)
        return Kept(
            lowest_mg_dl=jnp.minimum(kept.lowest_mg_dl, jnp.min(happened.inside_mg_dl, axis=0)),
            below_60=kept.below_60 + jnp.sum(below, axis=0),
            broken=kept.broken + broken,
            first_min=jnp.where((broken > 0.0) & (kept.broken == 0.0), t_min, kept.first_min),
            counted=counted,
        )

    def _within_caps(self, counted: Counted | None, happened: Sampled) -> tuple[Counted | None, jax.Array]:
        decision = cast(WatchedDecision, happened.decision)
        if self.caps is None or counted is None:
            return counted, jnp.ones_like(decision.insulin_mU_min, bool)
        return self.caps.step(
            counted, decision.told_mU_min, decision.insulin_mU_min, decision.told_bolus_mU, decision.bolus_mU
        )

    def held(
        self, happened: Sampled, lowest_mg_dl: jax.Array, within_caps: jax.Array | bool = True
    ) -> dict[str, jax.Array]:
        """Whether each promise is kept at a sample, ``(...)`` each; NaN keeps none.

        Parameters
        ----------
        happened : Sampled
        lowest_mg_dl : (...) array
            Least arterial glucose so far.
        within_caps : (...) array
            Whether the rate asked for is within the caps of the guard, if there is one.
        """
        decision, reading = cast(WatchedDecision, happened.decision), cast(WatchedReading, happened.reading)
        delivery, limits, x = cast(WatchedDelivery, happened.delivery), self.limits, happened.x
        command, word = decision.insulin_mU_min, decision.told_mU_min
        meant = (word >= limits.min_mU_min) & (word <= limits.max_mU_min)
        slow = jnp.abs(command - word) <= limits.max_change_mU_min + _ROUNDING_MU_MIN
        insulin_there, glucose_there = self.sound(x, lowest_mg_dl)
        return {
            DOSE: self._in_range(delivery.insulin_mU_min, delivery.bolus_mU),
            COMMAND: self._in_range(command, decision.bolus_mU),
            RATE: slow | ~meant,
            CAPS: jnp.asarray(within_caps),
            STATUS: functools.reduce(operator.or_, [decision.status == int(known) for known in Status]),
            CONTROLLER: decision.sound,
            PUMP: delivery.sound,
            FAULTS: delivery.clocks & reading.clocks,
            PATIENT: jnp.all(jnp.isfinite(x), axis=0),
            INSULIN_THERE: insulin_there,
            GLUCOSE_THERE: glucose_there,
        }

    def _in_range(self, rate: jax.Array, bolus_mU: jax.Array | None) -> jax.Array:
        there = jnp.isfinite(rate) & (rate >= self.limits.min_mU_min) & (rate <= self.limits.max_mU_min)
        return there if bolus_mU is None else there & (bolus_mU >= 0.0) & (bolus_mU <= self.bolus.max_mU)
