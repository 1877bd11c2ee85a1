"""A link that is disturbed: frames damaged, lost, doubled and late, power cuts, and programs that hang, by a seed."""

from __future__ import annotations

import enum
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from glucoloop.firmware.hil.link import Link, ProcessLink
from glucoloop.firmware.hil.protocol import Decoder, Frame, Plan, Type
from glucoloop.refusal import Refusal

_LONGEST_START_S: Final = 1.0


class Kind(enum.Enum):
    """Kind of a disturbance."""

    CUT_IN_FRAME = "power fails while a frame is sent to the chip"
    CUT_IN_RECORD = "power fails while the chip writes a record"
    CUT_AFTER_ANSWER = "power fails after an answer"
    HANG = "the program hangs while the chip writes a record, until the watchdog resets it"
    DAMAGED = "a byte of a frame is changed"
    LOST = "a frame is lost"
    DOUBLED = "a frame comes twice"
    LATE = "a frame comes after the next one"


_CUTS = (Kind.CUT_IN_FRAME, Kind.CUT_IN_RECORD, Kind.CUT_AFTER_ANSWER)


@dataclass(frozen=True)
class Event:
    """A disturbance of one frame or record."""

    kind: Kind
    to_chip: bool
    """Whether it befalls a frame to the chip, or one from it."""
    where: float
    """Place in the frame or the record, from 0 to below 1."""
    change: int = 1
    """Bits of a damaged byte that are changed, 1 to 255."""


@dataclass(frozen=True)
class Disturbances:
    """Numbers of disturbances in a run."""

    power_cuts: int = 0
    hangs: int = 0
    damaged: int = 0
    lost: int = 0
    doubled: int = 0
    late: int = 0
    outages: int = 0
    """Number of samples in which nothing passes the line, so that the chip has no part in them."""

    @property
    def of_power(self) -> int:
        """Number of those for which the chip must be emulated."""
        return self.power_cuts + self.hangs

    def check(self, samples: int) -> None:
        """Refuse more outages than there are samples after the first."""
        if self.outages >= samples:
            raise Refusal(
                f"{self.outages} outages are not possible in {samples} samples, the first of which has none; "
                f"give {samples - 1} or fewer"
            )

    def draw(self, samples: int, seed: int) -> tuple[list[list[Event]], frozenset[int]]:
        """Events of each sample in their order, and the samples of the outages; see `check`."""
        self.check(samples)
        rng = np.random.default_rng((seed, 0x48494C))
        silent = frozenset(int(i) for i in 1 + rng.permutation(samples - 1)[: self.outages])
        heard = [i for i in range(samples) if i not in silent]
        events: list[list[Event]] = [[] for _ in range(samples)]
        kinds = [_CUTS[int(i)] for i in rng.integers(0, len(_CUTS), self.power_cuts)]
        kinds += [Kind.HANG] * self.hangs + [Kind.DAMAGED] * self.damaged + [Kind.LOST] * self.lost
        kinds += [Kind.DOUBLED] * self.doubled + [Kind.LATE] * self.late
        for kind in kinds:
            both = kind in (Kind.DAMAGED, Kind.LOST, Kind.DOUBLED, Kind.LATE)
            to_chip = bool(rng.integers(2)) if both else kind is not Kind.CUT_AFTER_ANSWER
            event = Event(kind, to_chip, float(rng.random()), int(rng.integers(1, 256)))
            events[heard[int(rng.integers(len(heard)))]].append(event)
        return [[kind[int(i)] for i in rng.permutation(len(kind))] for kind in events], silent


NOTHING: Final = Disturbances()


class DisturbedLink:
    """A link whose next frames are disturbed by the events that wait for them; `record_bytes` is that of a record."""

    def __init__(self, inner: Link, record_bytes: int) -> None:
        self._inner, self._record_bytes = inner, record_bytes
        self._to: deque[Event] = deque()
        self._from: deque[Event] = deque()
        self._late_to: list[bytes] = []
        self._late_from: list[bytes] = []
        self._decoder = Decoder()
        self._down = False
        self.happened: dict[Kind, int] = dict.fromkeys(Kind, 0)
        """Number of disturbances of each kind so far."""

    def expect(self, events: Sequence[Event]) -> None:
        """Add events for the coming frames."""
        for event in events:
            (self._to if event.to_chip else self._from).append(event)

    @property
    def pending(self) -> bool:
        """Whether an event waits for its frame."""
        return bool(self._to or self._from)

    def send(self, data: bytes) -> None:
        """Send one frame, disturbed by the next event."""
        if not self._to:
            self._inner.send(data + b"".join(self._late_to))
            self._late_to.clear()
            return
        event = self._to.popleft()
        self.happened[event.kind] += 1
        if event.kind is Kind.LATE:
            self._late_to.append(data)
        elif event.kind is Kind.CUT_IN_FRAME:
            self._inner.send(data[: int(event.where * (len(data) + 1))])
            self._restart()
        elif event.kind in (Kind.CUT_IN_RECORD, Kind.HANG):
            plan = Plan.HANG if event.kind is Kind.HANG else Plan.CUT
            # The frame is lost too; it is sent again when the chip says that it has power.
            self._restart(plan, int(event.where * (self._record_bytes + 1)))
        else:
            self._inner.send(b"".join(_disturbed(data, event)))

    def receive(self, wait_s: float) -> bytes:
        """Whole frames from the chip, each disturbed by the next event."""
        out: list[bytes] = []
        for frame in self._frames(wait_s):
            data = frame.encoded()
            if not self._from:
                out += [data, *self._late_from]
                self._late_from.clear()
                continue
            event = self._from.popleft()
            self.happened[event.kind] += 1
            if event.kind is Kind.LATE:
                self._late_from.append(data)
            elif event.kind is Kind.CUT_AFTER_ANSWER:
                out.append(data)
                self._restart()
                self._down = True
            else:
                out += _disturbed(data, event)
        return b"".join(out)

    def _frames(self, wait_s: float) -> Iterator[Frame]:
        """Frames from the chip; after a power cut all until it is up again, which takes less than a sample."""
        yield from self._decoder.feed(self._inner.receive(wait_s))
        while self._down:
            received = self._inner.receive(_LONGEST_START_S)
            self._down = bool(received)
            for frame in self._decoder.feed(received):
                self._down &= frame.type != Type.HELLO
                yield frame

    def close(self) -> None:
        """Close the inner link."""
        self._inner.close()

    def _restart(self, plan: Plan = Plan.NONE, after_bytes: int = 0) -> None:
        if not isinstance(self._inner, ProcessLink):
            raise TypeError("the power of a real board cannot be cut from here")
        self._inner.cut_power(plan, after_bytes)


def _disturbed(data: bytes, event: Event) -> list[bytes]:
    """Pieces of a frame that arrive."""
    if event.kind is Kind.LOST:
        return []
    if event.kind is Kind.DOUBLED:
        return [data, data]
    at = int(event.where * len(data))
    return [data[:at] + bytes([data[at] ^ event.change]) + data[at + 1 :]]
