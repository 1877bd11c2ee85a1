"""Hardware in the loop: the patient here, the controller on a chip."""

from __future__ import annotations

import functools
from typing import TYPE_CHECKING, Annotated, ClassVar, Final, Literal

from glucoloop.component.effects import CHANCE, Need
from glucoloop.component.setting import Option
from glucoloop.refusal import Refusal
from glucoloop.situations.run import Run
from glucoloop.studies.export import Form, Precision
from glucoloop.studies.study import PlainStudy

if TYPE_CHECKING:
    from glucoloop.firmware.hil.faults import Disturbances

_EMULATED: Final = ("host", "cortex-m4f", "cortex-m7", "rv32")
"""Chips that need no hardware."""
_SERIAL: Final = Need("the chip is at no serial port")
_SILENCE: Final = Need("the chip always answers, since nothing disturbs it or the line")
_chip = functools.partial(Option, panel="Chip")
_disturbed = functools.partial(Option, panel="Disturbances, drawn by --seed", at_least=0, at_most=1_000_000)
_DISTURBANCES: Final = ("power_cuts", "hangs", "damaged", "lost", "doubled", "late", "outages")


class Hil(Run):
    """A run whose controller is on a chip, its link, and what befalls both."""

    kind: ClassVar = "run on a chip"
    # every sample is one of the link, so that all are counted; the person is stepped from outside
    refused: ClassVar = ("warm_up_min", "rescue", "glucagon", "events", "actions", "changes", "forecasts")

    precision: Precision = "float32"
    form: Form = "auto"
    chip: Annotated[
        str,
        _chip(
            "Where the controller runs: this computer, a chip that QEMU emulates, or a board at a serial port.",
            metavar="host|cortex-m4f|cortex-m7|rv32|PORT",
        ),
    ] = "host"
    baud: Annotated[int, _chip("Bits per second of a serial port.", at_least=1, needs=(_SERIAL,))] = 115200
    real_time: Annotated[bool, _chip("Wait for each sample; without it the loop is as fast as it can be.")] = False
    fallback: Annotated[
        Literal["basal", "suspend"],
        _chip(
            "Rate of the pump while the chip does not answer: basal, which for half an hour is no more than the last "
            "dose, or suspend for none.",
            needs=(_SILENCE,),
        ),
    ] = "basal"
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

    def __post_init__(self) -> None:
        super().__post_init__()
        _ = self.case  # refuses several
        if not self.emulated and "/" not in self.chip:
            raise Refusal(
                f"the chip is {self.chip!r}; the known ones are: {', '.join(_EMULATED)}, or the path of a serial port "
                "such as /dev/ttyACM0"
            )
        if not self.emulated and self.disturbances.of_power:
            raise Refusal(
                f"the power of the board at {self.chip} cannot be cut from here, nor its program made to hang; "
                "let --power-cuts and --hangs be 0, or take an emulated chip"
            )
        self.disturbances.check(self.samples)

    def uses(self) -> frozenset[Need]:
        """Needs that the run meets, and the link."""
        disturbed = any(getattr(self, name) for name in _DISTURBANCES)
        port = set() if self.emulated else {_SERIAL, _SILENCE}
        return super().uses() | port | ({CHANCE, _SILENCE} if disturbed else set())

    @property
    def samples(self) -> int:
        """Number of samples."""
        return round(self.horizon_min / self.sample_time_min)

    @property
    def emulated(self) -> bool:
        """Whether the chip needs no hardware."""
        return self.chip in _EMULATED

    @property
    def disturbances(self) -> Disturbances:
        """Numbers of disturbances."""
        from glucoloop.firmware.hil.faults import Disturbances

        return Disturbances(**{name: getattr(self, name) for name in _DISTURBANCES})


_SELDOM: Final = (
    "precision", "form", "baud", "damaged", "lost", "doubled", "late", "initial_glucose_mg_dl", "announce_meals",
    "sample_time_min", "allow_unusual",
)  # fmt: skip
HIL: Final = PlainStudy(
    name="hil",
    what="a run on a chip",
    help=(
        "Close the loop with the controller on a chip: hardware in the loop.\n\n"
        "The patient, its sensor and its pump are simulated here as `glucoloop run` does it. The controller runs as C "
        "on an emulated chip, as a process of this computer (`host`), or on a board at a serial port, and gets each "
        "reading over a serial link. Frames may be damaged, lost, doubled or late, and the power of the chip may fail "
        "at any moment; every decision is compared with the same controller without a chip, to the bit.\n\n"
        "  glucoloop hil --controller mpc-se --guard --chip cortex-m4f --out first\n\n"
        "  glucoloop hil --controller pid --duration 1440 --power-cuts 1000 --damaged 100 --outages 5 --out night\n\n"
        "  glucoloop hil --config first/hil.toml --chip /dev/ttyACM0 --real-time"
    ),
    module="glucoloop.studies.hil.study",
    request=Hil,
    option_texts={"rare": dict.fromkeys(_SELDOM, True)},
    unit="samples",
    summary="metrics.json",
)
