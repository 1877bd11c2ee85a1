"""Faults of a pump, each one class: its settings, and what is delivered and reported in place of the inner pump's dose.

A fault wraps any pump, by default one with the limits of the paper, and faults wrap one another.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable
from dataclasses import KW_ONLY
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Final, Literal

from glucoloop._lazy_jax import jax, jnp
from glucoloop.component.pytree_component import DATA, HOST, derived, wired
from glucoloop.component.setting import About
from glucoloop.faults.fault import FaultComponent, FaultState, Timed, Untimed
from glucoloop.faults.schedule import Episodes, recurring
from glucoloop.pumps.expiring import Expiring
from glucoloop.pumps.limits import DoseLimits, LimitedPump
from glucoloop.pumps.protocol import Delivery, Pump, deliver
from glucoloop.pumps.resolution import MinimumRate, Step, WholeSteps

_NO_STEP: Final = 2.0**-1000
"""A resolution by which no dose is changed: to divide by a power of two is exact."""
Noticed = Annotated[bool, About("Whether the pump reports the fault: true or false.")]


class PumpFault(FaultComponent):
    """A fault around a pump.

    One that changes single deliveries has the method `altered`; one that remembers has `start` and `respond`.
    """

    part: ClassVar[Literal["sensor", "pump"]] = "pump"

    _: KW_ONLY
    inner: Pump = wired(DATA, default_factory=LimitedPump)

    if TYPE_CHECKING:

        @property
        def episodes(self) -> Episodes:
            """Times at which the fault is present."""

    def init(self, insulin_mU_min: jax.Array, key: jax.Array) -> FaultState:
        """State before the first command; what is inside has the same key as without the fault."""
        return FaultState(
            inner=self.inner.init(insulin_mU_min, key),
            episode=self.episodes.init(insulin_mU_min, key),
            memory=self.start(insulin_mU_min),
        )

    def deliver(
        self, state: FaultState, command_mU_min: jax.Array, key: jax.Array, bolus_mU: jax.Array | None = None
    ) -> tuple[FaultState, Delivery]:
        """Deliver as the inner pump does, or what the fault makes of it."""
        inner, delivery = deliver(self.inner, state.inner, command_mU_min, key, bolus_mU)
        episode, age = self.episodes.step(state.episode, key)
        memory, altered = self.respond(state.memory, delivery, age >= 0.0)
        return FaultState(inner=inner, episode=episode, memory=memory), altered

    def start(self, insulin_mU_min: jax.Array) -> Any:
        """Memory of the fault after a long time at a rate without a bolus; none by default."""
        return None

    def respond(self, memory: Any, delivery: Delivery, present: jax.Array) -> tuple[Any, Delivery]:
        """Memory after a delivery of the inner pump, and the delivery in place of it."""
        return memory, self.altered(delivery, present)

    def altered(self, delivery: Delivery, present: jax.Array) -> Delivery:
        """Delivery in place of the inner pump's, which it is where the fault is not `present`."""
        raise NotImplementedError


def _delivering(delivery: Delivery, change: Callable[[jax.Array], jax.Array]) -> Delivery:
    """A delivery with another rate and bolus, if it has one; the reports stay."""
    bolus_mU = None if delivery.bolus_mU is None else change(delivery.bolus_mU)
    return dataclasses.replace(delivery, insulin_mU_min=change(delivery.insulin_mU_min), bolus_mU=bolus_mU)


def _reporting(delivery: Delivery, change: Callable[[jax.Array], jax.Array]) -> Delivery:
    """A delivery with other reports."""
    bolus_mU = None if delivery.reported_bolus_mU is None else change(delivery.reported_bolus_mU)
    return dataclasses.replace(delivery, reported_mU_min=change(delivery.reported_mU_min), reported_bolus_mU=bolus_mU)


def _passing(delivery: Delivery, present: jax.Array, fraction: float, *, noticed: bool) -> Delivery:
    """A delivery of which a fraction passes the line; with `noticed` the pump reports what passes it."""

    def passed(dose: jax.Array) -> jax.Array:
        return jnp.where(present, fraction * dose, dose)

    through = _delivering(delivery, passed)
    if not noticed:
        return through
    reports = (delivery.reported_mU_min, delivery.reported_bolus_mU)
    doses = (through.insulin_mU_min, through.bolus_mU)
    rate, bolus = jax.tree.map(lambda dose, report: jnp.where(present, dose, report), doses, reports)
    return dataclasses.replace(through, reported_mU_min=rate, reported_bolus_mU=bolus)


