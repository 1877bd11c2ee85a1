"""League: every controller on the people of every family, under each sensor and in each scenario.

A cell is a family, a sensor and a scenario; in it every controller meets the same people, days and noise. A row that is
kept holds the people of a shard under one controller, so that an interrupted league resumes.
"""

from __future__ import annotations

import functools
from collections.abc import Iterable, Mapping
from typing import Annotated, Any, ClassVar, Final, Self

from glucoloop.component.base import Component
from glucoloop.component.effects import EVERYTHING, Need
from glucoloop.component.grammar import Tree
from glucoloop.component.request import Request, request_of
from glucoloop.component.setting import CONTROLLER_PANEL, PATIENT_PANEL, PEOPLE_PANEL, SENSOR_PANEL, Option
from glucoloop.control.catalogue import CONTROLLERS
from glucoloop.meals.rescue import RESCUES, RescueComponent
from glucoloop.metrics.metric import METRICS
from glucoloop.patients.catalogue import PATIENTS
from glucoloop.patients.component import PatientComponent
from glucoloop.refusal import Refusal
from glucoloop.sensors import SENSORS, SensorComponent
from glucoloop.situations.case import Case, cases_of, label_of
from glucoloop.situations.scenarios import SCENARIOS, ScenarioComponent
from glucoloop.situations.situation import Glucagon
from glucoloop.situations.therapy_settings import ProfileBy, WrongProfile
from glucoloop.studies.study import COMPONENTS_HELP, SearchStudy
from glucoloop.units import LARGEST_SEED

MAX_PEOPLE: Final = 10_000
MAX_BEST: Final = 1000
"""Largest number of people of a family for whom the best doses are searched."""
_people = functools.partial(Option, panel=PEOPLE_PANEL)
_controller = functools.partial(Option, panel=CONTROLLER_PANEL)


