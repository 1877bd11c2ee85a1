"""Design of a controller from its tuning alone: the situation, the models and all other settings are given."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping

from glucoloop.build.designs import design_of
from glucoloop.component.setting import Value
from glucoloop.control import Controller, MPCTuning, StateTuning
from glucoloop.control.catalogue import TUNABLE, controller_entry
from glucoloop.models.step_response import StepResponseModel
from glucoloop.refusal import Refusal
from glucoloop.situations.case import Case
from glucoloop.situations.situation import Situation

Designer = Callable[[MPCTuning], Controller]
"""Function that makes the controller of a tuning."""


def kind_of_tuning(controller: str) -> type[MPCTuning]:
    """Kind of the tunings of a controller that can be tuned: `StateTuning` if it has a reference filter."""
    entry = controller_entry(controller)
    if not entry.tunable:
        raise Refusal(f"the controller {controller!r} cannot be tuned; the known ones are: {', '.join(TUNABLE)}")
    return StateTuning if "reference_filter" in entry.settings() else MPCTuning


def usual_filters(controller: str, tuning: Mapping[str, Value]) -> str | None:
    """Range of reference filters that a grid tries unless another one is given; None without such a setting."""
    if "reference_filter" not in tuning:
        return None
    return controller_entry(controller).reference_filters or f"{tuning['reference_filter']:g}"


def designer(
    situation: Situation, case: Case, model: StepResponseModel | None = None, *, model_is_late: bool = False
) -> Designer:
    """Make the design of a tuning in a situation; parameters and errors as for `build.designs.design_of`."""
    kind = kind_of_tuning(case.controller.called)
    design = design_of(situation, case, model=model, model_is_late=model_is_late)

    def tuned(tuning: MPCTuning) -> Controller:
        if not isinstance(tuning, kind):
            raise Refusal("the controller follows a filtered reference; give the grid reference filters")
        settings = {name: value for name, value in tuning.values().items() if name in case.tuning}
        return design(dataclasses.replace(case.controller, **settings))

    return tuned
