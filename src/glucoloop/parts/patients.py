"""Catalogue of patients: description, place of the model, and usual settings.

A patient joins the command line, the configuration files and the trials by one entry in `PATIENTS`, or by the entry
point of another package in the group ``glucoloop.patients``.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final, Protocol, TypeVar

from glucoloop.parts.code import added, entry_points, loaded
from glucoloop.parts.routes import INTRAVENOUS, PUMP_OF_1999, ROUTES, SUBCUTANEOUS, pole_at, samples_of_memory
from glucoloop.parts.setting import Default, Tunings, known_names
from glucoloop.refusal import Refusal


class Named(Protocol):
    """Anything with a name."""

    @property
    def name(self) -> str:
        """Name under which it is found."""
        ...


E = TypeVar("E", bound=Named)


class EntryCatalogue(dict[str, E]):
    """Entries of one kind by name: those of this package, to which `find` adds those of other packages.

    Parameters
    ----------
    what : str
        Kind in messages, ``"controller"``; entry points of packages are in the group ``glucoloop.controllers``.
    kind : type
        Class of the entries.
    entries : iterable
        Entries of this package.
    """

    def __init__(self, what: str, kind: type[E], entries: Iterable[E]) -> None:
        super().__init__({entry.name: entry for entry in entries})
        self._what, self._kind, self._group = what, kind, f"{what}s"

    def find(self, name: str) -> E:
        """An entry by name: of this package, of another one, or ``module:attribute``.

        Raises
        ------
        ValueError
            For an unknown name, or an entry of another package that cannot be loaded.
        """
        entry: E | None = self.get(name) or added(self._group, name)
        if entry is None:
            raise Refusal(f"unknown {self._what} {name!r}; {known_names(name, self.names())}")
        if not isinstance(entry, self._kind):
            kind = type(entry).__name__
            raise Refusal(f"{name} is an instance of {kind}; it has to be one of {self._kind.__name__}")
        return entry

    def names(self) -> list[str]:
        """Names of all entries, those of other packages included."""
        return [*self, *sorted(entry_points(self._group))]


NOMINAL: Final = "nominal"
"""Name of the population of nominal patients, which every patient model has."""


@dataclass(frozen=True)
class OperatingPoint:
    """State of rest of a patient."""

    name: str
    summary: str
    """Rate and glucose at rest, for help."""
    tunings: Tunings = field(default_factory=dict)
    """Settings of controllers that are usual at this point only."""


@dataclass(frozen=True, kw_only=True)
class PatientEntry:
    """Description of a patient that is available without its equations."""

    name: str
    summary: str
    model: str
    """Place ``module:attribute`` of its `patients.model.PatientModel`."""
    operating_points: tuple[OperatingPoint, ...]
    """Operating points, the usual one first."""
    populations: Mapping[str, str] = field(default_factory=dict)
    """Summary of each population by name besides the nominal one; the first is the usual one."""
    insulin_route: str = INTRAVENOUS
    """Way of insulin into the body, one of `parts.routes.ROUTES`: it decides on units, and on all that is usual and
    that the entry does not tell: pump, identification, tunings and the limits of a guard."""
    max_change_mU_min: float = math.nan
    """Largest change of the rate of a usual pump, from one sample to the next; NaN: that of the route."""
    min_insulin_mU_min: float = math.nan
    max_insulin_mU_min: float = math.nan
    pulse_mU_min: float
    """Height of the pulses from which a model is identified; at most the basal rate."""
    memory_min: float = math.nan
    """Time after which the effect of a dose has died out; NaN: that of the route."""
    laguerre_pole: float = math.nan
    """Usual pole of the Laguerre functions, at 5-min samples; NaN: that of the route."""
    laguerre_functions: int = -1
    """Usual number of Laguerre functions; -1: that of the route."""
    tunings: Tunings = field(default_factory=dict)
    """Settings of controllers that are usual for this patient, where they differ from those of the route."""
    guard: Mapping[str, float] = field(default_factory=dict)
    """Limits of a guard that are usual for this patient, where they differ from those of the route."""

    def __post_init__(self) -> None:
        if self.insulin_route not in ROUTES:
            raise Refusal(
                f"the patient {self.name} has insulin by the route {self.insulin_route!r}; the known ones are: "
                f"{', '.join(ROUTES)}"
            )
        route = ROUTES[self.insulin_route]
        usual = {
            "max_change_mU_min": route.pump.max_change_mU_min,
            "min_insulin_mU_min": route.pump.min_mU_min,
            "max_insulin_mU_min": route.pump.max_mU_min,
            "memory_min": route.memory_min,
            "laguerre_pole": route.laguerre_pole,
        }
        for name, value in usual.items():
            if math.isnan(getattr(self, name)):
                object.__setattr__(self, name, value)
        if self.laguerre_functions < 0:
            object.__setattr__(self, "laguerre_functions", route.laguerre_functions)

    @property
    def under_the_skin(self) -> bool:
        """Whether insulin is given under the skin."""
        return self.insulin_route == SUBCUTANEOUS

    def operating_point(self, name: str) -> OperatingPoint:
        """An operating point by name.

        Raises
        ------
        ValueError
            If the patient has none of that name.
        """
        points = {point.name: point for point in self.operating_points}
        if name not in points:
            raise Refusal(f"unknown operating point {name!r} of {self.name}; {known_names(name, points)}")
        return points[name]

    @property
    def usual_point(self) -> str:
        """Name of the usual operating point."""
        return self.operating_points[0].name

    @property
    def usual_population(self) -> str:
        """Name of the usual population."""
        return next(iter(self.populations), NOMINAL)

    def usual_settings(self, controller: str, operating_point: str) -> Mapping[str, Default]:
        """Usual settings of a controller for this patient, where they differ from the controller's own.

        Raises
        ------
        ValueError
            For an unknown operating point.
        """
        of_route = ROUTES[self.insulin_route].tunings
        own = self.operating_point(operating_point).tunings.get(controller, {})
        return {**of_route.get(controller, {}), **self.tunings.get(controller, {}), **own}

    def identification(self, sample_time_min: float) -> dict[str, Any]:
        """Usual identification of a model at a sample time: memory in samples, and the Laguerre functions."""
        return {
            "memory": samples_of_memory(self.memory_min, sample_time_min),
            "laguerre_pole": pole_at(self.laguerre_pole, sample_time_min),
            "laguerre_functions": self.laguerre_functions,
        }

    def load(self) -> Any:
        """The model; importing it imports JAX.

        Raises
        ------
        ValueError
            If there is no such model.
        """
        return loaded(self.model)


def _process_noise(glucose: Default, other: Default, glucagon: Default) -> dict[str, Default]:
    return {
        "reference_start": Default(0),
        "glucose_process_noise": glucose,
        "other_process_noise": other,
        "glucagon_process_noise": glucagon,
    }


_OF_NOMINAL_22: Final = _process_noise(Default(10.0, noisy=0.9), Default(0.01), Default(0.1, noisy=0.003))
_OF_FASTING_81: Final = _process_noise(Default(10.0, noisy=0.3), Default(0.01, noisy=0.1), Default(0.1, noisy=0.03))

_UNDER_THE_SKIN: Final[dict[str, Any]] = {
    "insulin_route": SUBCUTANEOUS,
    # The pump of 1999, 4 U/h, is ample for people who need 0.4 and 0.9 U/h.
    "max_change_mU_min": PUMP_OF_1999.max_change_mU_min,
    "max_insulin_mU_min": PUMP_OF_1999.max_mU_min,
    # Horizons of three and four hours, with which the numbers of the guide were made.
    "tunings": {
        "mpc": {"prediction_horizon": Default(36)},
        "mpc-se": {"prediction_horizon": Default(48)},
        "nlqdmc-se": {"prediction_horizon": Default(48)},
        "meal-mpc": {"prediction_horizon": Default(48)},
    },
}

PATIENTS: Final = EntryCatalogue(
    "patient",
    PatientEntry,
    (
        PatientEntry(
            name="parker-1999",
            summary="Sorensen's 19 states as Parker, Doyle and Peppas (1999) use them; insulin into a vein, 70 kg",
            model="glucoloop.patients.sorensen.model:PARKER_1999_MODEL",
            operating_points=(
                OperatingPoint("setpoint-81", "held at 81.1 mg/dl by 25.61 mU/min"),
                OperatingPoint(
                    "nominal-22",
                    "22.33 mU/min, which hold 92.1 mg/dl",
                    {"mpc-se": _OF_NOMINAL_22, "nlqdmc-se": _OF_NOMINAL_22},
                ),
                OperatingPoint(
                    "fasting-81",
                    "22.33 mU/min, which hold 81.2 mg/dl in a person whose healthy fasting glucose is 81 mg/dl",
                    {"mpc-se": _OF_FASTING_81, "nlqdmc-se": _OF_FASTING_81},
                ),
            ),
            populations={
                "parker2000": "up to 40 % in the eight parameters of Parker et al. (2000), uniform",
                "lognormal": (
                    "the same eight, lognormal with a coefficient of variation of 20 %, and weight of 70 kg with 15 %"
                ),
            },
            pulse_mU_min=22.33,
        ),
        PatientEntry(
            name="hovorka-2004",
            summary="the model of Hovorka et al. (2004); insulin under the skin, 75 kg",
            model="glucoloop.patients.hovorka.model:HOVORKA_2004_MODEL",
            operating_points=(OperatingPoint("fasting-120", "held at 120 mg/dl by 6.73 mU/min, which is 0.404 U/h"),),
            populations={
                "boiroux2017": "sixteen constants that differ as in the virtual people of Boiroux et al. (2017)",
            },
            pulse_mU_min=6.5,
            **_UNDER_THE_SKIN,
        ),
        PatientEntry(
            name="wilinska-2010",
            summary="the Cambridge simulator's model, of Wilinska et al. (2010); insulin under the skin, 74.9 kg",
            model="glucoloop.patients.hovorka.model:WILINSKA_2010_MODEL",
            operating_points=(OperatingPoint("fasting-120", "held at 120 mg/dl by 14.97 mU/min, which is 0.898 U/h"),),
            populations={
                "wilinska2010": "ten constants that differ as in the virtual people of Wilinska et al. (2010)",
            },
            pulse_mU_min=14.5,
            **_UNDER_THE_SKIN,
        ),
    ),
)
USUAL_PATIENT: Final = PATIENTS["parker-1999"]


def patient_entry(name: str) -> PatientEntry:
    """A patient by name: of this package, of another one, or ``module:attribute``.

    Raises
    ------
    ValueError
        For an unknown name, or one of another package that cannot be loaded.
    """
    of = next((entry for entry in PATIENTS.values() if name in [point.name for point in entry.operating_points]), None)
    if of is not None and name not in PATIENTS.names():
        raise Refusal(f"{name!r} is an operating point of {of.name} and no patient; give it as the operating point")
    return PATIENTS.find(name)


patient_names: Final = PATIENTS.names
"""Function that returns the names of all patients, those of other packages included."""
