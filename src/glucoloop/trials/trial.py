"""Definition of a trial: virtual people, their situation, and the controllers that are tried on each of them."""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import json
import math
import typing
from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Final, Literal, Self

from glucoloop.component.effects import INDIVIDUAL
from glucoloop.component.grammar import Tree
from glucoloop.component.request import Request, completed, request_of
from glucoloop.component.setting import CONTROLLER_PANEL, PATIENT_PANEL, PEOPLE_PANEL, WORK_PANEL, Option
from glucoloop.patients.catalogue import patient_entry
from glucoloop.patients.component import PatientComponent
from glucoloop.refusal import Refusal
from glucoloop.situations.case import Case
from glucoloop.situations.run import FedSituation
from glucoloop.situations.scenarios import DEFAULT_DAY
from glucoloop.situations.situation import one_person_of
from glucoloop.unit_guess import DURATION
from glucoloop.units import LARGEST_COUNTER, LONGEST_RUN_MIN, MAX_DAYS, MAX_PEOPLE, MIN_PER_DAY, MIN_PER_WEEK

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    from glucoloop.patients.population import Population
    from glucoloop.simulation.plant import SampleGrid

_TITRATED: Final = ("carb_ratio_g_U", "correction_mg_dl_U")
"""Fields of a profile that a titration gives."""
PORTABLE: Final = "portable"
"""Arithmetic of a loop that every kind of processor rounds alike."""
FORMAT: Final = 5
"""Version of the file format of a trial; a folder with another one is not resumed."""
_SHARD_PATIENT_DAYS: Final = 16_384
_TRACED_PATIENT_DAYS: Final = 2048
"""Number of patient-days in a shard of which all traces are kept."""
LONGEST_COUNTED_MIN: Final = 28 * MIN_PER_DAY
"""Longest run of whole days in which glucose and insulin are counted at every sample."""
_DIGITS: Final = 20
_people = functools.partial(Option, panel=PEOPLE_PANEL)
_meals = functools.partial(Option, panel=PATIENT_PANEL)
_work = functools.partial(Option, panel=WORK_PANEL)
_SHARDS_WANTED: Final = 16
_BLOCK: Final = 1024
MIN_BLOCK: Final = 64
"""Number of people in a block of a long run or with a slow controller: the vectors that native code takes in turn."""
_BLOCK_PATIENT_DAYS: Final = 8192
_MIN_SHARD: Final = 2 * _BLOCK
_MIN_LONG: Final = 4 * MIN_BLOCK
"""Number of people in the minimum shard of a run of more than four weeks, and in one with a slow controller."""
_MAX_SHARDS: Final = 1024
"""Number of shards from which on those of a run of more than four weeks have more people."""


def _traces(value: object) -> Literal["none", "all"] | int:
    if value == "none" or value == "all":
        return value
    digits = isinstance(value, str) and value.isascii() and value.isdecimal() and len(value) < _DIGITS
    number = int(str(value)) if digits else value
    if isinstance(number, int) and not isinstance(number, bool) and number >= 1:
        return number
    raise Refusal("give none, all, or the number of people whose traces are kept")


