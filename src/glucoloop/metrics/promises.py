"""Promises that every loop keeps at every sample, whatever fails in it, and the count of broken ones."""

from __future__ import annotations

import functools
import math
import operator
from collections.abc import Iterable, Mapping
from typing import Any, Final

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from glucoloop._pytree import pytree, static
from glucoloop.control import GuardSettings
from glucoloop.control.guard_doses import MAX_BOLUS_MU
from glucoloop.control.protocol import Decision, Status
from glucoloop.faults import Episode
from glucoloop.patients.component import Sound
from glucoloop.pumps.limits import DEFAULT_BOLUS_LIMITS, PARKER_1999_LIMITS, DoseLimits
from glucoloop.simulation.person_loop import SampledInside
from glucoloop.units import MIN_PER_H

ROUNDING: Final = {"float64": 1e-9, "float32": 3e-5}
"""Rounding that breaks no promise, by precision: a part of the amounts of an hour."""
_ROUNDING: Final = ROUNDING["float64"]


@pytree
class _InsulinSums:
    """Insulin counted so far."""

    on_board: jax.Array
    """Insulin on board beyond the basal rate, in basal rates; never below 0."""
    hour_mU_min: jax.Array
    """(samples, ...) rates of somewhat more than the last hour, each at least the basal rate."""
    hour_bolus_mU: jax.Array
    """(samples, ...) boluses of that time."""


@pytree
class Counted:
    """Insulin counted so far, by what was asked for and by what was reported, and whether the caps bind the latter."""

    basal_mU_min: jax.Array
    by_request: _InsulinSums
    """Insulin that the pump can have given if it gives no more than was requested."""
    by_report: _InsulinSums
    """The same, or what it reports where that is more."""
    rate_mU_min: jax.Array
    """Largest rate of the last sample by request."""
    requested_mU_min: jax.Array
    """The last rate that was asked for."""
    requested_bolus_mU: jax.Array
    """The last bolus that was asked for; 0 for a controller that gives none."""
    binds: jax.Array
    """1 while the caps bind what was reported, else 0."""


