"""Titration of carbohydrate ratio and correction factor on people themselves, many at once.

Each person starts at steady state under the basal rate, which is held:

- the correction factor is the fall of glucose after a bolus of an hour's basal dose, from the start to the lowest
  glucose within five hours, per U of it;
- the carbohydrate ratio is that of the bolus after which glucose is back where it was five hours after a meal of 50 g,
  for which the bolus is given as it begins. The bolus is found by bisection between 0.25 and 50 U, to 0.01 %.

Both are noise-free, and so kinder than what a person learns from days of readings. A person for whom no bolus in that
range is right, as where glucose is back by itself, has NaN, which means not known. A person's numbers are the same
whoever else is titrated.

References
----------
J. Walsh, R. Roberts, T. Bailey, "Guidelines for optimal bolus calculator settings in adults", J. Diabetes Sci. Technol.
5(1), 2011, 129-135 (a factor is right if it brings glucose to the target when the action of the insulin ends).
"""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Callable
from typing import Any, ClassVar, Final

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from glucoloop._pytree import pytree, static
from glucoloop.control.protocol import Decision, Observation, Status
from glucoloop.meals import Eaten, MealModel
from glucoloop.native.targets import FUSED
from glucoloop.patients import Patient
from glucoloop.patients.component import NOMINAL
from glucoloop.patients.population import VirtualPeople, of_people, population, virtual_people
from glucoloop.pumps import DoseLimits, LimitedPump
from glucoloop.pumps.limits import BolusLimits
from glucoloop.sensors import IdealSensor
from glucoloop.simulation.cohort import Cohort, People
from glucoloop.simulation.plant import SampleGrid
from glucoloop.situations.situation import Situation
from glucoloop.therapy import Profile
from glucoloop.units import MIN_PER_H, MU_PER_U

Floats = npt.NDArray[np.float64]

MEAL_G: Final = 50.0
ACTION_MIN: Final = 300.0
"""Time after which the action of a bolus has ended, as the usual insulin on board has it."""
SAMPLE_TIME_MIN: Final = 5.0
_MIN_U: Final = 0.25
_MAX_U: Final = 50.0
_HALVINGS: Final = 16
_UNLIMITED: Final = 1e9
_STEP_MU: Final = 1e-6
_BLOCK: Final = 512
"""Number of people who are titrated together; the last block is filled up by repetition."""


@pytree
class _OneBolus:
    """Basal rate, and a bolus at the first sample."""

    basal_mU_min: Any
    bolus_mU: Any
    sample_time_min: float = static()
    gives_boluses: ClassVar[bool] = True

    def init(self, observation: Observation) -> jax.Array:
        return jnp.ones_like(observation.glucose_mg_dl)

    def step(self, first: jax.Array, observation: Observation) -> tuple[jax.Array, Decision]:
        of_one = jnp.zeros_like(observation.glucose_mg_dl)
        return of_one, Decision(
            insulin_mU_min=of_one + self.basal_mU_min,
            status=of_one.astype(int) + int(Status.OK),
            bolus_mU=first * self.bolus_mU,
        )


@pytree
class _NoFold:
    """Fold that keeps nothing, since glucose of each sample is returned."""

    def init(self, glucose_mg_dl: jax.Array, insulin_mU_min: jax.Array) -> tuple[()]:
        del glucose_mg_dl, insulin_mU_min
        return ()

    def step(self, state: tuple[()], happened: object, t_min: jax.Array) -> tuple[()]:
        del happened, t_min
        return state


_CACHE: Final[dict[tuple[str, ...], Any]] = {}
_CACHE_SIZE: Final = 64


def _kept(key: tuple[str, ...], make: Callable[[], Any]) -> Any:
    """Object that was made for a key; the last ones are kept, since each case of a trial asks for the same people."""
    result = _CACHE.pop(key) if key in _CACHE else make()
    _CACHE[key] = result
    if len(_CACHE) > _CACHE_SIZE:
        del _CACHE[next(iter(_CACHE))]
    return result


def with_profiles(situation: Situation, people: VirtualPeople, products: str = FUSED) -> VirtualPeople:
    """People with the profiles that the situation asks for: as they are or titrated, and wrong as far as it says."""
    result = people if situation.profile_by == "table" else _titrated(situation, people, products)
    if situation.profile_error is None:
        return result
    known = situation.profile_error.known(result.profile, situation.seed, people.draw.person)
    return dataclasses.replace(result, profile=known)


def _titrated(situation: Situation, people: VirtualPeople, products: str) -> VirtualPeople:
    gut = situation.meal_model
    loop = situation.patient.text, str(situation.seed), "" if gut is None else gut.text, products
    varies = tuple(sorted(people.draw.values))
    numbers = [people.draw.person, people.basal_insulin_mU_min, *people.draw.values.values()]
    digest = hashlib.sha256(b"".join(map(np.ndarray.tobytes, map(np.asarray, numbers)))).hexdigest()

    def titration() -> Titration:
        example = people.at(np.zeros(1, np.intp)).patient
        return Titration(situation.nominal, example, meal_model=situation.gut, products=products)

    def profile() -> Profile:
        result: Titration = _kept((*loop, *varies), titration)
        return result.profile(people)

    return dataclasses.replace(people, profile=_kept((*loop, *varies, digest), profile))


