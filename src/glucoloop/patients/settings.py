"""Patients: name and settings of each, its populations, and what is usual for it, without its equations.

A patient joins every command by one class, entered in `PATIENTS` or by the entry point of another package in the group
``glucoloop.patients``.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, ClassVar, Final

from glucoloop.component.base import Component
from glucoloop.component.catalogue import Catalogue
from glucoloop.component.effects import TIME_OF_DAY, Need
from glucoloop.component.routes import INTRAVENOUS, PUMP_OF_1999, ROUTES, SUBCUTANEOUS, route_of
from glucoloop.component.setting import About, Default, Tunings, known_names
from glucoloop.refusal import Refusal

NOMINAL: Final = "nominal"
"""Name of the population of nominal patients, which every patient model has."""
_USUAL: Final = (
    "max_change_mU_min",
    "min_insulin_mU_min",
    "max_insulin_mU_min",
    "pulse_mU_min",
    "memory_min",
    "laguerre_pole",
    "laguerre_functions",
)


@dataclass(frozen=True)
class OperatingPoint:
    """State of rest of a patient."""

    name: str
    summary: str
    """Rate and glucose at steady state, for help."""
    tunings: Tunings = field(default_factory=dict)
    """Settings of controllers that are usual at this point only."""


def _person(given: object) -> str | None:
    """Name or number of a person, as a text."""
    if given is None or (isinstance(given, str) and given.strip()):
        return given
    if isinstance(given, int) and not isinstance(given, bool):
        return str(given)
    raise Refusal("give a name or a number, like person=3 or person=people.csv:anna")


class PatientComponent(Component):
    """Declaration of a patient.

    What a class does not declare is usual for its route of insulin: pump, identification, tunings and the limits of a
    guard.

    Raises
    ------
    Refusal
        For an unknown route of insulin, or an unknown operating point.
    """

    kind: ClassVar = "patient"
    model: ClassVar[str] = ""
    """Place ``module:attribute`` of its `patients.model.PatientModel`."""
    operating_points: ClassVar[tuple[OperatingPoint, ...]] = ()
    """Operating points, the default one first."""
    populations: ClassVar[Mapping[str, str]] = {}
    """Summary of each population by name besides the nominal one; the first is the default one."""
    timeless: ClassVar[bool] = False
    """Whether its equations are the same at any time of day; one that does not say is taken to follow the clock."""
    insulin_route: ClassVar[str] = INTRAVENOUS
    """Way of insulin into the body, one of `component.routes.ROUTES`."""
    max_change_mU_min: ClassVar[float]
    """Largest change of the rate of a default pump, from one sample to the next."""
    min_insulin_mU_min: ClassVar[float]
    max_insulin_mU_min: ClassVar[float]
    pulse_mU_min: ClassVar[float]
    """Height of the pulses from which a model is identified; at most the basal rate."""
    memory_min: ClassVar[float]
    """Time after which the effect of a dose has died out."""
    laguerre_pole: ClassVar[float]
    """Usual pole of the Laguerre functions, at 5-min samples."""
    laguerre_functions: ClassVar[int]
    """Default number of Laguerre functions."""
    tunings: ClassVar[Tunings] = {}
    """Settings of controllers that are usual for this patient, where they differ from those of the route."""
    guard: ClassVar[Mapping[str, float]] = {}
    """Limits of a guard that are usual for this patient, where they differ from those of the route."""

    subcutaneous: ClassVar[bool] = False
    """Whether insulin is given subcutaneously; it follows from the route."""
    default_operating_point: ClassVar[str] = ""
    """Name of the first operating point."""
    default_population: ClassVar[str] = NOMINAL
    """Name of the first population."""

    operating_point: Annotated[
        str | None, About("Where the patient rests; by default at the first of the patient's operating points.")
    ] = None
    person: Annotated[
        Any,
        About(
            "One person in place of the nominal patient and of all people: by name, or by number where people have no "
            "names, of the default population or of another one, like people.csv:anna; people who are drawn follow the "
            "seed.",
            reads=_person,
        ),
    ] = None

    def uses(self) -> frozenset[Need]:
        """A patient uses the time of day whose equations follow the clock."""
        return frozenset(() if self.timeless else {TIME_OF_DAY})

    def __init_subclass__(cls, **more: Any) -> None:
        super().__init_subclass__(**more)
        if not cls.model:
            return
        route = route_of(cls.insulin_route)
        if not (cls.operating_points and hasattr(cls, "pulse_mU_min")):
            raise TypeError(f"the patient {cls.__name__} lacks operating_points or pulse_mU_min; add them")
        usual = {
            "max_change_mU_min": route.pump.max_change_mU_min,
            "min_insulin_mU_min": route.pump.min_mU_min,
            "max_insulin_mU_min": route.pump.max_mU_min,
            "memory_min": route.memory_min,
            "laguerre_pole": route.laguerre_pole,
            "laguerre_functions": route.laguerre_functions,
        }
        for name, value in usual.items():
            if not hasattr(cls, name):
                setattr(cls, name, value)
        cls.subcutaneous = cls.insulin_route == SUBCUTANEOUS
        cls.default_operating_point = cls.operating_points[0].name
        cls.default_population = next(iter(cls.populations), NOMINAL)

    def __post_init__(self) -> None:
        if self.operating_point is not None:
            self.point(self.operating_point)

    @classmethod
    def facts(cls) -> dict[str, Any]:
        """Route of insulin, operating points, populations, and what is usual for the patient."""
        return {
            "insulin_route": cls.insulin_route,
            "operating_points": {point.name: point.summary for point in cls.operating_points},
            "populations": {NOMINAL: "the nominal patient, whoever is drawn", **cls.populations},
            "usual": {name: getattr(cls, name) for name in _USUAL},
        }

    @property
    def rests_at(self) -> str:
        """Name of the operating point."""
        return self.operating_point or self.default_operating_point

    @property
    def place(self) -> str:
        """Short name of the operating point, after the name of the patient unless it is the default one."""
        where = self.rests_at if self.name == DEFAULT_PATIENT.name else f"{self.display_name}, {self.rests_at}"
        return where if self.person is None else f"{where}, person {self.person}"

    @classmethod
    def point(cls, name: str) -> OperatingPoint:
        """An operating point by name; Refusal if the patient has none of that name."""
        points = {point.name: point for point in cls.operating_points}
        if name not in points:
            raise Refusal(f"unknown operating point {name!r} of {cls.name}; {known_names(name, points)}")
        return points[name]

    def controller_defaults(self, controller: str) -> Mapping[str, Default]:
        """Default settings of a controller for this patient, where they differ from the controller's own."""
        tunings = (ROUTES[self.insulin_route].tunings, self.tunings, self.point(self.rests_at).tunings)
        return {name: value for tuning in tunings for name, value in tuning.get(controller, {}).items()}

    @classmethod
    def identification(cls, sample_time_min: float) -> dict[str, Any]:
        """Usual identification of a model at a sample time: memory in samples, and the Laguerre functions."""
        own = {name: getattr(cls, name) for name in ("memory_min", "laguerre_pole", "laguerre_functions")}
        return dataclasses.replace(ROUTES[cls.insulin_route], **own).identification(sample_time_min)