class CoarseDelivery(WholeSteps, Untimed, name="resolution"):
    """Whole steps alone are delivered, from a minimum dose on; the remainder is delivered later."""

    part: ClassVar[Literal["sensor", "pump"]] = "pump"
    comes_and_goes: ClassVar = False
    idle: ClassVar = {"step_mU_min": _NO_STEP, "least_mU_min": 0.0}
    step_mU_min: Step = 0.5
    least_mU_min: MinimumRate = 0.0
    drawn: ClassVar = {
        "step_mU_min": lambda even: 2.0 ** (even(-4.0, 4.0) // 1.0),
        "least_mU_min": lambda even: 2.0 ** (even(-4.0, 4.0) // 1.0) * (even(0.0, 4.0, 1) // 1.0),
    }

    _: KW_ONLY
    inner: Pump = wired(DATA, default_factory=LimitedPump)
    limits: DoseLimits = wired(DATA, default=None)


class Battery(PumpFault, Timed, name="battery"):
    """The pump is off, reports nothing, and starts again from rest.

    It delivers neither rate nor bolus; then the inner pump starts from no insulin. All inner parts start again, faults
    and their planned times included: put other faults around this one.
    """

    def deliver(
        self, state: FaultState, command_mU_min: jax.Array, key: jax.Array, bolus_mU: jax.Array | None = None
    ) -> tuple[FaultState, Delivery]:
        """Deliver as the inner pump does, or nothing while the fault is present."""
        inner, delivery = deliver(self.inner, state.inner, command_mU_min, key, bolus_mU)
        episode, age = self.episodes.step(state.episode, key)
        off = age >= 0.0
        stopped = self.inner.init(jnp.zeros_like(delivery.insulin_mU_min), key)
        inner = jax.tree.map(lambda rest, running: jnp.where(off, rest, running), stopped, inner)
        delivery = _delivering(delivery, lambda dose: jnp.where(off, 0.0, dose))
        delivery = _reporting(delivery, lambda report: jnp.where(off, jnp.nan, report))
        return FaultState(inner=inner, episode=episode, memory=None), delivery


class MissedPulses(PumpFault, Untimed, name="missed-pulses"):
    """Single doses at random are not delivered.

    Neither the basal rate of such a sample nor its bolus reaches the person; samples are independent.
    """

    each_sample: ClassVar = "share"
    share: Annotated[float, About("Share of the doses that are missed.", at_least=0.0, at_most=1.0), HOST] = 0.2
    noticed: Noticed = False

    @derived
    def episodes(self) -> Episodes:
        """Single samples at random."""
        return recurring(self.share, key=self.key or 0)

    def altered(self, delivery: Delivery, present: jax.Array) -> Delivery:
        """Delivery without insulin."""
        return _passing(delivery, present, 0.0, noticed=self.noticed)


class Occlusion(PumpFault, Timed, name="occlusion"):
    """Less insulin passes the line than the pump drives.

    Insulin that does not pass is lost, not delivered later: of the basal rate, and of a bolus.
    """

    both: ClassVar = "noticed"
    open_fraction: Annotated[float, About("Part of the insulin that is delivered.", at_least=0.0, below=1.0)] = 0.0
    noticed: Noticed = False
    drawn: ClassVar = {"open_fraction": lambda even: (even(0.0, 1.0) >= 0.5) * even(0.0, 0.95, 1)}

    def altered(self, delivery: Delivery, present: jax.Array) -> Delivery:
        """A fraction of the dose."""
        return _passing(delivery, present, self.open_fraction, noticed=self.noticed)


class Unheard(PumpFault, Timed, name="unheard"):
    """Commands do not reach the pump, which goes to its minimum rate.

    It has no number as rate and bolus, so that it gives no bolus. The default inner pump has commands that expire.
    """

    _: KW_ONLY
    inner: Pump = wired(DATA, default_factory=Expiring)

    def deliver(
        self, state: FaultState, command_mU_min: jax.Array, key: jax.Array, bolus_mU: jax.Array | None = None
    ) -> tuple[FaultState, Delivery]:
        """Deliver as the inner pump does, with the command or with none."""
        episode, age = self.episodes.step(state.episode, key)
        present = age >= 0.0
        command = jnp.where(present, jnp.nan, command_mU_min)
        bolus = None if bolus_mU is None else jnp.where(present, jnp.nan, bolus_mU)
        inner, delivery = deliver(self.inner, state.inner, command, key, bolus)
        return FaultState(inner=inner, episode=episode, memory=None), delivery


_Part: Final = functools.partial(About, at_least=0.0, at_most=10.0)


class Misreported(PumpFault, Timed, name="misreported"):
    """The pump gives what it is asked for and reports a part of it, a multiple, or the dose of the sample before."""

    rate_part: Annotated[float, _Part("Part of the basal rate that is reported; 2 for twice as much.")] = 0.0
    bolus_part: Annotated[float, _Part("Part of a bolus that is reported; 2 for twice as much.")] = 0.0
    late_samples: Annotated[int, About("Samples by which the report is late, 0 or 1.", at_least=0, at_most=1), DATA] = 0
    drawn: ClassVar = {
        "rate_part": lambda even: (even(0.0, 1.0) >= 0.3) * even(0.0, 2.0, 1),
        "bolus_part": lambda even: (even(0.0, 1.0, 2) >= 0.3) * even(0.0, 2.0, 3),
        "late_samples": lambda even: even(0.0, 2.0, 4) // 1.0,
    }

    def start(self, insulin_mU_min: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Last rate and bolus that the inner pump reported."""
        return insulin_mU_min, jnp.zeros_like(insulin_mU_min)

    def respond(
        self, memory: tuple[jax.Array, jax.Array], delivery: Delivery, present: jax.Array
    ) -> tuple[tuple[jax.Array, jax.Array], Delivery]:
        """The same delivery with another report."""
        late = jnp.asarray(self.late_samples) > 0.5

        def report(correct: jax.Array, before: jax.Array, part: float) -> jax.Array:
            return jnp.where(present, part * jnp.where(late, before, correct), correct)

        rate, bolus = delivery.reported_mU_min, delivery.reported_bolus_mU
        # a pump without power reports nothing: the last report that there was is remembered
        latest = jnp.where(jnp.isfinite(rate), rate, memory[0])
        latest_bolus = memory[1] if bolus is None else jnp.where(jnp.isfinite(bolus), bolus, memory[1])
        return (latest, latest_bolus), dataclasses.replace(
            delivery,
            reported_mU_min=report(rate, memory[0], self.rate_part),
            reported_bolus_mU=None if bolus is None else report(bolus, memory[1], self.bolus_part),
        )