@pytree
class Caps:
    """The caps of one guard, computed independently from its inputs and outputs.

    It shares no code with the guard: insulin on board and in an hour are summed up here a second time, the hour over
    every window of 60 min that ends in the coming sample and can be the largest. A bolus counts whole at the beginning
    of its sample.

    The caps bind what was asked for at every sample, whatever the pump reports. Of a rate that falls, the minimum that
    counts is what a pump comes down to that keeps its rate limit. What a pump reports beyond that counts too: the caps
    bind the larger sums until it reports more than it can have been asked for, and again once the pump is back at the
    basal rate and both sums are within their caps; see `control.guard_doses` for why they then hold at every sample.
    """

    settings: GuardSettings = static()
    limits: DoseLimits = PARKER_1999_LIMITS
    sample_time_min: float = static(default=5.0)
    rounding: float = static(default=_ROUNDING)

    def init(self, basal_mU_min: jax.Array) -> Counted:
        """State after a long time at the basal rate."""
        hour = math.ceil(MIN_PER_H / self.sample_time_min) + 1, *jnp.shape(basal_mU_min)
        none = jnp.zeros_like(basal_mU_min)
        sums = _InsulinSums(
            on_board=none,
            hour_mU_min=jnp.broadcast_to(basal_mU_min, hour),
            hour_bolus_mU=jnp.broadcast_to(none, hour),
        )
        return Counted(
            basal_mU_min=basal_mU_min,
            by_request=sums,
            by_report=sums,
            rate_mU_min=basal_mU_min,
            requested_mU_min=basal_mU_min,
            requested_bolus_mU=none,
            binds=jnp.ones_like(basal_mU_min),
        )

    def step(
        self,
        counted: Counted,
        reported_mU_min: jax.Array,
        requested_mU_min: jax.Array,
        reported_bolus_mU: jax.Array | None = None,
        requested_bolus_mU: jax.Array | None = None,
    ) -> tuple[Counted, jax.Array]:
        """Count the insulin of the last sample, and say whether both caps hold for the next dose.

        An impossible report counts as none. Without boluses they are None.
        """
        basal, change = counted.basal_mU_min, self.limits.max_change_mU_min
        none, rounding = jnp.zeros_like(basal), self.rounding * self.limits.max_mU_min
        report = none if reported_bolus_mU is None else reported_bolus_mU
        bolus = none if requested_bolus_mU is None else requested_bolus_mU
        rate = jnp.maximum(counted.requested_mU_min, counted.rate_mU_min - change)
        possible = (reported_mU_min >= 0.0) & (reported_mU_min <= 2.0 * self.limits.max_mU_min)
        larger = jnp.where(possible, jnp.maximum(reported_mU_min, rate), rate)
        possible = (report >= 0.0) & (report <= MAX_BOLUS_MU)
        larger_bolus = jnp.where(possible, jnp.maximum(report, counted.requested_bolus_mU), counted.requested_bolus_mU)
        by_request = self._with(counted.by_request, rate, counted.requested_bolus_mU, basal)
        by_report = self._with(counted.by_report, larger, larger_bolus, basal)
        within = self._hold(by_report, basal, none, basal) & (by_report.on_board <= self._most_on_board)
        more = (larger > rate + rounding) | (larger_bolus > counted.requested_bolus_mU * (1.0 + self.rounding))
        binds = jnp.where(more, 0.0, counted.binds)
        binds = jnp.where((larger <= basal) & (larger_bolus <= 0.0) & within, 1.0, binds)
        after = Counted(
            basal_mU_min=basal,
            by_request=by_request,
            by_report=by_report,
            rate_mU_min=rate,
            requested_mU_min=requested_mU_min,
            requested_bolus_mU=bolus,
            binds=binds,
        )
        coming = jnp.maximum(requested_mU_min, rate - change)
        reported_coming = jnp.maximum(requested_mU_min, larger - change)
        kept = self._hold(by_request, coming, bolus, basal)
        return after, kept & (self._hold(by_report, reported_coming, bolus, basal) | (binds < 0.5))

    def _with(self, sums: _InsulinSums, rate_mU_min: jax.Array, bolus_mU: jax.Array, basal: jax.Array) -> _InsulinSums:
        """The sums with one more sample."""
        return _InsulinSums(
            on_board=self._on_board(sums.on_board, rate_mU_min + bolus_mU / self.sample_time_min, basal),
            hour_mU_min=jnp.concatenate([sums.hour_mU_min[1:], jnp.maximum(rate_mU_min, basal)[None]]),
            hour_bolus_mU=jnp.concatenate([sums.hour_bolus_mU[1:], bolus_mU[None]]),
        )

    def _hold(self, sums: _InsulinSums, rate_mU_min: jax.Array, bolus_mU: jax.Array, basal: jax.Array) -> jax.Array:
        """Whether both caps hold while a rate and a bolus are given in the coming sample."""
        at_once = sums.on_board + bolus_mU / (self.settings.on_board_tau_min * basal)
        later = self._on_board(sums.on_board, rate_mU_min + bolus_mU / self.sample_time_min, basal)
        on_board = jnp.maximum(at_once, later) <= self._most_on_board
        return on_board & self._hours_hold(sums, jnp.maximum(rate_mU_min, basal), bolus_mU, basal)

    def _hours_hold(
        self, sums: _InsulinSums, rate_mU_min: jax.Array, bolus_mU: jax.Array, basal: jax.Array
    ) -> jax.Array:
        """Whether no window of 60 min that ends in the coming sample holds more than its cap."""
        of_rates, of_boluses = _windows(sums.hour_mU_min.shape[0], self.sample_time_min)
        rates = jnp.concatenate([sums.hour_mU_min, rate_mU_min[None]])
        boluses = jnp.concatenate([sums.hour_bolus_mU, bolus_mU[None]])
        fulfilled = jnp.tensordot(of_rates, rates, 1) + jnp.tensordot(of_boluses, boluses, 1)
        return jnp.max(fulfilled, axis=0) <= self.settings.max_hour * MIN_PER_H * basal * (1.0 + self.rounding)

    @property
    def _most_on_board(self) -> float:
        return self.settings.max_on_board * (1.0 + self.rounding) + self.rounding

    def _on_board(self, before: jax.Array, rate_mU_min: jax.Array, basal_mU_min: jax.Array) -> jax.Array:
        left = math.exp(-self.sample_time_min / self.settings.on_board_tau_min)
        return jnp.maximum(before * left + (rate_mU_min / basal_mU_min - 1.0) * (1.0 - left), 0.0)