_AT_NOMINAL_22: Final = {
    "reference_start": Default(0),
    "glucose_process_noise": Default(10.0, noisy=0.9),
    "other_process_noise": Default(0.01),
    "glucagon_process_noise": Default(0.1, noisy=0.003),
}
_AT_FASTING_81: Final = {
    "reference_start": Default(0),
    "glucose_process_noise": Default(10.0, noisy=0.3),
    "other_process_noise": Default(0.01, noisy=0.1),
    "glucagon_process_noise": Default(0.1, noisy=0.03),
}


class Parker1999Part(PatientComponent, name="parker-1999"):
    """Sorensen's 19 states as Parker, Doyle and Peppas (1999) use them; intravenous insulin, 70 kg."""

    timeless: ClassVar = True
    sources = ("parker1999", "parker2000", "sorensen1985", "lehmann1992")
    model = "glucoloop.patients.sorensen.model:PARKER_1999_MODEL"
    operating_points = (
        OperatingPoint("setpoint-81", "held at 81.1 mg/dl by 25.61 mU/min"),
        OperatingPoint(
            "nominal-22", "22.33 mU/min, which hold 92.1 mg/dl", {"mpc-se": _AT_NOMINAL_22, "nlqdmc-se": _AT_NOMINAL_22}
        ),
        OperatingPoint(
            "fasting-81",
            "22.33 mU/min, which hold 81.2 mg/dl in a person whose healthy fasting glucose is 81 mg/dl",
            {"mpc-se": _AT_FASTING_81, "nlqdmc-se": _AT_FASTING_81},
        ),
    )
    populations: ClassVar = {
        "parker2000": "up to 40 % in the eight parameters of Parker et al. (2000), uniform",
        "lognormal": "the same eight, lognormal with a coefficient of variation of 20 %, and weight of 70 kg with 15 %",
    }
    pulse_mU_min = 22.33


