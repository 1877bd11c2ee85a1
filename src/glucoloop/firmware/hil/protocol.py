"""Frames between the patient's side (sensor and pump) and a chip, as Python and as the header of the C firmware.

The layout is documented in the guide, docs/guide/hil.md; numbers have their lowest byte first.
"""

from __future__ import annotations

import enum
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from glucoloop.native.targets.c.source import Source

_VERSION: Final = 1
_MARK: Final = b"GL"
_HEADER: Final = struct.Struct("<2sBBIIHH")
_HELLO: Final = struct.Struct("<32sHHII")
_CRC: Final = struct.Struct("<I")
_HEADER_BYTES: Final = _HEADER.size + _CRC.size
_MAX_PAYLOAD_BYTES: Final = 240
"""Largest number of bytes of a payload."""
_MAX_FRAME_BYTES: Final = _HEADER_BYTES + _MAX_PAYLOAD_BYTES + _CRC.size
_RECORD_MARK: Final = 0x31524C47
"""First four bytes of a record in non-volatile memory, ``GLR1``."""
WATCHDOG_MS: Final = {"float32": 1000, "float64": 20_000}
"""Time after which a chip that hangs is reset, by its arithmetic.

QEMU counts 64 ns for each instruction: 0.2 s for the longest step of a known controller in float32, and 9.2 s in
float64 on a chip without a unit for it.
"""


class Type(enum.IntEnum):
    """Type of a frame; below 16 those to the chip."""

    ASK = 1
    START = 2
    OBSERVATION = 3
    HELLO = 17
    DECISION = 18


class Plan(enum.IntEnum):
    """Planned failure of an emulated board."""

    NONE = 0
    CUT = 1
    HANG = 2


@dataclass(frozen=True)
class Frame:
    """A message on the line."""

    type: int
    session: int = 0
    sample: int = 0
    payload: bytes = b""

    def encoded(self) -> bytes:
        """The bytes on the line."""
        head = _HEADER.pack(_MARK, _VERSION, self.type, self.session, self.sample, len(self.payload), 0)
        content = head + _CRC.pack(zlib.crc32(head)) + self.payload
        return content + _CRC.pack(zlib.crc32(content))


class Decoder:
    """Frames from bytes in pieces of any size; whatever is no frame is skipped, and `refused` counts its beginnings."""

    def __init__(self) -> None:
        self._buffer = bytearray()
        self.refused = 0

    def feed(self, received: bytes) -> Iterator[Frame]:
        """Take bytes, and give the frames that they complete."""
        self._buffer += received
        while (frame := self._next()) is not None:
            yield frame

    def forget(self) -> None:
        """Forget what was received and not taken: it answers nothing that is asked from now on."""
        self._buffer.clear()

    def _next(self) -> Frame | None:
        while self._buffer:
            length = self._length()
            if length is None or len(self._buffer) < length:
                return None
            if length:
                content = bytes(self._buffer[:length])
                if _CRC.pack(zlib.crc32(content[:-4])) == content[-4:]:
                    del self._buffer[:length]
                    _, _, type, session, sample, _, _ = _HEADER.unpack_from(content)
                    return Frame(type, session, sample, content[_HEADER_BYTES:-4])
            self.refused += self._buffer[0] == _MARK[0]
            next_mark = self._buffer.find(_MARK[0], 1)
            del self._buffer[: next_mark if next_mark > 0 else len(self._buffer)]
        return None

    def _length(self) -> int | None:
        """Number of bytes of the frame that begins here; 0 if none can, and None if there are too few to tell."""
        first = _MARK + bytes([_VERSION])
        if bytes(self._buffer[:3]) != first[: len(self._buffer)]:
            return 0
        if len(self._buffer) < _HEADER_BYTES:
            return None
        head, crc = bytes(self._buffer[: _HEADER.size]), bytes(self._buffer[_HEADER.size : _HEADER_BYTES])
        payload = int(_HEADER.unpack(head)[5])
        if _CRC.pack(zlib.crc32(head)) != crc or payload > _MAX_PAYLOAD_BYTES:
            return 0
        return _HEADER_BYTES + payload + _CRC.size