def _windows(past: int, sample_time_min: float) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """(windows, past + 1) minutes of each sample in windows of 60 min, and whether its bolus is in them.

    The last sample is the coming one. What a window holds is linear in the time of its end as long as neither end
    passes the border of a sample, so that no other windows need to be looked at.
    """
    begins = sample_time_min * np.arange(-past, 1)
    ends = np.array([0.0, sample_time_min])
    inside = begins + MIN_PER_H
    ends = np.concatenate([ends, inside[(inside > 0.0) & (inside < sample_time_min)]])[:, None]
    minutes = np.minimum(ends, begins + sample_time_min) - np.maximum(ends - MIN_PER_H, begins)
    hair = _ROUNDING * sample_time_min
    holds = (begins >= ends - MIN_PER_H - hair) & (begins <= ends + hair)
    return np.maximum(minutes, 0.0), holds.astype(float)


DOSE: Final = "dose delivered, rate and bolus: finite, and within the pump's range"
COMMAND: Final = "dose asked for, rate and bolus: finite, and within the pump's range"
RATE: Final = "dose asked for: within the rate limit of the last report, or of the last request"
CAPS: Final = "dose asked for by a guard: within its caps on board and per hour"
STATUS: Final = "status: a known one"
CONTROLLER: Final = "state of the controller: finite"
PUMP: Final = "state of the pump: finite"
FAULTS: Final = "clock of every fault: a whole number of samples"
PATIENT: Final = "state of the patient: finite"
INSULIN_THERE: Final = "insulin in every organ, and glucagon: not below zero"
GLUCOSE_THERE: Final = "glucose in every organ: not below what uptake explains"

OF_CONTROLLER: Final = (COMMAND, RATE, CAPS, STATUS, CONTROLLER)
PROMISES: Final = (DOSE, *OF_CONTROLLER, PUMP, FAULTS, PATIENT, INSULIN_THERE, GLUCOSE_THERE)

LOW_MG_DL: Final = 60.0


def all_finite(tree: Any) -> jax.Array:
    """Whether all numbers of one person are finite."""
    leaves = map(jnp.asarray, jax.tree.leaves(tree))
    return _all(jnp.all(jnp.isfinite(leaf)) for leaf in leaves if jnp.issubdtype(leaf.dtype, jnp.inexact))


def _clocks_and_others(state: Any) -> tuple[jax.Array, list[Any]]:
    """Whether the clocks of all faults in a state are valid, and the rest of the state."""
    parts = jax.tree.leaves(state, is_leaf=lambda part: isinstance(part, Episode))
    clocks = _all(_is_valid(part) for part in parts if isinstance(part, Episode))
    return clocks, [part for part in parts if not isinstance(part, Episode)]


def _is_valid(clock: Episode) -> jax.Array:
    """Whether the age is a whole number of -1 or more and the time until the onset is a number, or never comes."""
    age, until = clock.age, clock.until
    whole = jnp.isfinite(age) & (age >= -1.0) & (jnp.floor(age) == age)
    return whole & (until == until) & (until > -jnp.inf)


def _all(holds: Iterable[jax.Array]) -> jax.Array:
    return functools.reduce(operator.and_, holds, jnp.asarray(True))


@pytree
class _PromiseTally:
    """Observations of a loop so far."""

    lowest_mg_dl: jax.Array
    """Minimum arterial glucose on the fine grid."""
    below_60: jax.Array
    """Number of points of the fine grid below 60 mg/dl."""
    broken: jax.Array
    """(promises, ...) number of samples at which each was broken."""
    first_min: jax.Array
    """(promises, ...) time at which each was first broken; infinite for never."""
    requested_mU_min: jax.Array
    """The last rate that was asked for."""
    counted: Counted | None
    """State of the caps of a guard; None without one."""


