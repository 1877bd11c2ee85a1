"""Keys of hardware in the loop: the chip, its link, and what befalls both."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Annotated, Literal

from glucoloop.config.key import Key
from glucoloop.config.options.export import CodeKeys

_chip = functools.partial(Key, panel="Chip")
_disturbed = functools.partial(Key, panel="Disturbances, drawn by --seed", at_least=0, at_most=1_000_000)


@dataclass(frozen=True, kw_only=True)
class DisturbanceKeys:
    """Numbers of disturbances."""

    power_cuts: Annotated[
        int, _disturbed("Power cuts of the chip: amid a frame, amid the writing of a record, or after an answer.")
    ] = 0
    hangs: Annotated[
        int, _disturbed("Times that the program hangs while it writes a record, until its watchdog resets it.")
    ] = 0
    damaged: Annotated[int, _disturbed("Frames in which a byte is changed.")] = 0
    lost: Annotated[int, _disturbed("Frames that are lost.")] = 0
    doubled: Annotated[int, _disturbed("Frames that come twice.")] = 0
    late: Annotated[int, _disturbed("Frames that come after the next one.")] = 0
    outages: Annotated[
        int, _disturbed("Samples in which nothing passes the line, so that the pump gives its fallback rate.")
    ] = 0


@dataclass(frozen=True, kw_only=True)
class HilKeys(DisturbanceKeys, CodeKeys):
    """Keys of the chip, its link, and what befalls both."""

    chip: Annotated[
        str,
        _chip(
            "Where the controller runs: this computer, a chip that QEMU emulates, or a board at a serial port.",
            metavar="host|cortex-m4f|cortex-m7|rv32|PORT",
        ),
    ] = "host"
    baud: Annotated[int, _chip("Bits per second of a serial port.", at_least=1)] = 115200
    real_time: Annotated[bool, _chip("Wait for each sample; without it the loop is as fast as it can be.")] = False
    fallback: Annotated[
        Literal["basal", "suspend"],
        _chip(
            "Rate of the pump while the chip does not answer: basal, which for half an hour is no more than the last "
            "dose, or suspend for none."
        ),
    ] = "basal"