class _HovorkaPart(PatientComponent):
    """A patient of Hovorka's family, with the pump and the horizons with which the numbers of the guide were made."""

    timeless: ClassVar = True
    insulin_route = SUBCUTANEOUS
    # The pump of 1999, 4 U/h, is ample for people who need 0.4 and 0.9 U/h.
    max_change_mU_min = PUMP_OF_1999.max_change_mU_min
    max_insulin_mU_min = PUMP_OF_1999.max_mU_min
    # Horizons of three and four hours.
    tunings: ClassVar = {
        "mpc": {"prediction_horizon": Default(36)},
        "mpc-se": {"prediction_horizon": Default(48)},
        "nlqdmc-se": {"prediction_horizon": Default(48)},
        "meal-mpc": {"prediction_horizon": Default(48)},
    }


class Hovorka2004Part(_HovorkaPart, name="hovorka-2004"):
    """The model of Hovorka et al. (2004); subcutaneous insulin, 75 kg."""

    sources = ("hovorka2004",)
    model = "glucoloop.patients.hovorka.model:HOVORKA_2004_MODEL"
    operating_points = (OperatingPoint("fasting-120", "held at 120 mg/dl by 6.73 mU/min, which is 0.404 U/h"),)
    populations: ClassVar = {
        "boiroux2017": "sixteen constants that differ as in the virtual people of Boiroux et al. (2017)"
    }
    pulse_mU_min = 6.5


class Wilinska2010Part(_HovorkaPart, name="wilinska-2010"):
    """The Cambridge simulator's model, of Wilinska et al. (2010); subcutaneous insulin, 74.9 kg."""

    sources = ("wilinska2010", "hovorka2004")
    model = "glucoloop.patients.hovorka.model:WILINSKA_2010_MODEL"
    operating_points = (OperatingPoint("fasting-120", "held at 120 mg/dl by 14.97 mU/min, which is 0.898 U/h"),)
    populations: ClassVar = {
        "wilinska2010": "ten constants that differ as in the virtual people of Wilinska et al. (2010)"
    }
    pulse_mU_min = 14.5


class Kanderian2009Part(PatientComponent, name="kanderian-2009"):
    """The ten people of Kanderian et al. (2009), the Medtronic virtual patient; subcutaneous insulin."""

    timeless: ClassVar = True
    sources = ("kanderian2009",)
    model = "glucoloop.patients.kanderian.patient:KANDERIAN_2009_MODEL"
    operating_points = (OperatingPoint("fasting-120", "person 1, held at 120 mg/dl by 22.0 mU/min, which is 1.32 U/h"),)
    populations: ClassVar = {"kanderian2009": "the ten people of Kanderian et al. (2009), by name 1 to 10"}
    insulin_route = SUBCUTANEOUS
    pulse_mU_min = 20.0