class Trial(FedSituation):
    """Everything that the results of a trial depend on: a situation, people, meals and controllers.

    Every person starts at steady state at the target.

    Person i of a seed is the same, and meets the same meals and noise, under every controller and in every trial of
    the same population, meals and sensor; the division into shards does not change them.
    """

    kind: ClassVar = "trial"
    few_cases: ClassVar = False

    people: Annotated[int, _people("Number of people.", at_least=1, at_most=MAX_PEOPLE)] = 1000
    population: Annotated[
        Any,
        _people(
            "Population, see `glucoloop list` with the patient's name; or a table of your own in a file.",
            metavar="NAME|FILE",
            default="the first of the patient's",
        ),
    ] = None
    first_person: Annotated[
        int,
        _people(
            "Number of the first person; a person of a given number and seed is always the same.",
            at_least=0,
            at_most=LARGEST_COUNTER,
            rare=True,
        ),
    ] = 0
    days: Annotated[
        int | None, _meals("Days, each with the same meals.", default="1", at_least=1, at_most=MAX_DAYS)
    ] = None
    duration_min: Annotated[
        float | None,
        _meals("Length of the run, in place of days.", above=0.0, at_most=LONGEST_RUN_MIN, quantity=DURATION),
    ] = None
    meals: Annotated[
        tuple[str, ...],
        _meals(
            "Carbohydrate and time of day, like 45g@7h; repeat it for more; none for no meal, own for each "
            "person's own day.",
            flag="--meal",
            metavar="G@TIME",
        ),
    ] = DEFAULT_DAY
    design: Annotated[
        Literal["nominal", "individual"],
        Option(
            "Whether controllers are designed once for the nominal patient, or for each person.",
            panel=CONTROLLER_PANEL,
            needs=(INDIVIDUAL,),
        ),
    ] = "nominal"
    traces: Annotated[
        Any,
        _work(
            "People whose glucose and insulin over time are kept: none, all, or a number of the first people.",
            metavar="none|all|N",
            reads=_traces,
        ),
    ] = "none"
    precision: Annotated[
        Literal["float32", "float64"],
        _work("Arithmetic of the loop; controllers are always designed in float64.", rare=True),
    ] = "float64"
    arithmetic: Annotated[
        Literal["fused", "portable"],
        _work(
            "Whether the loop may round a product together with its sum, which is faster, or rounds every operation by "
            "itself, so that any processor and a web page compute the same bits.",
            rare=True,
        ),
    ] = "fused"
    shard_people: Annotated[
        int | None,
        _work(
            "Number of people that are computed and written together.",
            default="up to 16384",
            at_least=1,
            at_most=1_000_000,
            rare=True,
        ),
    ] = None

    @classmethod
    def defaults_of(cls, request: Request[Self], defaults: Mapping[str, Any]) -> Mapping[str, Any]:
        """Defaults, where all people of a table take part who are in it."""
        patient = request_of(request.value("patient"))
        if patient.explicit.get("person") is not None and "population" not in request.explicit:
            defaults = {**defaults, "population": None}
        elif "people" not in request.explicit:
            population = _population_for(completed(patient), request.value("population"), request.value("seed"))
            if population.most_people is not None:
                number = defaults.get("people", cls.settings()["people"].default.noise_free)
                left = population.most_people - request.value("first_person")
                defaults = {**defaults, "people": max(1, min(number, left))}
        return super().defaults_of(request, defaults)

    @classmethod
    def resolved(cls, values: Mapping[str, Any]) -> dict[str, Any]:
        """The settings with the population itself."""
        result = super().resolved(values)
        return {**result, "population": _population_for(result["patient"], result["population"], result["seed"])}

    def __post_init__(self) -> None:
        super().__post_init__()
        last = LARGEST_COUNTER + 1 - self.people
        if self.first_person > last:
            raise Refusal(f"the first person is {self.first_person}; with {self.people} people give from 0 to {last}")
        if self.population.patient != self.patient.display_name:
            raise Refusal(
                f"the population {self.population.name} is one of {self.population.patient}, but the patient is "
                f"{self.patient.display_name}; give a population of {self.patient.display_name}"
            )
        self.population.refuse_beyond(self.first_person + self.people - 1)
        if not isinstance(self.traces, str) and self.traces > self.people:
            raise Refusal(f"traces of {self.traces} people are not possible; give none, all, or 1 to {self.people}")
        if self.start_min is not None and not float(self.start_min).is_integer():
            raise Refusal(f"a start {self.start_min:g} min after midnight is not possible; give whole minutes")
        _ = self.plan, self.bouts  # which refuse what is not possible

    def tree(self, *, whole: bool = False) -> Tree:
        """Explicit settings as plain values, with the table of a population from a file."""
        from glucoloop.patients.population import Population, is_preset
        from glucoloop.situations.population import population_keys

        result = super().tree(whole=whole)
        if "population" in result and isinstance(self.population, Population):
            preset = is_preset(self.population)
            result["population"] = self.population.name if preset else population_keys(self.population)
        if whole and "shard_people" in result:
            result["shard_people"] = self.people_a_shard
        if whole and self.days is None and self.duration_min is None:
            result["days"] = 1
        return result

    def with_cases(self, cases: tuple[Case | Request[Case], ...], **other: Any) -> Trial:
        """A trial of other cases, which have guards and models of their own, in the same situation."""
        changes = {"shard_people": self.people_a_shard, "controller": cases, "guard": None, "model": None, **other}
        return Trial.narrowed(self, **changes)

    @property
    def planned_meals(self) -> tuple[str, ...]:
        """Texts of the meals of the plan, of the default ones those within a run that is shorter than a day."""
        from glucoloop.situations.meal_text import parse_meal, same_meals

        if self.duration_min is None or self.meals != same_meals(DEFAULT_DAY):
            return self.meals
        return tuple(text for text in self.meals if parse_meal(text).t_min < self.duration_min)

    def population_with_days(self) -> Population:
        """The people, each of whom has a day of meals; Refusal where they have none."""
        table = self.population.table
        if table is None or not table.meals:
            raise Refusal(
                f"the people of {self.population.name} have no days of their own",
                "give meals, like --meal 45g@7h",
            )
        return typing.cast("Population", self.population)

    @property
    def products(self) -> str:
        """Rounding of products in native code, see `glucoloop.native.targets`."""
        from glucoloop.native.targets import FUSED, STRICT

        return STRICT if self.arithmetic == PORTABLE else FUSED

    @property
    def grid(self) -> SampleGrid:
        """Samples of the run."""
        from glucoloop.simulation.closed_loop import sample_grid

        return sample_grid(self.plan.horizon_min, self.sample_time_min, warm_up_min=self.warm_up_min)

    @property
    def samples(self) -> int:
        """Number of decisions of each controller."""
        return round(self.plan.horizon_min / self.sample_time_min)

    @property
    def one_day_of_counts(self) -> bool:
        """Whether glucose and insulin are counted by the time of day, all days together, as in a long run."""
        day = MIN_PER_DAY / self.sample_time_min
        return self.horizon_min > LONGEST_COUNTED_MIN and self.horizon_min % MIN_PER_DAY == 0.0 == day % 1.0

    @property
    def counted_samples(self) -> int:
        """Number of samples at which glucose and insulin are counted: all, or those of one day."""
        return round(MIN_PER_DAY / self.sample_time_min) if self.one_day_of_counts else self.samples

    @property
    def samples_a_week(self) -> int:
        """Number of samples of a week."""
        return round(MIN_PER_WEEK / self.sample_time_min)

    @property
    def counted_weeks(self) -> int:
        """Number of weeks by which glucose is counted too in a long run, the last of which may be cut short."""
        return -(-self.samples // self.samples_a_week) if self.one_day_of_counts else 0

    @property
    def people_a_block(self) -> int:
        """Largest number of people who are simulated together; fewer where they live long, or decisions take long.

        So memory does not grow with the days, cores share the work of a shard, and few people do not take the time of
        many. A person's results do not depend on it.
        """
        if any(case.controller.slow for case in self.cases):
            return MIN_BLOCK
        most = _BLOCK_PATIENT_DAYS * MIN_PER_DAY / max(MIN_PER_DAY, self.horizon_min + self.warm_up_min)
        return min(_BLOCK, max(MIN_BLOCK, 1 << int(math.log2(most))))

    @property
    def people_a_shard(self) -> int:
        """Number of people that are computed and written together."""
        if self.shard_people is not None:
            return self.shard_people
        slow = any(case.controller.slow for case in self.cases)
        traced = self.people if self.traces == "all" else 0
        return default_shard_people(self.people, self.horizon_min, traced=traced, slow=slow)

    @property
    def shards(self) -> int:
        """Number of shards into which the people are divided."""
        return -(-self.people // self.people_a_shard)

    def shard(self, index: int) -> npt.NDArray[np.int64]:
        """Numbers of the people in a shard."""
        import numpy as np

        start = index * self.people_a_shard
        stop = min(start + self.people_a_shard, self.people)
        return self.first_person + np.arange(start, stop, dtype=np.int64)

    def traced(self, person: npt.NDArray[np.int64]) -> npt.NDArray[np.bool_]:
        """Whether the traces of each person are kept."""
        traced = {"none": 0, "all": self.people}[self.traces] if isinstance(self.traces, str) else self.traces
        return person < self.first_person + traced


def default_shard_people(people: int, horizon_min: float, *, traced: int = 0, slow: bool = False) -> int:
    """Default size of the shards, a power of two.

    A shard is what is lost when a run is killed, and what a worker does at a time: at most some 16 000 patient-days, or
    2000 of which all is kept, and fewer where there would be less than 16 shards, but no less than a few blocks of
    people. In a run of more than four weeks that is 256 people, or more where there would be more than a thousand
    shards. With a slow controller it is 256 people, so that the first results are kept within seconds.
    """
    days = max(1.0, horizon_min / MIN_PER_DAY)
    wanted, least = min(_SHARD_PATIENT_DAYS / days, max(_MIN_SHARD, people / _SHARDS_WANTED)), _BLOCK
    if horizon_min > LONGEST_COUNTED_MIN:
        wanted, least = max(wanted, min(people / _MAX_SHARDS, _BLOCK)), _MIN_LONG
    if traced:
        wanted, least = min(_TRACED_PATIENT_DAYS / days, wanted), MIN_BLOCK
    if slow:
        wanted, least = min(_MIN_LONG, wanted), min(_MIN_LONG, least)
    return max(least, 1 << round(math.log2(max(1.0, wanted))))


def _population_for(patient: PatientComponent, population: object, seed: int) -> Population:
    """Population of a trial: that of the one person of its patient, the one that is given, or the default one."""
    from glucoloop.patients.population import Population

    if patient.person is None or isinstance(population, Population):
        return population_of(population, patient.display_name)
    if population is not None:
        raise Refusal(
            f"the patient is one person, {patient.person!r}, and a population is given too; leave one out, or name "
            "the person of that population, like person=people.csv:anna"
        )
    return typing.cast(Population, one_person_of(patient, seed))


def population_of(population: object, patient: str) -> Population:
    """Population of a patient: the default one, one by its name or from a file, or a table."""
    from glucoloop.patients.population import Population, population_names
    from glucoloop.situations.population import named_population, read_population

    if isinstance(population, Population):
        return population
    if population is None:
        return named_population(patient_entry(patient).default_population, patient)
    if isinstance(population, Mapping):
        return read_population(population, patient)
    if isinstance(population, str):
        return named_population(population, patient)
    raise Refusal(
        f"population is {population!r}; give {', '.join(population_names(patient))}, or a file like people.toml"
    )


def profile_columns(trial: Trial) -> tuple[str, ...]:
    """Fields of people's profiles that a trial tells: those of its table of people, and those that are titrated."""
    table = trial.population.table
    known = () if table is None else tuple(table.profile)
    return tuple(dict.fromkeys((*known, *(_TITRATED if trial.profile_by == "titration" else ()))))


def plain(trial: Trial) -> dict[str, Any]:
    """Plain values of everything on which the results depend."""
    values = trial.tree(whole=True)
    del values["allow_unusual"]  # no result depends on it
    return {**values, "population": dataclasses.asdict(trial.population), "format": FORMAT}


def fingerprint(trial: Trial) -> str:
    """SHA-256 of everything on which the results depend, in hexadecimal."""
    text = json.dumps(plain(trial), sort_keys=True, separators=(",", ":"), default=repr)
    return hashlib.sha256(text.encode()).hexdigest()
