"""A controller in C: what an export asks for, and the writing of it."""

from __future__ import annotations

import functools
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import glucoloop
from glucoloop.component.setting import Option
from glucoloop.situations.case import Case
from glucoloop.situations.run import ControlledSituation

if TYPE_CHECKING:
    from glucoloop.control import Controller
    from glucoloop.firmware.exported import Exported
    from glucoloop.simulation import Stepper

_chip = functools.partial(Option, panel="Chip")
Precision = Annotated[Literal["float32", "float64"], _chip("Arithmetic on the chip.")]
Form = Annotated[
    Literal["auto", "unrolled", "compact"],
    _chip("unrolled: a statement for each operation, fast; compact: loops and tables, small; auto chooses by size."),
]


class Export(ControlledSituation):
    """A controller in its situation, and the form of its C."""

    kind: ClassVar = "export"
    # the recorded samples have meals and faults of their own
    refused: ClassVar = ("faults", "metrics", "warm_up_min", "rescue", "events", "actions")

    precision: Precision = "float32"
    form: Form = "auto"
    target: Annotated[
        Literal["c", "cortex-m4f", "cortex-m7", "rv32"], _chip("Target chip, which is emulated; c for none.")
    ] = "c"
    samples: Annotated[
        int,
        _chip("Number of recorded samples; with --check of those that are checked.", at_least=6, at_most=1_000_000),
    ] = 120

    def __post_init__(self) -> None:
        super().__post_init__()
        _ = self.case  # refuses several


def exported_controller(config: Any, case: Case, controller: Controller, stepper: Stepper) -> Exported:
    """Write the controller of a case in C, for the observations of a stepper; Refusal if that is not possible."""
    from glucoloop.firmware.exported import export
    from glucoloop.firmware.samples import example

    name = name_of(config, case)
    title = [f"{name}, by glucoloop {glucoloop.__version__}.", "Research software, not a medical device."]
    return export(
        controller,
        config.limits,
        example(controller, stepper),
        title,
        precision=config.precision,
        form=config.form,
        bolus=config.bolus,
        glucagon=config.glucagon_limits,
    )


def name_of(config: ControlledSituation, case: Case) -> str:
    """Name of the controller of a case, for titles."""
    more = [] if config.glucagon is None else [f"with glucagon by {config.glucagon.display_name}"]
    more += ["with its guard"] if case.guard else []
    return " ".join(["The controller", case.controller.display_name, *more, f"for {config.place}"])
