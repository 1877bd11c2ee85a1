"""A table of named people: the parameters of each, and what is known of each person's profile and meals."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
import numpy.typing as npt

from glucoloop._representation import represented
from glucoloop.meals.scenario import Meal
from glucoloop.patients.variation import Distribution
from glucoloop.refusal import Refusal
from glucoloop.text import is_printable
from glucoloop.threefry import uniforms

PROFILE_COLUMNS: Final = (
    "basal_mU_min",
    "setpoint_mg_dl",
    "carb_ratio_g_U",
    "correction_mg_dl_U",
    "weight_kg",
    "total_daily_dose_U",
)
"""Columns of a table that are the profile of a person, see `glucoloop.therapy.Profile`."""
ONCE: Final = "once"
REPLACED: Final = "with-replacement"
DRAWS: Final = (ONCE, REPLACED)
MAX_ROWS: Final = 100_000
Known = float | None


@represented
@dataclass(frozen=True, kw_only=True)
class PeopleTable:
    """Named people, one a row.

    Parameters
    ----------
    names : tuple of str
        Name of each person.
    values : mapping of str to tuple of float
        Value of each person by parameter, in the parameter's unit; other parameters are nominal.
    profile : mapping of str to tuple of float or None
        Fields of each person's profile, by `PROFILE_COLUMNS`; None where one is not known.
    meals : tuple of tuple of Meal
        Each person's own day, or none.
    draws : {"once", "with-replacement"}
        Whether person i is row i, or a row that is drawn by the seed.

    Raises
    ------
    ValueError
        For a name that is given twice or cannot be printed, a column that does not fit, or a value that is missing or
        not possible.
    """

    names: tuple[str, ...]
    values: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    profile: Mapping[str, tuple[Known, ...]] = field(default_factory=dict)
    meals: tuple[tuple[Meal, ...], ...] = ()
    draws: str = ONCE

    def __post_init__(self) -> None:
        if not 1 <= len(self.names) <= MAX_ROWS:
            raise Refusal(f"a table of {len(self.names)} people is not possible; give 1 to {MAX_ROWS}")
        seen: set[str] = set()
        for name in self.names:
            if not name.strip() or not is_printable(name):
                raise Refusal(f"the name {name!r} of a person cannot be printed in a line; give another one")
            if name in seen:
                raise Refusal(f"two people are called {name!r}; give each a name of its own")
            seen.add(name)
        if self.draws not in DRAWS:
            raise Refusal(f"draw is {self.draws!r}; give {' or '.join(DRAWS)}")
        for column, values in (*self.values.items(), *self.profile.items()):
            if len(values) != len(self.names):
                raise Refusal(f"{column} has {len(values)} values for {len(self.names)} people; give one for each")
        for column, known in self.values.items():
            for name, value in zip(self.names, known, strict=True):
                if not math.isfinite(value):
                    raise Refusal(f"{column} of {name!r} is {value:g}; give a finite value, or leave the column out")
        self._refuse_impossible_profile()
        if self.meals and len(self.meals) != len(self.names):
            raise Refusal(f"there are meals of {len(self.meals)} people for {len(self.names)}; give those of each")

    def _refuse_impossible_profile(self) -> None:
        for column, known in self.profile.items():
            if column not in PROFILE_COLUMNS:
                raise Refusal(
                    f"unknown column {column!r} of a profile; the known ones are: {', '.join(PROFILE_COLUMNS)}"
                )
            for name, value in zip(self.names, known, strict=True):
                if value is not None and not 0.0 < value < math.inf:
                    raise Refusal(f"{column} of {name!r} is {value:g}; give a finite value above 0, or leave it out")

    def row(self, person: str) -> int:
        """Row of a person by name; by number from 0 where no name is a number. Refusal for an unknown one."""
        if person in self.names:
            return self.names.index(person)
        numbered = person.isascii() and person.isdecimal() and not any(name.isdecimal() for name in self.names)
        if numbered and len(person) < len(str(MAX_ROWS)) + 1 and int(person) < len(self.names):
            return int(person)
        from glucoloop.component.setting import known_names

        raise Refusal(f"there is no person {person!r}; {known_names(person, self.names)}")

    def profile_of(self, person: str) -> dict[str, float]:
        """Known fields of a person's profile."""
        row = self.row(person)
        return {name: value for name, known in self.profile.items() if (value := known[row]) is not None}

    def rows(self, seed: int, person: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
        """Rows ``(n,)`` of persons by their numbers; Refusal for a person beyond the last row."""
        n = len(self.names)
        if self.draws == REPLACED:
            return np.minimum(np.floor(n * uniforms(seed, "row", person)).astype(np.int64), n - 1)
        self.refuse_beyond(int(person.max(initial=-1)))
        return person

    def refuse_beyond(self, last: int) -> None:
        """Refuse the number of a person who has no row."""
        n = len(self.names)
        if self.draws == ONCE and last >= n:
            raise Refusal(
                f"person {last} is asked for, but the table has {n} people, from 0 to {n - 1}",
                "ask for fewer",
                f"draw them with replacement, like --population 'NAME, draw={REPLACED}'",
            )

    def distributions(self) -> dict[str, Distribution]:
        """Range of each parameter in the table, about its median."""
        return {
            name: Distribution("table", float(np.median(values)), 0.0, min(values), max(values))
            for name, values in self.values.items()
        }

    def days(self) -> npt.NDArray[np.float64]:
        """Time, carbohydrate and time of eating of each person's meals ``(3, meals, people)``, filled up with 0 g."""
        result = np.zeros((3, max(map(len, self.meals), default=0), len(self.names)))
        for row, meals in enumerate(self.meals):
            result[0, :, row] = meals[-1].t_min if meals else 0.0
            for at, meal in enumerate(meals):
                result[:, at, row] = meal.t_min, meal.carbs_g, meal.eating_min
        return result

    def usual_day(self) -> tuple[Meal, ...]:
        """Meals of the mean time and carbohydrate of those of people, first with first."""
        t_min, carbs_g, _ = self.days()
        eats = carbs_g > 0.0
        return tuple(
            Meal(float(carbs[eat].mean()), float(times[eat].mean()))
            for carbs, times, eat in zip(carbs_g, t_min, eats, strict=True)
            if eat.any()
        )

    def only(self, row: int) -> PeopleTable:
        """The person of a row alone, whoever is drawn."""
        place = slice(row, row + 1)
        return replace(
            self,
            names=self.names[place],
            values={name: values[place] for name, values in self.values.items()},
            profile={name: values[place] for name, values in self.profile.items()},
            meals=self.meals[place],
            draws=REPLACED,
        )
