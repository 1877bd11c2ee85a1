"""The closed loop of a patient here and a controller on a chip, and the same controller without a chip."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import jax.numpy as jnp

from glucoloop.control.protocol import Decision, Observation, Status
from glucoloop.firmware.exported import Exported
from glucoloop.firmware.hil.exchange import ANSWER_WITHIN_S, Exchange
from glucoloop.firmware.hil.faults import NOTHING, Disturbances, DisturbedLink
from glucoloop.firmware.hil.link import Link
from glucoloop.firmware.hil.protocol import WATCHDOG_MS, Payloads, record_bytes
from glucoloop.firmware.samples import Init, Leaves, Step, arithmetic, decision_of, equal, leaves_of, replayed
from glucoloop.meals.scenario import Scenario
from glucoloop.native.targets.c.host import Library, compiler
from glucoloop.native.targets.c.source import UNROLLED
from glucoloop.refusal import Refusal
from glucoloop.simulation import Trace
from glucoloop.simulation.stepper import Stepper, simulate_stepped

_HOLD_MIN: Final = 30.0
"""Time for which the fallback rate is no more than the last decided one; after it, it is the basal rate."""


@dataclass(frozen=True)
class _Fallback:
    """Rate of a pump that hears no decision.

    It never gives a bolus. With ``"basal"`` it is the smaller of the last decided rate and the basal rate for half an
    hour, so that a suspension lasts, and then the basal rate; with ``"suspend"`` it is 0. The pump keeps its limits.
    """

    kind: str
    basal_mU_min: float

    def rate_mU_min(self, last_mU_min: float, silent_min: float) -> float:
        """Rate of a sample, from the last decided rate and the time since the next decision was due."""
        if self.kind == "suspend":
            return 0.0
        return min(last_mU_min, self.basal_mU_min) if silent_min < _HOLD_MIN else self.basal_mU_min


@dataclass(frozen=True)
class OnChip:
    """A run with its controller on a chip."""

    trace: Trace
    answered: Sequence[bool]
    """Whether the chip decided in time, for each sample."""
    equal: Sequence[bool | None]
    """Whether each decision has the bits of the controller without a chip; None where none came, not even late."""
    late_boluses_mU: Sequence[float]
    """Boluses above 0 that were decided too late, and therefore not given."""
    sessions: Sequence[int]
    """Samples at which the controller was initialised again."""
    counts: dict[str, int]
    """Number of frames repeated and refused, and of each disturbance."""
    samples_per_s: float
    """Speed from the second sample on; the first waits for compiling."""

    @property
    def differing(self) -> list[int]:
        """Samples whose decision differs."""
        return [i for i, equal in enumerate(self.equal) if equal is False]


@dataclass
class Pace:
    """Real time: the loop waits for each sample. With a factor of 0 it does not wait."""

    sample_time_min: float
    seconds_per_min: float = 0.0
    longest_answer_s: float = ANSWER_WITHIN_S
    clock: Callable[[], float] = time.monotonic
    sleep: Callable[[float], None] = time.sleep
    _began: float | None = None

    def wait_for(self, sample: int) -> None:
        """Wait until a sample is due."""
        self._began = self.clock() if self._began is None else self._began
        if self.seconds_per_min:
            due = self._began + sample * self.sample_time_min * self.seconds_per_min
            self.sleep(max(0.0, due - self.clock()))

    @property
    def answer_within_s(self) -> float:
        """Time in which the chip has to answer."""
        if not self.seconds_per_min:
            return self.longest_answer_s
        return min(self.longest_answer_s, 0.5 * self.sample_time_min * self.seconds_per_min)


def run_on_chip(
    exported: Exported,
    stepper: Stepper,
    scenario: Scenario,
    link: Link,
    *,
    disturbances: Disturbances = NOTHING,
    seed: int = 0,
    fallback: str = "basal",
    pace: Pace | None = None,
    progress: Callable[[int], None] = lambda samples: None,
) -> OnChip:
    """Run a scenario with the controller on a chip, and compare its decisions with those without a chip.

    The patient is at the start of the scenario; the chip has the firmware of this controller, and is refused if it has
    another or does not answer the first observation. The disturbances follow from the seed; the loop does not wait
    unless a pace is given.
    """
    samples = round(scenario.horizon_min / stepper.sample_time_min)
    events, silent = disturbances.draw(samples, seed)
    payloads = Payloads(exported.source, exported.precision)
    line = DisturbedLink(link, record_bytes(exported.source, payloads))
    exchange = Exchange(line, exported.source.design, payloads.sizes)
    pace = Pace(stepper.sample_time_min) if pace is None else pace
    exchange.begin()
    pump = _Fallback(fallback, float(stepper.start.insulin_mU_min))
    observations: list[Leaves] = []
    answered: list[bool] = []
    last, silent_min = float(stepper.start.insulin_mU_min), 0.0
    begun: list[float] = []

    def decide(sample: int, observation: Observation) -> Decision:
        nonlocal last, silent_min
        pace.wait_for(sample)
        begun.append(time.monotonic())
        observations.append(leaves_of(observation, exported))
        payload, answer = payloads.observation(observations[-1]), None
        if sample in silent:
            exchange.keep(sample, payload)
        else:
            line.expect(events[sample])
            answer = exchange.decide(sample, payload, pace.answer_within_s)
            while line.pending and answer is not None and exchange.ask_again(sample, pace.answer_within_s) is not None:
                pass
        if answer is None and sample == 0:  # which has no outage
            raise Refusal(
                f"the chip did not answer the first observation within {pace.answer_within_s:g} s; a step may take "
                f"longer than its watchdog allows, {WATCHDOG_MS[exported.precision]} ms: take --precision float32, or "
                "a chip with a unit for float64"
            )
        answered.append(answer is not None)
        progress(1)
        if answer is None:
            rate = pump.rate_mU_min(last, silent_min)
            silent_min += stepper.sample_time_min
            return Decision(
                insulin_mU_min=jnp.asarray(rate),
                status=jnp.asarray(int(Status.NO_ANSWER)),
                bolus_mU=jnp.zeros(()) if exported.gives_boluses else None,
            )
        decision = decision_of(payloads.decision(answer), exported)
        last, silent_min = float(decision.insulin_mU_min), 0.0
        return decision

    trace = simulate_stepped(stepper, scenario, decide, gives_boluses=exported.gives_boluses)
    duration_s = time.monotonic() - begun[1] if samples > 1 else math.inf
    expected = _without_a_chip(exported, observations, exchange.sessions)
    decided = {i: payloads.decision(answer) for i, answer in exchange.answers.items()}
    same = [equal(decided[i], expected[i]) if i in decided else None for i in range(samples)]
    late = [decision_of(decided[i], exported) for i in sorted(decided) if not answered[i]]
    boluses = [float(decision.bolus_mU) for decision in late if decision.bolus_mU is not None]
    counts = {
        "frames sent again": exchange.repeated,
        "frames refused here": exchange.refused,
        "contradictions": exchange.contradictions,
        **{kind.name.lower().replace("_", " "): number for kind, number in line.happened.items()},
    }
    return OnChip(
        trace=trace,
        answered=answered,
        equal=same,
        late_boluses_mU=[bolus for bolus in boluses if bolus > 0.0],
        sessions=exchange.sessions,
        counts=counts,
        samples_per_s=(samples - 1) / duration_s,
    )


def _without_a_chip(exported: Exported, observations: Sequence[Leaves], sessions: Sequence[int]) -> list[Leaves]:
    """Decisions of the controller on the same observations without a chip; each session initialises it again.

    They are those of its operations carried out in NumPy; in the compact form, which is slow there, those of its C on
    this computer if it has a compiler.
    """
    init: Init
    step: Step
    if exported.source.form == UNROLLED or compiler() is None:
        init, step = arithmetic(exported)
    else:
        library = Library(exported.source, exported.precision)
        init, step = library.init, library.step
    return replayed(observations, init, step, sessions)[1]
