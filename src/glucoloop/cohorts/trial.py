"""Definition of a trial: virtual people, their situation, and the controllers that are tried on each of them."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final, Literal

import numpy as np
import numpy.typing as npt

from glucoloop.experiments.case import Case
from glucoloop.experiments.situation import Situation
from glucoloop.limits import LARGEST_COUNTER, MOST_PEOPLE
from glucoloop.meals.plan import MealPlan
from glucoloop.native.targets.products import FUSED, STRICT
from glucoloop.patients.population import Population
from glucoloop.refusal import Refusal
from glucoloop.units import MIN_PER_DAY

FORMAT: Final = 4
"""Version of the file format of a trial; a folder with another one is not resumed."""
SHARD_PATIENT_DAYS: Final = 16_384
TRACED_PATIENT_DAYS: Final = 2048
"""Number of patient-days in a shard of which all traces are kept."""
SLOW_PATIENT_DAYS: Final = 256
"""Number of patient-days in a shard with a slow controller, of which a processor does some 30 in a second."""
_SHARDS_WANTED: Final = 16
_BLOCK: Final = 1024
_LEAST_SHARD: Final = 2 * _BLOCK
_LEAST_TRACED: Final = 64
"""Least size of a shard with traces or a slow controller: that of a block of the slower engine."""


@dataclass(frozen=True, kw_only=True)
class Trial(Situation):
    """Everything that the results of a trial depend on: a situation, people, meals and controllers.

    Every person starts at rest at the target.

    Person i of a seed is the same, and meets the same meals and noise, under every controller and in every trial of
    the same population, meals and sensor; the division into shards does not change them.

    Raises
    ------
    ValueError
        For numbers of people or a size of shards out of bounds, traces of more people than there are, no case, or a
        label that two cases have.
    """

    population: Population
    people: int
    plan: MealPlan
    """Meals and the length of the run."""
    cases: tuple[Case, ...]
    first_person: int = 0
    precision: Literal["float32", "float64"] = "float64"
    arithmetic: Literal["fused", "portable"] = "fused"
    """Arithmetic of the loop: products and sums rounded together where that is faster, or each operation by itself, so
    that the loop computes the same bits on every processor and in WebAssembly.
    """
    design: Literal["nominal", "individual"] = "nominal"
    """Whether a controller is designed once for the nominal patient, or for each person."""
    traces: Literal["none", "all"] | int = "none"
    """People whose glucose and insulin over time are kept: none, all, or a number of the first ones."""
    shard_people: int = SHARD_PATIENT_DAYS
    given: Mapping[str, Any] | None = field(default=None, compare=False, repr=False)
    """Flat keys from which it was read, if it was; nothing depends on them."""

    def __post_init__(self) -> None:
        if not 1 <= self.people <= MOST_PEOPLE:
            raise Refusal(f"a trial of {self.people} people is not possible; give from 1 to {MOST_PEOPLE}")
        last = LARGEST_COUNTER + 1 - self.people
        if not 0 <= self.first_person <= last:
            raise Refusal(f"the first person is {self.first_person}; with {self.people} people give from 0 to {last}")
        if self.population.patient != self.patient:
            raise Refusal(
                f"the population {self.population.name} is one of {self.population.patient}, but the patient is "
                f"{self.patient}; give a population of {self.patient}"
            )
        if self.shard_people < 1:
            raise Refusal(f"a shard of {self.shard_people} people is not possible; give 1 or more")
        if not isinstance(self.traces, str) and not 1 <= self.traces <= self.people:
            raise Refusal(f"traces of {self.traces} people are not possible; give none, all, or 1 to {self.people}")
        if self.start_min is not None and not float(self.start_min).is_integer():
            raise Refusal(f"a start {self.start_min:g} min after midnight is not possible; give whole minutes")
        labels = [case.label for case in self.cases]
        if not labels:
            raise Refusal("a trial without a controller is not possible; give one or more")
        for label in labels:
            if labels.count(label) > 1:
                raise Refusal(f"two cases are called {label!r}; give each a label of its own")

    @property
    def products(self) -> str:
        """Rounding of products in native code, see `glucoloop.native.targets.products`."""
        return STRICT if self.arithmetic == "portable" else FUSED

    @property
    def samples(self) -> int:
        """Number of decisions of each controller."""
        return round(self.plan.horizon_min / self.sample_time_min)

    @property
    def shards(self) -> int:
        """Number of shards into which the people are divided."""
        return -(-self.people // self.shard_people)

    def shard(self, index: int) -> npt.NDArray[np.int64]:
        """Numbers of the people in a shard."""
        start = index * self.shard_people
        stop = min(start + self.shard_people, self.people)
        return self.first_person + np.arange(start, stop, dtype=np.int64)

    def traced(self, person: npt.NDArray[np.int64]) -> npt.NDArray[np.bool_]:
        """Whether the traces of each person are kept."""
        kept = {"none": 0, "all": self.people}[self.traces] if isinstance(self.traces, str) else self.traces
        return person < self.first_person + kept


def usual_shard_people(people: int, horizon_min: float, *, traced: int = 0, slow: bool = False) -> int:
    """Default size of the shards, a power of two.

    A shard is what is lost when a run is killed, what a worker does at a time, and what is in memory: at most some
    16 000 patient-days, or 2000 of which all is kept, and fewer where there would be less than 16 shards, but no less
    than a few blocks of people. With a slow controller it is some 256 patient-days, so that the first results are kept
    within seconds.
    """
    days = max(1.0, horizon_min / MIN_PER_DAY)
    wanted = min(SHARD_PATIENT_DAYS / days, max(_LEAST_SHARD, people / _SHARDS_WANTED))
    least = _BLOCK
    if traced:
        wanted, least = min(TRACED_PATIENT_DAYS / days, wanted), _LEAST_TRACED
    if slow:
        wanted, least = min(SLOW_PATIENT_DAYS / days, wanted), _LEAST_TRACED
    return max(least, 1 << round(math.log2(max(1.0, wanted))))


def plain(trial: Trial) -> dict[str, Any]:
    """Plain values of everything on which the results depend."""
    values = dataclasses.asdict(trial)
    del values["allow_unusual"], values["given"]  # no result depends on them
    return {**values, "format": FORMAT}


def fingerprint(trial: Trial) -> str:
    """SHA-256 of everything on which the results depend, in hexadecimal."""
    text = json.dumps(plain(trial), sort_keys=True, separators=(",", ":"), allow_nan=False, default=list)
    return hashlib.sha256(text.encode()).hexdigest()
