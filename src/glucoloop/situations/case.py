"""Case: a controller with its guard and its model, as one of several that are tried in a situation."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Self

from glucoloop.component.base import Component, read
from glucoloop.component.effects import DEAD_TIME, Need
from glucoloop.component.grammar import NAME, GivenValue, Tree, as_table, component_text, place
from glucoloop.component.setting import About, Value
from glucoloop.control.catalogue import CONTROLLERS, DEFAULT_CONTROLLER
from glucoloop.control.guard_settings import GuardSettings, guard_of
from glucoloop.control.part import ControllerComponent
from glucoloop.faults import FaultComponent
from glucoloop.models.settings import IdentifiedComponent, ModelComponent
from glucoloop.refusal import Refusal
from glucoloop.situations.situation import LONGEST_SAMPLE_TIME_MIN, SHORTEST_SAMPLE_TIME_MIN, Situation
from glucoloop.text import is_printable
from glucoloop.unit_guess import SAMPLE_TIME


class Case(Component):
    """A controller with its guard and its model.

    In text and in files it is the controller, whose settings these stand among: ``mpc, move_weight=1, label=careful``.

    Raises
    ------
    Refusal
        For a label that cannot be printed in a line.
    """

    kind: ClassVar = "case"
    may_have: ClassVar = ("label",)

    controller: Annotated[ControllerComponent, About("The controller.")] = dataclasses.field(
        default_factory=lambda: CONTROLLERS[DEFAULT_CONTROLLER].partial({})
    )
    label: Annotated[str, About("Name of the case; by default the controller and what was given of it.")] = ""
    known_dead_time: Annotated[
        bool,
        About(
            "Whether the controller knows the dead time: its model is then delayed and its prediction horizon longer.",
            needs=(DEAD_TIME,),
        ),
    ] = False
    guard: Annotated[GuardSettings | None, About("Its guard; by default that of the run, if it has one.")] = None
    model: Annotated[ModelComponent | None, About("Its model; by default that of the run.")] = None
    every_min: Annotated[
        float | None,
        About(
            "Time from one action of the controller to the next, a whole number of samples; by default one sample. It "
            "is designed for this time, and its guard acts with it.",
            at_least=SHORTEST_SAMPLE_TIME_MIN,
            at_most=LONGEST_SAMPLE_TIME_MIN,
            quantity=SAMPLE_TIME,
        ),
    ] = None
    faults: Annotated[
        tuple[FaultComponent, ...], About("Faults of this case only, around those of the situation.")
    ] = ()

    def __post_init__(self) -> None:
        if not self.label.strip():
            object.__setattr__(self, "label", component_text(self.controller.tree()))
        if not is_printable(self.label):
            raise Refusal(f"the label {self.label!r} cannot be printed in a line; leave out its control characters")

    def completed_in(
        self, situation: Situation, guard: GuardSettings | None = None, model: ModelComponent | None = None
    ) -> Self:
        """The case with everything that is usual in a situation, and a guard and a model if it has none of its own."""
        patient, controller = situation.patient, self.controller
        pace_min = situation.sample_time_min if self.every_min is None else self.every_min
        if self.every_min is not None:
            from glucoloop.control.pace import samples_of_pace

            samples_of_pace(self.every_min, situation.sample_time_min)
        guard = self.guard if "guard" in self.explicit else guard
        model = self.model if self.model is not None else model
        if isinstance(model, IdentifiedComponent) or (model is None and controller.uses_model):
            usual = patient.identification(pace_min)
            identified = IdentifiedComponent.partial({}) if model is None else model
            model = identified.completed({"noise_variance": situation.noise_variance, **usual})
            model = model if controller.uses_model else None
        elif model is not None:
            model = model.completed()
        whole = type(self)(
            controller=controller.completed(patient.usual_of(controller.name), noisy=situation.noisy),
            label=self.label or component_text(controller.tree()),
            known_dead_time=self.known_dead_time,
            guard=None if guard is None else guard_of(patient, guard),
            model=model,
            every_min=self.every_min,
            faults=tuple(fault.completed() for fault in self.faults),
        )
        return whole._noted(self.explicit, self.source, self.display_name)

    def tree(self, *, whole: bool = False) -> Tree:
        """The controller, with what else is of the case among its settings."""
        result = super().tree(whole=whole)
        controller = result.pop("controller", self.controller.tree(whole=whole))
        return {**controller, **{key: value for key, value in result.items() if value not in (None, [])}}

    def uses(self) -> frozenset[Need]:
        """Needs that the controller meets, and its guard."""
        return self.controller.uses() | (frozenset() if self.guard is None else self.guard.uses())

    @property
    def tuning(self) -> Mapping[str, Value]:
        """Every setting of the controller."""
        return self.controller.values()

    @property
    def identified(self) -> IdentifiedComponent:
        """Settings of the identification of its model."""
        return self.model if isinstance(self.model, IdentifiedComponent) else IdentifiedComponent()


@functools.cache
def _beside() -> Mapping[str, str]:
    """Settings of a case that stand among those of its controller, also by their names without the unit."""
    settings = {name: setting for name, setting in Case.settings().items() if name != "controller"}
    return {key: name for name, setting in settings.items() for key in (name, setting.name_without_unit)}


class _Cases:
    """Reader of cases, of which a component's settings are shared between the controller and the case."""

    def tree(self, text: str, source: str = "") -> Tree:
        """Tree of a case from its text."""
        return CONTROLLERS.tree(text, source)

    def read(self, tree: Any, *, allow_unusual: bool = True) -> Case:
        """A case from its tree, or from its text as a leaf of one."""
        controller = as_table(tree, self.tree)
        of_case: dict[str, Any] = {}
        if isinstance(controller, Mapping):
            of_case = {key: value for key, value in controller.items() if key in _beside()}
            controller = {key: value for key, value in controller.items() if key not in _beside()} or {
                NAME: GivenValue(DEFAULT_CONTROLLER, place(of_case))
            }
        designed = CONTROLLERS.read(controller, allow_unusual=allow_unusual)
        for name in _beside().values():
            if name in designed.settings():
                raise Refusal(
                    f"the controller {designed.display_name} has a setting {name!r}, which every case has already; its "
                    "author has to give it another name"
                )
        case = read(Case, of_case, allow_unusual=allow_unusual)
        return Case.partial({**case.explicit, "controller": designed}, place(tree))


Case.catalogue = _Cases()  # type: ignore[attr-defined]


def usual_case(controller: str, situation: Situation) -> Case:
    """A controller with its default settings in a situation, on a model identified from an equally noisy record."""
    return Case(controller=CONTROLLERS.find(controller).partial({})).completed_in(situation)


def cases_of(*names: str) -> tuple[Case, ...]:
    """A case for each of some controllers, as a default of what a study asks for."""
    return tuple(Case.partial({"controller": CONTROLLERS[name].partial({})}) for name in names)
