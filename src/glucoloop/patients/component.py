"""A patient: a class with its settings, its constants, its equations and its populations, entered once.

A patient joins every command by one class, entered in `PATIENTS` or by the entry point of another package in the group
``glucoloop.patients``. `patients.ode.OdePatient` is the base of one that is given by its equations alone.
"""

from __future__ import annotations

import dataclasses
import difflib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Final, NamedTuple, Self, TypeAlias

from glucoloop._lazy_jax import jax, jnp
from glucoloop._representation import represented
from glucoloop.component.effects import TIME_OF_DAY, Need
from glucoloop.component.pytree_component import DATA, HOST, PytreeComponent, Role, same_parts, wired
from glucoloop.component.request import Request
from glucoloop.component.routes import INTRAVENOUS, ROUTES, SUBCUTANEOUS, PumpRange, route_of
from glucoloop.component.setting import About, Default, Tunings, known_names
from glucoloop.patients.protocol import Inputs
from glucoloop.patients.resting import Rest
from glucoloop.refusal import Refusal

if TYPE_CHECKING:
    from glucoloop.patients.population import Population
    from glucoloop.patients.variation import Distribution, JointVariation, Variation


Sound: TypeAlias = "Callable[[jax.Array, jax.Array], tuple[jax.Array, jax.Array]]"
NOMINAL: Final = "nominal"
"""Name of the population of nominal patients, which every patient has."""
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
    """Steady state of a patient."""

    name: str
    summary: str
    """Rate and glucose at steady state, for help."""
    tunings: Tunings = field(default_factory=dict)
    """Settings of controllers that are usual at this point only."""
    glucose_mg_dl: float = 0.0
    """Glucose at which the nominal person rests there, unless the class has its own `at_operating_point`."""


def _person(given: object) -> str | None:
    """Name or number of a person, as a text."""
    if given is None or (isinstance(given, str) and given.strip()):
        return given
    if isinstance(given, int) and not isinstance(given, bool):
        return str(given)
    raise Refusal("give a name or a number, like person=3 or person=people.csv:anna")


