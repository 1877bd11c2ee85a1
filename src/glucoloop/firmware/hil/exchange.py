"""A decision of the chip for each observation, over a link that may lose, damage, double or delay frames."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Final

from glucoloop.firmware.hil.link import Link
from glucoloop.firmware.hil.protocol import Decoder, Frame, Hello, Type
from glucoloop.refusal import Refusal

_FIRST_WAIT_S: Final = 0.02
"""Time after which a frame that was not answered is sent again, before an answer was timed."""
_MIN_WAIT_S: Final = 0.002
_MAX_WAIT_S: Final = 1.0
ANSWER_WITHIN_S: Final = 10.0
"""Time after which the pump gives its fallback rate for the sample."""
EMULATED_WITHIN_S: Final = 120.0
"""The same where the chip is emulated, which is slow on a busy computer: only an outage is to be one."""
_MAX_OBSERVATIONS: Final = 288
"""Number of observations that are kept for a chip that is late: a day of 5-min samples."""


class _Patience:
    """Time to wait for an answer before a frame is sent again, from the times of earlier answers.

    It is the smoothed time of an answer plus four times its smoothed deviation, and doubles with each frame that is
    sent again until an answer to a frame that was sent once is timed: the rule of RFC 6298, as for TCP.
    """

    def __init__(self) -> None:
        self.wait_s = _FIRST_WAIT_S
        self._mean_s: float | None = None
        self._deviation_s = 0.0

    def answered(self, duration_s: float) -> None:
        """Learn from the time of the answer to a frame that was sent once."""
        if self._mean_s is None:
            self._mean_s, self._deviation_s = duration_s, duration_s / 2.0
        else:
            self._deviation_s += (abs(duration_s - self._mean_s) - self._deviation_s) / 4.0
            self._mean_s += (duration_s - self._mean_s) / 8.0
        self.wait_s = min(max(self._mean_s + 4.0 * self._deviation_s, _MIN_WAIT_S), _MAX_WAIT_S)

    def repeated(self) -> None:
        """Wait for twice as long from now on."""
        self.wait_s = min(2.0 * self.wait_s, _MAX_WAIT_S)


class Exchange:
    """The patient's side of the protocol.

    A sample's observation is sent until its decision comes. Observations that could not be delivered are sent later, in
    their order, so that the controller misses none; the pump does not wait for their decisions.

    `sizes` are the numbers of bytes of an observation and of a decision.
    """

    def __init__(
        self, link: Link, design: str, sizes: tuple[int, int], *, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._link, self._design, self._sizes, self._clock = link, design, sizes, clock
        self._decoder = Decoder()
        self._patience = _Patience()
        self._sent_s: float | None = None
        """Time at which the last frame was sent that is to be timed; None if it was answered or sent again."""
        self._observations: dict[int, bytes] = {}
        self._session = self._question = 0
        self._fresh = True
        """Whether nothing was answered in the session yet."""
        self._memory_in_question = False
        """Whether the chip seems to have lost its memory, and was asked about it."""
        self.answers: dict[int, bytes] = {}
        """Payload of the decision of each sample that was answered, also late."""
        self.sessions: list[int] = []
        """Sample with which each session began; each initialises the controller again."""
        self.repeated = self.contradictions = 0
        """Numbers of frames that were sent again, and of decisions that differ from an earlier one on their sample."""

    @property
    def refused(self) -> int:
        """Number of damaged frames from the chip."""
        return self._decoder.refused

    def begin(self) -> Hello:
        """Find the chip, and begin a session with sample 0; a silent chip and another controller are refused."""
        hello: list[Hello] = []

        def question() -> None:
            self._question += 1
            self._ask()

        def took(frame: Frame) -> bool:
            answer = self._hello(frame)
            if answer is not None and answer.question == self._question:
                hello.append(answer)
            return bool(hello)

        if not self._until(question, took):
            raise Refusal(
                f"the chip did not answer within {ANSWER_WITHIN_S:g} s; check that it runs the firmware of "
                "`glucoloop hil`, and that the port is its own"
            )
        self._session = hello[0].session
        self._new_session(0)
        return hello[0]

    def keep(self, sample: int, observation: bytes) -> None:
        """Remember an observation, to be sent when the chip is ready for it."""
        self._observations[sample] = observation
        if len(self._observations) > _MAX_OBSERVATIONS:
            del self._observations[min(self._observations)]

    def decide(self, sample: int, observation: bytes, within_s: float = ANSWER_WITHIN_S) -> bytes | None:
        """Decision on a sample; None if the chip did not answer in time. Another controller is refused."""
        self.keep(sample, observation)
        return self._answer_to(sample, within_s)

    def ask_again(self, sample: int, within_s: float = ANSWER_WITHIN_S) -> bytes | None:
        """The decision on the last sample once more, as if its answer had been lost."""
        before = self.answers.pop(sample)
        again = self._answer_to(sample, within_s)
        self.contradictions += again is not None and again != before
        self.answers[sample] = before
        return again

    def _answer_to(self, sample: int, within_s: float) -> bytes | None:
        def send() -> None:
            if self._memory_in_question:
                self._ask()
            else:
                self._observe(min(number for number in self._observations if number not in self.answers))

        def took(frame: Frame) -> bool:
            self._take(frame, sample)
            return sample in self.answers

        return self.answers[sample] if self._until(send, took, within_s) else None

    def _until(
        self, send: Callable[[], None], took: Callable[[Frame], bool], within_s: float = ANSWER_WITHIN_S
    ) -> bool:
        """Ask until a frame is the one that is waited for; False if none was in time.

        A damaged frame is perhaps the answer: the question is sent again at once, and later ones wait their time, so
        that a line that damages everything is not flooded.
        """
        end = self._clock() + within_s
        self._decoder.forget()
        refused, at_once = self.refused, True
        send()
        again = self._clock() + self._patience.wait_s
        while (now := self._clock()) < end:
            for frame in self._decoder.feed(self._link.receive(max(0.0, min(again, end) - now))):
                self._heard()
                if took(frame):
                    return True
                again = self._clock() + self._patience.wait_s
            late = self._clock() >= again
            if late or (at_once and self.refused > refused):
                refused, at_once = self.refused, late
                if late:
                    self._patience.repeated()
                send()
                self._sent_s = None
                self.repeated += 1
                again = self._clock() + self._patience.wait_s
        return False

    def _heard(self) -> None:
        """Time the answer, unless the frame was sent twice and it may be that of either."""
        if self._sent_s is not None:
            self._patience.answered(self._clock() - self._sent_s)
            self._sent_s = None

    def _take(self, frame: Frame, current: int) -> None:
        if frame.type == Type.DECISION:
            if frame.session == self._session and len(frame.payload) == self._sizes[1]:
                self._decided(frame, current)
            return
        hello = self._hello(frame)
        if hello is None:
            return
        if hello.session == self._session and hello.next in (*self._observations, current + 1):
            self._memory_in_question = False
            self._observe(min(hello.next, current))
        elif hello.session != self._session and self._fresh:
            self._send(Frame(Type.START, self._session, self.sessions[-1]))
        elif self._memory_in_question and hello.question == self._question:
            # The chip has lost its memory: its controller can only be initialised again.
            self._memory_in_question = False
            self._session = max(self._session, hello.session)
            self._observations = {current: self._observations[current]}
            self._new_session(current)
        elif not self._memory_in_question:
            # Perhaps an old frame that was late: only an answer to a question of now is accepted.
            self._memory_in_question = True
            self._question += 1
            self._ask()

    def _decided(self, frame: Frame, current: int) -> None:
        if frame.sample not in self._observations or frame.sample > current:
            return
        self._fresh = self._memory_in_question = False
        repeated = frame.sample in self.answers
        before = self.answers.setdefault(frame.sample, frame.payload)
        self.contradictions += before != frame.payload
        if frame.sample < current and not repeated:  # an answer that came twice asks for nothing twice
            self._observe(frame.sample + 1)

    def _new_session(self, first: int) -> None:
        self._session += 1
        self._fresh = True
        self.sessions.append(first)
        self._send(Frame(Type.START, self._session, first))

    def _ask(self) -> None:
        self._send(Frame(Type.ASK, sample=self._question))

    def _observe(self, sample: int) -> None:
        if sample in self._observations:
            self._send(Frame(Type.OBSERVATION, self._session, sample, self._observations[sample]))

    def _hello(self, frame: Frame) -> Hello | None:
        hello = Hello.of(frame) if frame.type == Type.HELLO else None
        if hello is not None and hello.design != self._design:
            raise Refusal(
                f"the chip runs the design {hello.design[:16]}, and the run is of {self._design[:16]}; "
                "write the firmware of this run to it"
            )
        return hello

    def _send(self, frame: Frame) -> None:
        self._link.send(frame.encoded())
        self._sent_s = self._clock()