@dataclass(frozen=True)
class Hello:
    """Message of a chip about itself, when it starts and when it is asked."""

    design: str
    """SHA-256 of the controller's design, in hexadecimal."""
    watchdog_ms: int
    question: int
    """Number of the question that is answered; 0 if there was none."""
    session: int
    next: int
    """Number of the sample that the chip waits for."""

    @staticmethod
    def of(frame: Frame) -> Hello | None:
        """Content of a frame; None if it has another length."""
        if len(frame.payload) != _HELLO.size:
            return None
        design, _, _, watchdog_ms, question = _HELLO.unpack(frame.payload)
        return Hello(design.hex(), watchdog_ms, question, frame.session, frame.sample)


class Payloads:
    """Conversion of a controller's observations and decisions to payloads and back."""

    def __init__(self, source: Source, precision: str) -> None:
        self.precision = precision
        self._observation, self._decision = source.records["observation"], source.records["decision"]

    def observation(self, leaves: list[Any]) -> bytes:
        """Payload of the leaves of an observation."""
        return self._observation.filled(leaves, self.precision).tobytes()

    def decision(self, payload: bytes) -> list[Any]:
        """Leaves of the decision of a payload."""
        room = np.frombuffer(payload, self._decision.memory(self.precision))[0]
        return self._decision.leaves(room, self.precision)

    @property
    def sizes(self) -> tuple[int, int]:
        """Number of bytes of an observation and of a decision."""
        memories = [record.memory(self.precision) for record in (self._observation, self._decision)]
        return memories[0].itemsize, memories[1].itemsize


def record_bytes(source: Source, payloads: Payloads) -> int:
    """Number of bytes of a record in non-volatile memory."""
    return 20 + payloads.sizes[1] + source.record_bytes + _CRC.size


def _place_bytes(source: Source, payloads: Payloads) -> int:
    """Number of bytes from one record in non-volatile memory to the next."""
    return -(-record_bytes(source, payloads) // 64) * 64


def plan_at(source: Source, payloads: Payloads) -> int:
    """Place of the planned failure in the memory of an emulated board, after both records."""
    return 2 * _place_bytes(source, payloads)


def header(source: Source, payloads: Payloads) -> str:
    """The C header with the constants of the link for a controller."""
    observation, decision = payloads.sizes
    numbers = {
        "MARK_0": _MARK[0],
        "MARK_1": _MARK[1],
        "VERSION": _VERSION,
        "HEADER": _HEADER_BYTES,
        "PAYLOAD_MAX": _MAX_PAYLOAD_BYTES,
        "FRAME_MIN": _HEADER_BYTES + _CRC.size,
        "FRAME_MAX": _MAX_FRAME_BYTES,
        **{f"TYPE_{type.name}": type.value for type in Type},
        "HELLO": _HELLO.size,
        "OBSERVATION": observation,
        "DECISION": decision,
        "WATCHDOG_MS": WATCHDOG_MS[payloads.precision],
        "RECORD_MARK": _RECORD_MARK,
        "PLACE": _place_bytes(source, payloads),
        "PLAN_AT": plan_at(source, payloads),
        **{f"PLAN_{plan.name}": plan.value for plan in Plan},
    }
    return "\n".join(
        [
            "/* Constants of the link of one controller; sizes are in bytes. */",
            "#ifndef HIL_LINK_H",
            "#define HIL_LINK_H",
            "",
            *(f"#define HIL_{name} {number}U" for name, number in numbers.items()),
            "",
            "/* SHA-256 of the design. */",
            "#define HIL_DESIGN \\",
            *_bytes_in_rows(bytes.fromhex(source.design)),
            "",
            "#endif",
            "",
        ]
    )


def _bytes_in_rows(data: bytes) -> Iterator[str]:
    """Bytes as the continued lines of a macro."""
    for i in range(0, len(data), 8):
        row = ", ".join(f"0x{byte:02X}U" for byte in data[i : i + 8])
        yield f"  {row}, \\" if i + 8 < len(data) else f"  {row}"