@represented
class PatientComponent(PytreeComponent):
    """A patient: an object of its class is a person, or are people, with constants and an operating point.

    What a class does not declare is usual for its route of insulin: pump, identification, tunings and the limits of a
    guard. The members of `patients.protocol.Patient` and `rest` are its equations; what is optional is in
    `patients.capabilities`. As a component, before a person is made of it, an object has its settings alone.

    Raises
    ------
    Refusal
        For an unknown route of insulin, or an unknown operating point.
    """

    kind: ClassVar = "patient"
    role_of_settings: ClassVar[Role | None] = HOST
    operating_points: ClassVar[tuple[OperatingPoint, ...]] = ()
    """Operating points, the default one first."""
    populations: ClassVar[Mapping[str, str]] = {}
    """Summary of each population by name besides the nominal one; the first is the default one."""
    of_other_packages: ClassVar[tuple[str, ...]] = ()
    """Names of those populations that are read from another package."""
    nominal: ClassVar[Mapping[str, float]] = {}
    """All constants that can vary, with the value of the nominal person."""
    follows: ClassVar[Mapping[str, tuple[str, ...]]] = {}
    """Constants that follow from others, each with these others."""
    meanings: ClassVar[Mapping[str, str]] = {}
    """Meaning of constants that can vary, in words."""
    hint: ClassVar[str] = ""
    """List of the constants that can vary, for the refusal of an unknown one."""
    rest: ClassVar[Rest]
    """Functions by which a person rests."""
    extends: ClassVar[str] = ""
    """Name of the patient that it is without what it adds; a league leaves it out by default."""
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

    usual_pump: ClassVar[PumpRange]
    """Rates of a default pump, which follow from the three above, or from the route."""
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

    parameters: Any = wired(DATA, default=None)
    """Constants of one person, or of people, who trail where they vary."""
    basal_insulin_mU_min: jax.Array = wired(DATA, default=None)
    setpoint_mg_dl: jax.Array = wired(DATA, default=None)

    def as_request(self) -> Request[Self]:
        """The request from which the same patient is made; Refusal for constants that no name stands for."""
        if self.parameters is None:
            return super().as_request()
        for point in self.operating_points:
            if not type(self).at_operating_point(point.name)._differs(self):
                return dataclasses.replace(self.request, explicit={**self.explicit, "operating_point": point.name})
        raise Refusal(
            f"the patient {self.display_name} has constants, or a steady state, that are of none of its operating "
            "points, and a configuration names its people. Give a name, with person= for one of a population or of a "
            "table, or use gl.simulate, which takes a patient as it is"
        )

    def _differs(self, other: PatientComponent) -> bool:
        """Whether another object is another person, or rests elsewhere."""
        names = ("parameters", "basal_insulin_mU_min", "setpoint_mg_dl")
        return not all(same_parts(getattr(self, name), getattr(other, name)) for name in names)

    def uses(self) -> frozenset[Need]:
        """A patient uses the time of day whose equations follow the clock."""
        return frozenset(() if self.timeless else {TIME_OF_DAY})

    def __init_subclass__(cls, **more: Any) -> None:
        super().__init_subclass__(**more)
        route = route_of(cls.insulin_route)
        if not (cls.name or cls.operating_points):
            return
        cls.refuse_incomplete()
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
        cls.usual_pump = PumpRange(
            max_change_mU_min=cls.max_change_mU_min,
            min_mU_min=cls.min_insulin_mU_min,
            max_mU_min=cls.max_insulin_mU_min,
        )
        cls.subcutaneous = cls.insulin_route == SUBCUTANEOUS
        cls.default_operating_point = cls.operating_points[0].name
        cls.default_population = next(iter(cls.populations), NOMINAL)

    @classmethod
    def refuse_incomplete(cls) -> None:
        """Refuse a class that lacks what an entry among the patients needs."""
        if not (cls.operating_points and hasattr(cls, "pulse_mU_min")):
            raise TypeError(f"the patient {cls.__name__} lacks operating_points or pulse_mU_min; add them")

    @classmethod
    def _rebuilt(cls, values: Mapping[str, Any]) -> Self:
        # The settings chose the person, and are no part of a person.
        return super()._rebuilt({"operating_point": None, "person": None, **values})

    def __post_init__(self) -> None:
        if self.operating_point is not None:
            self.point(self.operating_point)

    @classmethod
    def facts(cls) -> dict[str, Any]:
        """Route of insulin, operating points, populations, and the defaults of the patient."""
        return {
            "insulin_route": cls.insulin_route,
            "operating_points": {point.name: point.summary for point in cls.operating_points},
            "populations": {NOMINAL: "the nominal patient, whoever is drawn", **cls.populations},
            "default": {name: getattr(cls, name) for name in _USUAL},
        }

    @property
    def rests_at(self) -> str:
        """Name of the operating point."""
        return self.operating_point or self.default_operating_point

    @property
    def place(self) -> str:
        """Short name of the operating point, after the name of the patient unless it is the default one."""
        from glucoloop.patients.catalogue import PATIENTS

        where = self.rests_at if self.name == PATIENTS.default else f"{self.display_name}, {self.rests_at}"
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

    @classmethod
    def refuse_unknown(cls, parameter: str) -> None:
        """Refuse the name of an unknown constant, with the most similar known one."""
        if parameter in cls.nominal:
            return
        if parameter in cls.follows:
            raise Refusal(f"{parameter} follows from {' and '.join(cls.follows[parameter])}; vary these instead")
        close = difflib.get_close_matches(parameter, cls.nominal, n=1)
        meant = f"did you mean {close[0]!r}? " if close else ""
        known = cls.hint or f"the known ones are: {', '.join(cls.nominal) or 'none, since nothing can vary'}"
        raise Refusal(f"unknown parameter {parameter!r}; {meant}{known}")

    @classmethod
    def refuse_impossible(cls, varied: Mapping[str, Distribution]) -> None:
        """Refuse distributions of constants that can make an impossible person; by default none is refused."""

    @classmethod
    def population(cls, name: str) -> Population:
        """A population by its name among `populations`."""
        from glucoloop.patients.population import Population

        return Population(name, tuple(cls.variations(name)), cls.populations[name], patient=cls.name)

    @classmethod
    def variations(cls, population: str) -> Sequence[Variation | JointVariation]:
        """Constants that vary in a population, each independently, or several jointly."""
        raise NotImplementedError

    @classmethod
    def nominal_profile(cls) -> Mapping[str, float]:
        """Known fields of the nominal person's `glucoloop.therapy.Profile`, beside how the person rests."""
        return {}

    @classmethod
    def sound(cls, x: jax.Array, lowest_mg_dl: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Whether insulin and glucose of states ``(states, ...)`` are possible, ``(...)`` each.

        The glucose that is controlled has never been below the given one. It is checked at every sample of a campaign;
        by default states have to be finite.
        """
        del lowest_mg_dl
        finite = jnp.all(jnp.isfinite(x), axis=0)
        return finite, finite

    @classmethod
    def parameters_of(cls, values: Mapping[str, Any]) -> Any:
        """Constants as the equations take them: nominal but for some values, numbers or arrays ``(people,)``."""
        return {**cls.nominal, **values}

    @classmethod
    def build(cls, values: Mapping[str, Any], basal_insulin_mU_min: Any, setpoint_mg_dl: Any) -> Self:
        """The person, or the people, of some values, a basal rate and a setpoint, nominal otherwise. JAX traces it."""
        return cls(
            parameters=cls.parameters_of(values),
            basal_insulin_mU_min=jnp.asarray(basal_insulin_mU_min),
            setpoint_mg_dl=jnp.asarray(setpoint_mg_dl),
        )

    @classmethod
    def resting_at(cls, glucose_mg_dl: float, **constants: Any) -> Self:
        """The person, or the people, held at a glucose, with constants in place of the nominal ones.

        Raises
        ------
        ValueError
            For a constant that the patient does not have, or a glucose that no infusion of 0 or more holds.
        """
        for name in constants:
            cls.refuse_unknown(name)
        return cls(**cls.rest.at_setpoint(cls.parameters_of(constants), glucose_mg_dl))

    @classmethod
    def at_operating_point(cls, name: str) -> Self:
        """The nominal person at an operating point."""
        return cls.resting_at(cls.point(name).glucose_mg_dl)

    def derivative(self, t_min: jax.Array, x: jax.Array, inputs: Inputs) -> jax.Array:
        """Rate of change of the state, per minute, at a time of day in minutes after midnight."""
        raise NotImplementedError

    def glucose_mg_dl(self, x: jax.Array) -> jax.Array:
        """Concentration of the glucose that is to be controlled."""
        raise NotImplementedError

    def steady_state(self, insulin_mU_min: jax.Array | float) -> jax.Array:
        """Steady state ``(states, ...)`` under a constant infusion; ValueError if glucose does not rest above 0."""
        return self.rest.state(self.parameters, insulin_mU_min)

    def insulin_for(self, glucose_mg_dl: jax.Array | float) -> jax.Array:
        """Infusion of 0 or more that holds the given glucose; ValueError if none does."""
        return self.rest.insulin(self.parameters, glucose_mg_dl)


class Constant(NamedTuple):
    """One value of a published parameter set."""

    name: str
    """Field of the parameter record; a dot leads into a nested one."""
    value: float
    unit: str
    meaning: str
    source: str