class League(Component):
    """The families, sensors, scenarios and controllers of a league."""

    kind: ClassVar = "league"

    people: Annotated[
        int,
        _people("Number of people of each family, or all of one that has fewer.", at_least=2, at_most=MAX_PEOPLE),
    ] = 100
    families: Annotated[
        tuple[Request[PatientComponent], ...],
        _people(
            "Patient, around whom the people of the default population vary; repeat it for more.", flag="--patient"
        ),
    ] = tuple(Request(patient) for patient in PATIENTS.values() if not patient.extends)
    scenarios: Annotated[
        tuple[ScenarioComponent, ...],
        Option("Scenario, like 'week, days=14'; repeat it for more.", panel=PATIENT_PANEL, flag="--scenario"),
    ] = tuple(map(SCENARIOS.by_default, ("plain-day", "unkind-day", "week")))
    sensors: Annotated[
        tuple[SensorComponent, ...],
        Option("Sensor that is tried alone; repeat it for more.", panel=SENSOR_PANEL, flag="--sensor"),
    ] = tuple(map(SENSORS.by_default, ("dexcom-g6", "white-noise, variance=1.45")))
    controllers: Annotated[
        tuple[Request[Case], ...],
        _controller(
            "Controller with its settings, like 'mpc-se, move_horizon=2, label=careful'; repeat it for more. Slow ones "
            "take part only if they are named.",
            flag="--controller",
        ),
    ] = cases_of(*(name for name, part in CONTROLLERS.items() if not part.slow))
    rescue: Annotated[
        RescueComponent | None,
        Option(
            "Fast carbohydrate that people eat when glucose is low, like 'below_mg_dl=65, carbs_g=20', or none; its "
            "grams a day are a column.",
            alone="carbs",
            default="carbs with subcutaneous insulin, none with intravenous insulin or --bound",
            panel=PATIENT_PANEL,
        ),
    ] = RESCUES.by_default("carbs")
    glucagon: Glucagon = None
    profile_by: ProfileBy = "table"
    profile_error: WrongProfile = None
    reference: Annotated[
        Request[Case],
        _controller("Therapy with which each person is compared under the controllers; it takes part too."),
    ] = cases_of("basal-bolus")[0]
    worse_by_pct: Annotated[
        float,
        _controller(
            "Time below 54 or 70 mg/dl, in percent of the run, beyond that under the reference, above which a person "
            "counts as harmed.",
            at_least=0.0,
            below=100.0,
        ),
    ] = 1.0
    bound_people: Annotated[
        int,
        _people(
            "Number of the first people of each family for whom the best doses are searched too, in each scenario; "
            "that takes seconds for each day of a person.",
            flag="--bound",
            at_least=0,
            at_most=MAX_BEST,
        ),
    ] = 0
    seed: Annotated[
        int, Option("The same seed gives the same people, days and noise.", at_least=0, at_most=LARGEST_SEED)
    ] = 0

    def __post_init__(self) -> None:
        super().__post_init__()
        for flag, names in (
            ("--patient", self.family_names),
            ("--scenario", texts(self.scenarios)),
            ("--sensor", texts(self.sensors)),
            ("--controller", tuple(map(label_of, self.controllers))),
        ):
            if not names:
                raise Refusal(f"{flag} is none; a league needs at least one, leave {flag} out for the default ones")
            for text in names:
                if names.count(text) > 1:
                    raise Refusal(f"{flag} {text!r} is given twice; leave one out, or give each another label")
        if self.rescue is not None and self.bound_people:
            raise Refusal(
                "the best doses are searched without rescue carbohydrate, so that no distance to them is fair with it; "
                "leave --rescue or --bound out"
            )
        if self.glucagon is not None and self.bound_people:
            raise Refusal(
                "the best doses are searched without glucagon, so that no distance to them is fair with it; leave "
                "--glucagon or --bound out"
            )
        if self.bound_people > self.people:
            raise Refusal(
                f"--bound is {self.bound_people}, and a family has {self.people} people; give at most {self.people}, "
                f"or {self.bound_people} with --people"
            )

    @classmethod
    def defaults_of(cls, request: Request[Self], defaults: Mapping[str, Any]) -> Mapping[str, Any]:
        """Defaults, without rescue carbohydrate where the best doses are searched."""
        without = {"rescue": None} if request.explicit.get("bound_people") else {}
        return super().defaults_of(request, {**defaults, **without})

    def of_family(self, subcutaneous: bool) -> dict[str, Any]:
        """Settings of a family's trials; titration, and rescue carbohydrate by default, need subcutaneous insulin."""
        rescue = self.rescue if subcutaneous or "rescue" in self.explicit else None
        titrated = {"profile_by": self.profile_by} if subcutaneous else {}
        metrics = {} if rescue is None else {"metrics": (METRICS.choose("rescues"),)}
        of_all = {"glucagon": self.glucagon, "profile_error": self.profile_error, "seed": self.seed}
        return {**titrated, **metrics, "rescue": rescue, **of_all}

    def uses(self) -> frozenset[Need]:
        """Everything: what one controller or scenario has no use for, another one has."""
        return EVERYTHING

    @property
    def family_names(self) -> tuple[str, ...]:
        """Name of each family."""
        return texts(self.families)

    @property
    def cases(self) -> tuple[Request[Case], ...]:
        """The controllers, the reference among them."""
        known = self.reference_label in map(label_of, self.controllers)
        return self.controllers if known else (*self.controllers, self.reference)

    @property
    def reference_label(self) -> str:
        """Label of the reference."""
        return label_of(self.reference)

    @property
    def left_out(self) -> tuple[str, ...]:
        """Controllers of the catalogue that take no part because they are slow, unless others were asked for."""
        return () if "controllers" in self.explicit else tuple(name for name, part in CONTROLLERS.items() if part.slow)

    def tree(self, *, whole: bool = False) -> Tree:
        """Settings as plain values; defaults of a controller depend on the cell, and are not among them."""
        results = super().tree(whole=whole)
        if whole:
            results |= {"controllers": [case.tree() for case in self.controllers], "reference": self.reference.tree()}
        return results


def texts(components: Iterable[Component | Request[Any]]) -> tuple[str, ...]:
    """Text of each component, with what is explicit of it."""
    return tuple(request_of(component).text for component in components)


LEAGUE: Final = SearchStudy(
    name="league",
    what="a league",
    help=(
        "Say which controller is best for whom, and where each does harm: every controller on the people of every "
        "family, under each sensor and in each scenario; the results are tables and a page.\n\n"
        "A family is a patient with its default population. Every controller meets the same people, days and noise. "
        "Times in ranges stand beside the targets of the international consensus (Battelino et al., 2019), and each "
        "person is compared with the same person under a reference therapy. Controllers are ranked by the glycemia "
        "risk index. By default 100 people of each family take part, which takes some minutes. The folder of --out is "
        "written as it grows; after Ctrl-C, the same command continues where it stopped.\n\n"
        f"{COMPONENTS_HELP}\n\n"
        "  glucoloop league --out league\n\n"
        "  glucoloop league --people 1000 --out whole-league\n\n"
        "  glucoloop league --bound 10 --out league\n\n"
        "  glucoloop league --patient hovorka-2004 --controller mpc-se --controller 'mpc-se, label=guarded, "
        "guard=usual' --out guarded\n\n"
        "  glucoloop league --config league/league.toml --out again"
    ),
    module="glucoloop.studies.league.study",
    request=League,
    option_texts={"default": {"sensors": "dexcom-g6; and white-noise, variance=1.45"}},
    extent=("bound_people",),
    results="people.parquet",
    files=("league.csv", "league.parquet", "league.html", "figure.pdf", "figure.png", "figure.svg"),
)