class RoyParker2007Part(PatientComponent, name="roy-parker-2007"):
    """The minimal model with exercise of Roy and Parker (2007); intravenous insulin, 70 kg."""

    timeless: ClassVar = True
    sources = ("royparker2007",)
    model = "glucoloop.patients.roy_parker2007:ROY_PARKER_2007_MODEL"
    operating_points = (OperatingPoint("fasting-100", "held at 100 mg/dl by 16.67 mU/min, which is 1 U/h"),)
    pulse_mU_min = 16.0


class McGill2020Part(PatientComponent, name="mcgill-2020"):
    """Bergman's minimal model with exercise and subcutaneous insulin, of the McGill Diabetes Lab (2020); 70 kg."""

    timeless: ClassVar = True
    sources = ("bergman1979", "mcgill2020")
    model = "glucoloop.patients.mcgill2020:MCGILL_2020_MODEL"
    insulin_route = SUBCUTANEOUS
    operating_points = (OperatingPoint("fasting-117", "held at 117.1 mg/dl by 12.37 mU/min, which is 0.742 U/h"),)
    pulse_mU_min = 12.0


class UvaPadova2008Part(PatientComponent, name="uva-padova-2008"):
    """The model of the UVA/Padova simulator of 2008, of Dalla Man et al. (2007); subcutaneous insulin, 78 kg."""

    timeless: ClassVar = True
    sources = ("dallaman2007", "dallaman2007gim", "kovatchev2009")
    model = "glucoloop.patients.dalla_man.model:UVA_PADOVA_2008_MODEL"
    insulin_route = SUBCUTANEOUS
    operating_points = (OperatingPoint("fasting-120", "held at 120 mg/dl by 6.99 mU/min, which is 0.419 U/h"),)
    populations: ClassVar = {
        "lognormal": "ten constants, lognormal with a coefficient of variation of 20 %, and weight with 15 %",
        "simglucose": "the thirty people of the simulator, read from an installed simglucose",
    }
    # A unit moves glucose little, and readings with noise of variance 1.45 still give a gain that can be trusted.
    pulse_mU_min = 6.95
    laguerre_pole = 0.95
    laguerre_functions = 5


class _Patients(Catalogue[PatientComponent]):
    """The patients; one that is named by its operating point is refused with the mend."""

    def find(self, name: str) -> type[PatientComponent]:
        for part in self.values():
            if name in [point.name for point in part.operating_points] and name not in self.names():
                raise Refusal(
                    f"{name!r} is an operating point of {part.name} and no patient; write "
                    f"'{part.name}, operating_point={name}'"
                )
        return super().find(name)


PATIENTS: Final = _Patients(
    PatientComponent,
    {
        "parker-1999": "glucoloop.patients.settings:Parker1999Part",
        "hovorka-2004": "glucoloop.patients.settings:Hovorka2004Part",
        "wilinska-2010": "glucoloop.patients.settings:Wilinska2010Part",
        "uva-padova-2008": "glucoloop.patients.settings:UvaPadova2008Part",
        "kanderian-2009": "glucoloop.patients.settings:Kanderian2009Part",
        "roy-parker-2007": "glucoloop.patients.settings:RoyParker2007Part",
        "mcgill-2020": "glucoloop.patients.settings:McGill2020Part",
    },
    example="parker-1999, operating_point=nominal-22",
    unnamed=True,
)
DEFAULT_PATIENT: Final = Parker1999Part
patient_entry: Final = PATIENTS.find
"""Function that returns a patient by name: of this package, of another one, or ``module:Class``."""