@pytree
class Promises:
    """Checks every promise at every sample; implements `simulation.cohort.Accumulator`."""

    limits: DoseLimits = PARKER_1999_LIMITS
    sound: Sound = static()
    """Promises of the patient about its states; see `PatientComponent.sound`."""
    caps: Caps | None = None
    """Caps of the guard; None without one, for which that promise counts as kept."""

    def init(self, glucose_mg_dl: jax.Array, insulin_mU_min: jax.Array) -> _PromiseTally:
        """State with no promise broken."""
        none = jnp.zeros((len(PROMISES), *jnp.shape(glucose_mg_dl)), jnp.result_type(float, glucose_mg_dl))
        return _PromiseTally(
            lowest_mg_dl=glucose_mg_dl,
            below_60=jnp.zeros_like(glucose_mg_dl),
            broken=none,
            first_min=none + jnp.inf,
            requested_mU_min=insulin_mU_min,
            counted=None if self.caps is None else self.caps.init(insulin_mU_min),
        )

    def step(self, tally: _PromiseTally, happened: SampledInside, t_min: jax.Array) -> _PromiseTally:
        """Check a sample, and include the time until the next."""
        counted, within_caps = tally.counted, jnp.ones_like(tally.below_60, bool)
        if self.caps is not None and counted is not None:
            reported, decision = happened.before, happened.decision
            counted, within_caps = self.caps.step(
                counted,
                reported.reported_mU_min,
                decision.insulin_mU_min,
                reported.reported_bolus_mU,
                decision.bolus_mU,
            )
        broken = breaches(self.fulfilled(happened, tally.lowest_mg_dl, tally.requested_mU_min, within_caps))
        below = jnp.where(happened.inside_mg_dl < LOW_MG_DL, 1.0, 0.0)
        return _PromiseTally(
            lowest_mg_dl=jnp.minimum(tally.lowest_mg_dl, jnp.min(happened.inside_mg_dl, axis=0)),
            below_60=tally.below_60 + jnp.sum(below, axis=0),
            broken=tally.broken + broken,
            first_min=jnp.where((broken > 0.0) & (tally.broken == 0.0), t_min, tally.first_min),
            requested_mU_min=happened.decision.insulin_mU_min,
            counted=counted,
        )

    def fulfilled(
        self,
        happened: SampledInside,
        lowest_mg_dl: jax.Array,
        requested_mU_min: jax.Array,
        within_caps: jax.Array | bool = True,
    ) -> dict[str, jax.Array]:
        """Whether each promise is kept at a sample, ``(...)`` each; NaN keeps none.

        `requested_mU_min` is the rate that was asked for at the sample before.
        """
        delivery, after, most_mU = happened.delivery, happened.after, DEFAULT_BOLUS_LIMITS.max_mU
        # readings that a sensor keeps may be any number, since some faults give such readings
        clocks_of_sensor, _ = _clocks_and_others(after.in_sensor)
        clocks_of_pump, others_of_pump = _clocks_and_others(after.in_pump)
        insulin_there, glucose_there = self.sound(happened.x, lowest_mg_dl)
        return {
            DOSE: _in_range(self.limits, most_mU, delivery.insulin_mU_min, delivery.bolus_mU),
            **promises_of_controller(
                self.limits,
                most_mU,
                happened.decision,
                happened.before.reported_mU_min,
                requested_mU_min,
                after.in_controller,
                within_caps,
            ),
            PUMP: all_finite(others_of_pump),
            FAULTS: clocks_of_pump & clocks_of_sensor,
            PATIENT: jnp.all(jnp.isfinite(happened.x), axis=0),
            INSULIN_THERE: insulin_there,
            GLUCOSE_THERE: glucose_there,
        }


def promises_of_controller(
    limits: DoseLimits,
    most_mU: Any,
    decision: Decision,
    reported_mU_min: jax.Array,
    requested_mU_min: jax.Array,
    state: Any,
    within_caps: jax.Array | bool,
    rounding: float = _ROUNDING,
) -> dict[str, jax.Array]:
    """Whether each promise of a controller is kept by a decision, whose bolus may be so large at most.

    `reported_mU_min` and `requested_mU_min` are the rates that were reported and asked for of the last sample.
    """
    command = decision.insulin_mU_min
    # a report that no pump can mean is no rate from which a change could be too large
    meant = (reported_mU_min >= limits.min_mU_min) & (reported_mU_min <= limits.max_mU_min)
    # a pump that reports more than it was asked for may be wrong, and goes down by itself as fast as it can
    change = limits.max_change_mU_min + rounding * limits.max_mU_min
    slow = (command - reported_mU_min <= change) & (jnp.minimum(reported_mU_min, requested_mU_min) - command <= change)
    return {
        COMMAND: _in_range(limits, most_mU, command, decision.bolus_mU),
        RATE: slow | ~meant,
        CAPS: jnp.asarray(within_caps),
        STATUS: functools.reduce(operator.or_, [decision.status == int(known) for known in Status]),
        CONTROLLER: all_finite(state),
    }


def breaches(fulfilled: Mapping[str, jax.Array]) -> jax.Array:
    """(promises, ...) 1 for each promise that is broken, else 0."""
    return jnp.where(jnp.stack(list(fulfilled.values())), 0.0, 1.0)


def _in_range(limits: DoseLimits, most_mU: Any, rate: jax.Array, bolus_mU: jax.Array | None) -> jax.Array:
    there = jnp.isfinite(rate) & (rate >= limits.min_mU_min) & (rate <= limits.max_mU_min)
    return there if bolus_mU is None else there & (bolus_mU >= 0.0) & (bolus_mU <= most_mU)
