"""The controller of a configured run in C."""

from __future__ import annotations

import glucoloop
from glucoloop.config.options.export import CodeKeys
from glucoloop.config.run import Run
from glucoloop.control import Controller
from glucoloop.firmware.exported import Exported, export
from glucoloop.firmware.samples import example
from glucoloop.simulation import Stepper
from glucoloop.situations.situation import Situation


def exported_controller(
    run: Run, code: CodeKeys, situation: Situation, controller: Controller, stepper: Stepper
) -> Exported:
    """Write the controller of a run in C, for the observations of a stepper.

    Raises
    ------
    ValueError
        If the controller cannot be written in C.
    """
    title = [f"{name_of(run)}, by glucoloop {glucoloop.__version__}.", "Research software, not a medical device."]
    return export(
        controller,
        situation.limits,
        example(controller, stepper),
        title,
        precision=code.precision,
        form=code.form,
        bolus=situation.bolus,
    )


def name_of(run: Run) -> str:
    """Name of the controller of a run, for titles."""
    return (
        f"The controller {run.case.controller}{' with its guard' if run.case.guard else ''} for {run.situation.place}"
    )
