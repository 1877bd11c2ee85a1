"""Days of some people: when and how large their meals are, what the controller is told, and habits that change them.

A habit joins every command that has meals by one class, entered in `HABITS` or by the entry point of another package in
the group ``glucoloop.habits``. It takes the days of some people, `LivedDays`, and returns them as they were lived. All
that it draws is a function of the seed, the person, the day and the meal, so that nobody depends on who else is drawn,
and no day on how many follow.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Final, TypeAlias

from glucoloop._lazy_jax import np, npt, scipy
from glucoloop.component.base import Component
from glucoloop.component.catalogue import Catalogue
from glucoloop.component.effects import ANNOUNCEMENTS, Need
from glucoloop.component.setting import About
from glucoloop.meals.protocol import Eaten
from glucoloop.refusal import Refusal
from glucoloop.threefry import uniforms
from glucoloop.unit_guess import MEAL
from glucoloop.units import LARGEST_MEAL_G, MIN_PER_DAY

if TYPE_CHECKING:
    from glucoloop.meals.plan import MealPlan
    from glucoloop.meals.scenario import Meal


Array: TypeAlias = "npt.NDArray[Any]"
DAY: Final = 1 << 16
"""Random numbers of one day; those of a day before the start are counted back from the last ones."""
_ADDED: Final = 1 << 10
"""Number of the first meal of a day that is added to the plan."""
_DAYS_A_WEEK: Final = 7


@dataclass(frozen=True)
class LivedDays:
    """Meals of people ``(meals, people)``, day by day; a meal of 0 g is none. Habits change them."""

    t_min: Array
    """Time at which each meal begins, from the start; before 0 in a warm-up."""
    carbs_g: Array
    eating_min: Array
    announced_g: Array
    """Carbohydrate that the controller is told, 0 for nothing."""
    announced_min: Array
    """Time at which it is told."""
    day: npt.NDArray[np.int64]
    """(meals,) day to which each meal belongs, 0 for the first one."""
    which: npt.NDArray[np.int64]
    """(meals,) number of each meal in its day, from 0."""
    date: npt.NDArray[np.int64]
    """(meals,) number of the 24 h in which each meal is planned; the day, unless a plan is longer than a day."""
    starts_min: Array
    """(days,) times at which the days of the run begin."""
    person: npt.NDArray[np.int64]
    """(people,) numbers of the persons."""
    seed: int
    name: str = ""
    """Name under which is drawn."""

    @property
    def of_plan(self) -> npt.NDArray[np.bool_]:
        """Whether each meal ``(meals,)`` is one of the plan, and none that a habit added."""
        return self.which < _ADDED

    def changed(self, **arrays: Any) -> LivedDays:
        """The days with other arrays."""
        return dataclasses.replace(self, **arrays)

    def named(self, name: str) -> LivedDays:
        """The days under a name for what is drawn."""
        return dataclasses.replace(self, name=name)

    def uniform(self, what: str = "") -> Array:
        """Numbers ``(meals, people)`` between 0 and 1, functions of seed, name, person, day and meal alone."""
        index = np.repeat(self.day % DAY * DAY + self.which, self.person.size)
        people = np.tile(self.person, self.day.size)
        return uniforms(self.seed, f"{self.name} {what}".strip(), people, index).reshape(self.t_min.shape)

    def happens(self, probability: float, meal: int = 0) -> Array:
        """1 where something happens, else 0: to the meal of a number in its day, from 1, or for 0 to any."""
        there = (self.which == meal - 1) if meal else np.ones(self.which.shape, bool)
        drawn = self.uniform() < probability if 0.0 < probability < 1.0 else probability >= 1.0
        return (there[:, None] & drawn & np.ones(self.t_min.shape, bool)).astype(float)

    def on_weekdays(self, first: int, last: int) -> Array:
        """1 on days of the week from one to another, else 0, ``(meals, 1)``; the first day of a run is a Monday, 1."""
        return (((self.date + 1 - first) % _DAYS_A_WEEK) <= ((last - first) % _DAYS_A_WEEK)).astype(float)[:, None]

    def added(self, time_min: float, carbs_g: float) -> LivedDays:
        """A meal on each day, by itself, with numbers of its own; see `with_added`."""
        days = np.round(self.starts_min / MIN_PER_DAY).astype(int)
        number = max(_ADDED, int(self.which.max(initial=0)) + 1)
        t_min = np.repeat((self.starts_min + time_min)[:, None], self.person.size, axis=1)
        size = np.full_like(t_min, carbs_g)
        return self.changed(
            t_min=t_min,
            carbs_g=size,
            eating_min=np.zeros_like(t_min),
            announced_g=size,
            announced_min=t_min,
            day=days,
            date=days,
            which=np.full(days.shape, number),
        )

    def with_added(self, others: LivedDays) -> LivedDays:
        """The days with the meals of others."""
        names = ("t_min", "carbs_g", "eating_min", "announced_g", "announced_min", "day", "which", "date")
        return self.changed(**{name: np.concatenate([getattr(self, name), getattr(others, name)]) for name in names})

    def counted(self, error_pct: float, bias_pct: float) -> LivedDays:
        """The days with carbohydrate as people count it: ``carbs (1 + bias + error z)``, a standard normal z, each.

        It is from 0 to 1000 g.
        """
        z = scipy.special.ndtri(self.named("counted carbohydrate").uniform())
        announced_g = self.announced_g * (1.0 + (bias_pct + error_pct * z) / 100.0)
        return self.changed(announced_g=np.clip(announced_g, 0.0, LARGEST_MEAL_G))

    def announced_before(self, minutes: float) -> LivedDays:
        """The days with announcements that come so many minutes earlier."""
        return self.changed(announced_min=self.announced_min - minutes)

    def since(self, earliest_min: float) -> LivedDays:
        """The days without the meals that begin before a time."""
        begun = self.t_min >= earliest_min
        return self.changed(
            carbs_g=np.where(begun, self.carbs_g, 0.0), announced_g=np.where(begun, self.announced_g, 0.0)
        )

    def first_min(self) -> Array:
        """Time of the first meal of each person from the start on, ``(people,)``; 0 for none."""
        eaten = (self.t_min >= 0.0) & (self.carbs_g > 0.0)
        first = np.min(np.where(eaten, self.t_min, np.inf), axis=0, initial=np.inf)
        return np.where(np.isfinite(first), first, 0.0)

    @property
    def eaten(self) -> Eaten:
        """Meals as they are eaten, ``(meals, people)``."""
        return Eaten(t_min=self.t_min, carbs_g=self.carbs_g, eating_min=self.eating_min)

    def meals_of(self, column: int, end_min: float) -> tuple[Meal, ...]:
        """Meals of one of the people that begin before the end."""
        from glucoloop.meals.scenario import Meal  # and with it JAX, which habits do not need

        columns = (self.carbs_g, self.t_min, self.eating_min, self.announced_g, self.announced_min)
        rows = np.stack([part[:, column] for part in columns], axis=1)
        return tuple(Meal(*row) for row in rows.tolist() if row[0] > 0.0 and row[1] < end_min)


Probability = Annotated[float, About("Probability of this, for each meal that it concerns.", at_least=0.0, at_most=1.0)]
Which = Annotated[
    int, About("Number of the meal of the day that it concerns, from 1 in the order of the plan; 0: all.", at_least=0)
]
_LONGEST_MIN: Final = 360.0


class HabitComponent(Component):
    """Declaration of a habit."""

    kind: ClassVar = "habit"
    of_announcements: ClassVar[bool] = False
    """Whether it concerns announced meals only."""

    def needs(self) -> tuple[Need, ...]:
        """A habit of announcing has an effect where a controller uses announcements."""
        return (ANNOUNCEMENTS,) if self.of_announcements else ()

    def lived(self, days: LivedDays) -> LivedDays:
        """Days of people as they are with this habit."""
        raise NotImplementedError

    def refuse_in(self, plan: MealPlan) -> None:
        """Refuse a plan in which the habit could never show."""


class Skipped(HabitComponent, name="skipped"):
    """Meals that are neither eaten nor announced."""

    probability: Probability = 0.1
    meal: Which = 0

    def lived(self, days: LivedDays) -> LivedDays:
        """Leave meals out."""
        kept = 1.0 - days.happens(self.probability, self.meal)
        return days.changed(carbs_g=kept * days.carbs_g, announced_g=kept * days.announced_g)


class Unannounced(HabitComponent, name="unannounced"):
    """Meals that are eaten and of which the controller is not told: a missed bolus."""

    of_announcements: ClassVar = True
    probability: Probability = 0.1
    meal: Which = 0

    def lived(self, days: LivedDays) -> LivedDays:
        """Announce nothing of some meals."""
        return days.changed(announced_g=(1.0 - days.happens(self.probability, self.meal)) * days.announced_g)


class Varied(HabitComponent, name="varied"):
    """Meals whose size and time differ from day to day: log-normal sizes about their mean, and normal times."""

    size_sd_pct: Annotated[
        float,
        About("Standard deviation of the size, in percent of its mean.", at_least=0.0, at_most=200.0),
    ] = 30.0
    time_sd_min: Annotated[
        float, About("Standard deviation of the time.", at_least=0.0, at_most=_LONGEST_MIN / 2.0)
    ] = 30.0
    meal: Which = 0

    def lived(self, days: LivedDays) -> LivedDays:
        """Vary sizes and times, each by less than three standard deviations."""
        there = days.happens(1.0, self.meal)
        size_z, time_z = (np.clip(scipy.special.ndtri(days.uniform(what)), -3.0, 3.0) for what in ("size", "time"))
        variance = math.log1p((self.size_sd_pct / 100.0) ** 2)
        size = np.exp(there * (math.sqrt(variance) * size_z - variance / 2.0))
        later_min = there * self.time_sd_min * time_z
        return days.changed(
            carbs_g=np.minimum(size * days.carbs_g, LARGEST_MEAL_G),
            announced_g=np.minimum(size * days.announced_g, LARGEST_MEAL_G),
            t_min=days.t_min + later_min,
            announced_min=days.announced_min + later_min,
        )


class Uneaten(HabitComponent, name="uneaten"):
    """Meals of which a part is left after all of it was announced."""

    of_announcements: ClassVar = True
    probability: Probability = 0.05
    share_pct: Annotated[float, About("Share of the meal that is left.", above=0.0, below=100.0)] = 50.0
    meal: Which = 0

    def lived(self, days: LivedDays) -> LivedDays:
        """Leave a part of some meals."""
        left = self.share_pct / 100.0 * days.happens(self.probability, self.meal)
        return days.changed(carbs_g=(1.0 - left) * days.carbs_g)


class AnnouncedLate(HabitComponent, name="announced-late"):
    """Meals that are announced some time after eating begins, or before it."""

    of_announcements: ClassVar = True
    probability: Probability = 1.0
    minutes: Annotated[
        float,
        About(
            "Time by which the announcement comes after the beginning of eating, or after announce_before_min before "
            "it; below 0 it comes before. What it tells of the time of eating does not change.",
            at_least=-_LONGEST_MIN,
            at_most=_LONGEST_MIN,
            unit="min",
        ),
    ] = 20.0
    spread_min: Annotated[
        float, About("Largest deviation from it, drawn for each meal.", at_least=0.0, at_most=_LONGEST_MIN)
    ] = 0.0
    meal: Which = 0

    def lived(self, days: LivedDays) -> LivedDays:
        """Move the announcements of meals."""
        later_min = self.minutes + self.spread_min * (2.0 * days.uniform("spread") - 1.0)
        return days.changed(announced_min=days.announced_min + days.happens(self.probability, self.meal) * later_min)


class Snack(HabitComponent, name="snack"):
    """A snack beside the meals of the plan, of which the controller is usually not told."""

    carbs_g: Annotated[float, About("Carbohydrate of the snack.", above=0.0, at_most=1000.0, quantity=MEAL)] = 20.0
    time_min: Annotated[
        float, About("Time of the day, as minutes after midnight; 21h.", at_least=0.0, below=MIN_PER_DAY)
    ] = 21.0 * 60.0
    probability: Annotated[float, About("Probability of the snack on a day.", at_least=0.0, at_most=1.0)] = 0.5
    size_spread_pct: Annotated[
        float, About("Largest deviation of its size, drawn for each day.", at_least=0.0, below=100.0)
    ] = 0.0
    time_spread_min: Annotated[
        float, About("Largest deviation of its time, drawn for each day.", at_least=0.0, at_most=_LONGEST_MIN)
    ] = 0.0
    announced: Annotated[bool, About("Whether it is announced to the controller: true or false.")] = False

    def refuse_in(self, plan: MealPlan) -> None:
        """Refuse a snack after the end."""
        if self.time_min >= plan.horizon_min:
            raise Refusal(
                f"the snack at {self.time_min:g} min begins after the run ends at {plan.horizon_min:g} min; "
                "let it begin earlier, or lengthen the run"
            )

    def lived(self, days: LivedDays) -> LivedDays:
        """Add the snack of each day."""
        snacks = days.added(self.time_min, self.carbs_g)
        size = 1.0 + self.size_spread_pct / 100.0 * (2.0 * snacks.uniform("size") - 1.0)
        carbs_g = snacks.happens(self.probability) * size * snacks.carbs_g
        t_min = snacks.t_min + self.time_spread_min * (2.0 * snacks.uniform("time") - 1.0)
        announced_g = carbs_g if self.announced else 0.0 * carbs_g
        return days.with_added(
            snacks.changed(carbs_g=carbs_g, t_min=t_min, announced_g=announced_g, announced_min=t_min)
        )


class Weekend(HabitComponent, name="weekend"):
    """Days on which meals have other sizes and come later, as on Saturday and Sunday; day 1 is a Monday."""

    from_day: Annotated[int, About("First of these days in the week.", at_least=1, at_most=7)] = 6
    to_day: Annotated[int, About("Last of these days in the week.", at_least=1, at_most=7)] = 7
    size_pct: Annotated[float, About("Size of the meals, in percent of the plan.", above=0.0, at_most=500.0)] = 125.0
    later_min: Annotated[
        float,
        About("Time by which they come later; below 0 earlier.", at_least=-_LONGEST_MIN, at_most=_LONGEST_MIN),
    ] = 60.0
    meal: Which = 0

    def lived(self, days: LivedDays) -> LivedDays:
        """Change meals on these days of the week."""
        there = days.on_weekdays(self.from_day, self.to_day) * days.happens(1.0, self.meal)
        size, later_min = 1.0 + (self.size_pct / 100.0 - 1.0) * there, self.later_min * there
        return days.changed(
            carbs_g=size * days.carbs_g,
            announced_g=size * days.announced_g,
            t_min=days.t_min + later_min,
            announced_min=days.announced_min + later_min,
        )


HABITS: Final = Catalogue(
    HabitComponent,
    {
        "skipped": "glucoloop.meals.habits:Skipped",
        "unannounced": "glucoloop.meals.habits:Unannounced",
        "varied": "glucoloop.meals.habits:Varied",
        "uneaten": "glucoloop.meals.habits:Uneaten",
        "announced-late": "glucoloop.meals.habits:AnnouncedLate",
        "snack": "glucoloop.meals.habits:Snack",
        "weekend": "glucoloop.meals.habits:Weekend",
    },
    example="unannounced, probability=0.2",
)