def profile_of(situation: Situation) -> Profile:
    """Profile of the nominal patient, or of the one person of the situation, as controllers have it.

    It is titrated if that is asked for, and wrong as that of person 0 of a trial.
    """
    own = situation.profile if situation.profile_by == "table" else _titrated_alone(situation)
    if situation.profile_error is None:
        return own
    return of_people(situation.profile_error.known(own, situation.seed, np.zeros(1, np.int64)), 0)


def _titrated_alone(situation: Situation) -> Profile:
    who = (
        population(NOMINAL, patient=situation.patient.display_name)
        if situation.one_person is None
        else situation.one_person
    )
    setpoint = float(situation.nominal.setpoint_mg_dl)
    titrated = _titrated(situation, virtual_people(who, 0, [0], setpoint_mg_dl=setpoint), FUSED).profile
    own = {name: of_people(titrated, 0).by_name()[name] for name in ("carb_ratio_g_U", "correction_mg_dl_U")}
    return dataclasses.replace(situation.profile, **own)


class Titration:
    """Titration of people who are like a nominal patient; `example` are some of them, which show what varies."""

    def __init__(
        self,
        nominal: Patient,
        example: Patient,
        *,
        meal_model: MealModel | None = None,
        products: str = FUSED,
    ) -> None:
        samples = round(ACTION_MIN / SAMPLE_TIME_MIN)
        one, zero = np.zeros(()), np.zeros(np.shape(example.basal_insulin_mU_min))
        unlimited = DoseLimits(max_change_mU_min=_UNLIMITED, max_mU_min=_UNLIMITED)
        self._cohort = Cohort(
            nominal,
            example,
            _OneBolus(basal_mU_min=one, bolus_mU=one, sample_time_min=SAMPLE_TIME_MIN),
            IdealSensor(),
            LimitedPump(limits=unlimited, bolus=BolusLimits(max_mU=_UNLIMITED, min_mU=0.0, step_mU=_STEP_MU)),
            SampleGrid(sample_time_min=SAMPLE_TIME_MIN, samples=samples),
            _NoFold(),
            setpoint_mg_dl=float(nominal.setpoint_mg_dl),
            meals=None,
            meal_model=meal_model,
            varied_controller=_OneBolus(basal_mU_min=zero, bolus_mU=zero, sample_time_min=SAMPLE_TIME_MIN),
            products=products,
        )

    def profile(self, people: VirtualPeople) -> Profile:
        """Profile of people ``(n,)`` with the titrated carbohydrate ratio and correction factor."""
        n = people.feasible.size
        ratio, correction = np.empty(n), np.empty(n)
        for start in range(0, n, _BLOCK):
            block = np.arange(start, min(start + _BLOCK, n))
            some = people.at(np.resize(block, _BLOCK))
            ratio[block], correction[block] = (
                result[: block.size] for result in (self._carb_ratio(some), self._correction(some))
            )
        return dataclasses.replace(people.profile, carb_ratio_g_U=ratio, correction_mg_dl_U=correction)

    def _glucose(self, people: VirtualPeople, carbs_g: float, bolus_U: Floats) -> Floats:
        """Glucose ``(samples + 1, people)`` after a meal and a bolus."""
        n, basal = people.feasible.size, people.basal_insulin_mU_min
        keys = jax.vmap(jax.random.key)(jnp.zeros(n, jnp.uint32))
        none = np.zeros((1, n))
        started = People(
            patient=people.patient,
            x=people.rest,
            insulin_mU_min=basal,
            key=keys,
            controller=_OneBolus(
                basal_mU_min=jnp.asarray(basal),
                bolus_mU=MU_PER_U * jnp.asarray(bolus_U),
                sample_time_min=SAMPLE_TIME_MIN,
            ),
            meals=Eaten(t_min=none, carbs_g=none + carbs_g, eating_min=none),
        )
        return np.asarray(self._cohort.run(started).glucose_mg_dl, float)

    def _correction(self, people: VirtualPeople) -> Floats:
        """Fall of glucose per U."""
        bolus_U = MIN_PER_H / MU_PER_U * people.basal_insulin_mU_min
        glucose = self._glucose(people, 0.0, bolus_U)
        fall, given = glucose[0] - np.min(glucose, axis=0), bolus_U > 0.0
        factor = np.where(given, fall / np.where(given, bolus_U, 1.0), np.nan)
        return np.where(factor > 0.0, factor, np.nan)

    def _carb_ratio(self, people: VirtualPeople) -> Floats:
        """Carbohydrate that 1 U covers."""

        def above(bolus_U: Floats) -> npt.NDArray[np.bool_]:
            glucose = self._glucose(people, MEAL_G, bolus_U)
            higher: npt.NDArray[np.bool_] = glucose[-1] > glucose[0]
            return higher

        low, high = np.full(people.feasible.size, _MIN_U), np.full(people.feasible.size, _MAX_U)
        result = people.feasible & above(low) & ~above(high)
        for _ in range(_HALVINGS):
            middle = np.sqrt(low * high)
            too_little = above(middle)
            low, high = np.where(too_little, middle, low), np.where(too_little, high, middle)
        return np.where(result, MEAL_G / np.sqrt(low * high), np.nan)
