"""Case: a controller with its guard and its model, as one of several that are tried in a situation.

In a search its settings may be ranges, ``mpc, move_horizon=1:4, move_weight=0|1|3``: in a tree they are parted from the
controller, whose settings have no ranges, and written back to it.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Collection, Mapping
from typing import Annotated, Any, ClassVar, Final, Self

from glucoloop.component.base import Component
from glucoloop.component.effects import DEAD_TIME, Need
from glucoloop.component.grammar import NAME, Leaf, Tree, as_table, place, plain
from glucoloop.component.request import Request, by_default, completed, made_of, read, request_of, requested
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
from glucoloop.units import ending_of


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
        default_factory=lambda: by_default(CONTROLLERS[DEFAULT_CONTROLLER])
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

    @classmethod
    def resolved(cls, values: Mapping[str, Any]) -> dict[str, Any]:
        """The settings with a label."""
        return super().resolved({**values, "label": _label(values["label"], values["controller"])})

    @classmethod
    def arranged(cls, tree: Tree) -> Tree:
        """The controller, with what else is of the case among its settings."""
        controller = tree.pop("controller", {NAME: DEFAULT_CONTROLLER})
        return {**controller, **{key: value for key, value in tree.items() if value not in (None, [])}}

    def as_request(self) -> Request[Self]:
        """The request of the case, with the model that it was completed with."""
        model = {} if self.model is None else {"model": self.model}
        return dataclasses.replace(self.request, explicit={**self.explicit, **model})

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


def label_of(case: Request[Case]) -> str:
    """Label of a case: the explicit one, or the controller and what is explicit of it."""
    return _label(case.value("label"), case.value("controller"))


def _label(label: str, controller: ControllerComponent | Request[ControllerComponent]) -> str:
    label = label if label.strip() else request_of(controller).text
    if not is_printable(label):
        raise Refusal(f"the label {label!r} cannot be printed in a line; leave out its control characters")
    return label


def completed_case(
    case: Request[Case],
    situation: Situation,
    guard: Request[GuardSettings] | None = None,
    model: Request[ModelComponent] | None = None,
) -> Case:
    """The case with the defaults of a situation, and a guard and a model if it has none of its own."""
    patient, controller = situation.patient, request_of(case.value("controller"))
    every_min = case.value("every_min")
    if every_min is not None:
        from glucoloop.control.pace import samples_of_pace

        samples_of_pace(every_min, situation.sample_time_min)
    own_guard = case.explicit.get("guard", guard)
    own_model = case.value("model") or model
    defaults = patient.controller_defaults(controller.component.name)
    settings: dict[str, Any] = {
        "controller": completed(controller, defaults, noisy=situation.noisy),
        "guard": None if own_guard is None else guard_of(patient, own_guard),
    }
    if own_model is not None or controller.component.uses_model:
        chosen = Request(IdentifiedComponent) if own_model is None else request_of(own_model)
        identified = issubclass(chosen.component, IdentifiedComponent)
        pace_min = situation.sample_time_min if every_min is None else every_min
        of_patient = {"noise_variance": situation.noise_variance, **patient.identification(pace_min)}
        whole = completed(chosen, of_patient if identified else {})
        settings["model"] = whole if controller.component.uses_model or not identified else None
    return made_of(case, {**case.explicit, **settings})


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

    def read(self, tree: Any, *, allow_unusual: bool = True) -> Request[Case]:
        """Request from the tree of a case, or its text as a leaf of one."""
        controller = as_table(tree, self.tree)
        of_case: dict[str, Any] = {}
        if isinstance(controller, Mapping):
            of_case = {key: value for key, value in controller.items() if key in _beside()}
            controller = {key: value for key, value in controller.items() if key not in _beside()} or {
                NAME: Leaf(DEFAULT_CONTROLLER, place(of_case))
            }
        designed = CONTROLLERS.read(controller, allow_unusual=allow_unusual)
        for name in _beside().values():
            if name in designed.component.settings():
                raise Refusal(
                    f"the controller {designed.display_name} has a setting {name!r}, which every case has already; its "
                    "author has to give it another name"
                )
        case = read(Case, of_case, allow_unusual=allow_unusual)
        return requested(Case, {**case.explicit, "controller": designed}, place(tree))


Case.catalogue = _Cases()  # type: ignore[attr-defined]


def default_case(controller: str, situation: Situation) -> Case:
    """A controller with its default settings in a situation, on a model identified from an equally noisy record."""
    [case] = cases_of(controller)
    return completed_case(case, situation)


def cases_of(*names: str) -> tuple[Request[Case], ...]:
    """A case for each of some controllers, as a default of what a study asks for."""
    return tuple(Request(Case, {"controller": Request(CONTROLLERS.find(name))}) for name in names)


RANGES: Final = "ranges"
"""Setting of a search that holds the ranges, as texts by the name of the setting."""


def ranges_parted(tree: Mapping[str, Any], tuned: Collection[str], *, always: bool) -> Tree:
    """A tree whose ranges stand apart from the settings of its first controller.

    The settings `tuned` may be ranges; with `always` a single value of such a setting is a range too.
    """
    result = dict(tree)
    leaf = result.get("controller")
    if leaf is None:
        return result
    tables = list(map(as_table, leaf if isinstance(leaf, list) else [leaf]))
    if not tables or not isinstance(tables[0], Mapping):
        return result
    names = {name.removesuffix(ending_of(name)): name for name in tuned if name not in tables[0]}
    table = {str(names.get(key, key)): value for key, value in tables[0].items()}
    first = {key: value for key, value in table.items() if key not in tuned or not (always or _is_range(value))}
    ranges = {key: Leaf(_text(key, value), place(value)) for key, value in table.items() if key not in first}
    result["controller"] = [first, *tables[1:]] if first else tables[1:]
    if not result["controller"]:
        del result["controller"]
    return {**result, RANGES: ranges} if ranges else result


def with_ranges(tree: Tree, ranges: Mapping[str, str]) -> Tree:
    """A tree with its ranges among the settings of its first controller."""
    result = {key: value for key, value in tree.items() if key != RANGES}
    if ranges:
        first, *others = result.get("controller") or [{}]
        result["controller"] = [{**first, **ranges}, *others]
    return result


def _is_range(leaf: Any) -> bool:
    value = plain(leaf)
    return isinstance(value, list) or (isinstance(value, str) and bool({":", "|"} & set(value)))


def _text(name: str, leaf: Any) -> str:
    """A range as text; a file may hold a number or a list of numbers."""
    value = plain(leaf)
    if isinstance(value, list) and value:
        return "|".join(_text(name, item) for item in value)
    if isinstance(value, str | int | float) and not isinstance(value, bool):
        return str(value)
    at = place(leaf)
    raise Refusal(f"{f'{at}: ' if at else ''}{name} is {value!r}; write it like 1:4 or 0|1|3")
