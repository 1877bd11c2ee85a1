"""Patient with an unexplained appearance of glucose, followed by an extended Kalman filter of constant gain.

The state of a patient is extended by what nobody entered, as an appearance `u` of glucose beside that of meals::

    x' = f(t, x, insulin, meal + u)
    u = b_0 + sum b_k wave_k(time of day) + a_2 + d + w_2 - r (glucose - mean reading)
    a_1' = -a_1 / tau_A + w_1,  a_2' = (a_1 - a_2) / tau_A         unexplained appearance, as through a gut
    d' = -d / tau_D + w_3                                          slow drift
    reading = glucose(x) + v

with the patient's own equations in Runge-Kutta steps, and `w` constant over a sample of 5 min. The filter corrects the
state at each reading by a constant gain, that of the stationary filter of the equations linearised at a steady state;
the mean goes through the equations themselves. A missing reading corrects nothing.

Disturbances are in units of glucose, so that one prior serves every patient: the noises by the largest response of the
linearised equations to a sample of them, the drift and the waves by the response to a constant one over 12 h.

References
----------
M. G. Safonov, M. Athans, "Robustness and computational aspects of nonlinear stochastic estimators and regulators", IEEE
Trans. Autom. Control 23(4), 1978: the filter of constant gain.
E. K.-W. Chu, H.-Y. Fan, W.-W. Lin, C.-S. Wang, "Structure-preserving algorithms for periodic discrete-time algebraic
Riccati equations", Int. J. Control 77(8), 2004: the doubling.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from glucoloop.forecasts.grid import HARMONICS, SAMPLE_MIN, SAMPLES_PER_DAY, GriddedRecord, daily_waves, harmonics_sd
from glucoloop.meals import Eaten, absorb, meal_model_of
from glucoloop.patients.capabilities import rest_at, seen_mg_dl, sites
from glucoloop.patients.catalogue import patient_entry
from glucoloop.patients.population import Population, virtual_people
from glucoloop.refusal import Refusal
from glucoloop.simulation.explicit import ExplicitPlant, fastest_rate_per_min
from glucoloop.twins.prior import Prior
from glucoloop.units import MU_PER_U

Values = npt.NDArray[np.float64]

_INTERSTITIAL: Final = "interstitial"
_SAMPLED_PEOPLE: Final = 64
_MAX_STEP: Final = 0.8
"""Largest product of a step and the fastest rate."""
_MARGIN: Final = 1.5
_RESPONSE: Final = 144
"""Samples, 12 h, over which responses of the linearised equations are looked at."""
_DOUBLINGS: Final = 13
"""Doublings of the Riccati equation, which stand for 8192 samples."""
_WORKING_MG_DL: Final = (90.0, 150.0)
"""Range of glucose at which the equations are linearised."""
_LEVEL_SD_MG_DL: Final = 25.0
WAVES: Final = 1 + 2 * HARMONICS
EXTRA_STATES: Final = 3
"""States ``a_1, a_2, d`` beside those of the patient."""
_DAYS_TOGETHER: Final = 7
"""Days are filled up to whole weeks without readings."""
_MEALS_TOGETHER: Final = 256
"""Meals are filled up with meals of 0 g to a multiple of this, so that few programs are compiled."""


class _Median(NamedTuple):
    """Median of a parameter and standard deviation of its logarithm."""

    median: float
    log_sd: float


NOISES: Final = {
    "return_min": _Median(200.0, 1.0),
    "appearance_min": _Median(8.5, 0.5),
    "glucose_noise": _Median(0.06, 1.0),
    "drift_sd": _Median(1.0, 1.0),
    "drift_min": _Median(850.0, 0.7),
    "reading_sd": _Median(0.13, 1.0),
}
"""Time constants of `r`, ``tau_A`` and ``tau_D`` [min], and standard deviations of `w_2`, of the drift and of `v`, in
units of that of `w_1`: but for the first, the medians of the linear filter of `forecasts.kalman`, with wider
spreads."""


class Days(NamedTuple):
    """Inputs of the samples of a record, and its readings."""

    insulin_mU_min: Any
    """``(samples,)`` rates of all insulin."""
    meal_min: Any
    carbs_g: Any
    """``(meals,)`` times and carbohydrate of meals; those of 0 g are none."""
    reading_mg_dl: Any
    """``(samples,)``, NaN where there is none."""
    waves: Any
    """``(samples, 9)`` a constant and the harmonics of the time of day."""
    mean_mg_dl: Any
    """Mean of the readings."""
    working_mg_dl: Any
    """Glucose at which the equations are linearised, and at which the record begins."""


def days_of_record(record: GriddedRecord, mean_mg_dl: float) -> Days:
    """Inputs of a record, with the mean of the readings of training; a meal is eaten in the middle of its sample."""
    record = record.padded(-record.days % _DAYS_TOGETHER * SAMPLES_PER_DAY)
    carbs = record.carbs_g
    at = np.flatnonzero(carbs)
    empty = -at.size % _MEALS_TOGETHER
    readings = record.reading_mg_dl
    return Days(
        insulin_mU_min=MU_PER_U / SAMPLE_MIN * record.insulin_U,
        meal_min=np.append(SAMPLE_MIN * (at + 0.5), np.zeros(empty)),
        carbs_g=np.append(carbs[at], np.zeros(empty)),
        reading_mg_dl=readings,
        waves=daily_waves(record.clock),
        mean_mg_dl=mean_mg_dl,
        working_mg_dl=working_mg_dl(mean_mg_dl),
    )


def working_mg_dl(mean_mg_dl: float) -> float:
    """Glucose at which the equations are linearised, for a mean reading."""
    return float(np.clip(mean_mg_dl, *_WORKING_MG_DL))


class SampleInputs(NamedTuple):
    """Inputs of samples ``(samples, ..., origins)`` in which there are no further readings."""

    insulin_mU_min: Any
    moments: Any
    """Moments ``(samples, steps, 3, origins)`` of the meals."""
    appearance_mg_min: Any
    """Appearance beside the meals: the waves, and what is otherwise known."""
    clock_min: Any


class ProgramKey(NamedTuple):
    """Structure that a program of a patient is compiled for."""

    population: str
    patient: str
    parameters: tuple[str, ...]
    known: tuple[str, ...]
    steps: int
    site: str


class Numbers(NamedTuple):
    """Mean and factor of a prior, and the parameters that are known."""

    mean: Any
    factor: Any
    known: tuple[float, ...]


class Linearised(NamedTuple):
    """The extended equations over a sample, linearised at a steady state."""

    state: Any
    """Extended state ``(states, 1)`` about which they are."""
    transition: Any
    """``(states, states)`` transition of a sample."""
    disturbance: Any
    """``(states, 3)`` effect of ``w_1, w_2, w_3``, each in the unit of the noise."""
    readout: Any
    """``(states,)`` row by which a reading follows."""
    noise: Any
    """``(states, states)`` covariance of the noise of a sample, and the variance of a reading, in units of `w_1`."""
    reading_variance: Any
    predicted: Any
    """``(states, states)`` stationary covariance before a reading."""
    gain: Any
    """``(states,)`` gain of the filter."""
    unit_mg_min: Any
    """``(3,)`` unit of each disturbance: `w` of 1 is so much [mg/min]."""
    level_mg_min: Any
    """``(9,)`` coefficients `b` of the waves [mg/min]."""
    return_mg_min: Any
    """Appearance less by each mg/dl of glucose above the mean reading [mg/min]: `r`."""
    fall_mg_dl_U: Any
    """Largest fall of glucose by 1 U, without `r`."""
    returned_fall_mg_dl_U: Any
    """The same with `r`."""


@dataclass(frozen=True)
class ExtendedPatient:
    """People of a prior with what is unexplained; a person is a vector of coordinates ``(coordinates,)``.

    The coordinates are those of the prior, those of the waves, and those of the noises; each is standard normal before
    the record.
    """

    prior: Prior
    steps: int
    """Runge-Kutta steps of a sample."""
    site: str
    """Site of the sensor."""

    @classmethod
    def of(cls, population: Population, prior: Prior) -> ExtendedPatient:
        """The patient with steps that suit the people of a population, some of whom are looked at."""
        some = population if population.table is None else population.drawn_as("with-replacement")
        people = virtual_people(some, 0, np.arange(_SAMPLED_PEOPLE))
        people = people.at(np.flatnonzero(people.feasible))
        if not people.feasible.size:
            raise Refusal(
                f"nobody of {population.name} can rest at the setpoint of {population.patient}; choose another one"
            )
        where = sites(people.patient)
        return cls(
            prior=prior,
            steps=max(2, math.ceil(_MARGIN * fastest_rate_per_min(people.patient) * SAMPLE_MIN / _MAX_STEP)),
            site=_INTERSTITIAL if _INTERSTITIAL in where else where[0],
        )

    @classmethod
    def traced(cls, fixed: ProgramKey, numbers: Numbers) -> ExtendedPatient:
        """The patient of a program, whose numbers are arguments so that another person needs no other program."""
        values = dict(zip(fixed.known, numbers.known, strict=True))
        prior = Prior(fixed.population, fixed.patient, fixed.parameters, numbers.mean, numbers.factor, values)
        return cls(prior, fixed.steps, fixed.site)

    @property
    def sensitive(self) -> npt.NDArray[np.bool_]:
        """Marks of the parameters that the patient declares as its sensitivity to insulin."""
        declared = getattr(patient_entry(self.prior.patient), "insulin_sensitivity", ())
        return np.array([name in declared for name in self.prior.parameters])

    def with_sensitivity(self, factor: float) -> ExtendedPatient:
        """The patient whose people are as many times as sensitive to insulin; the same where no parameter says so."""
        mean = self.prior.mean + math.log(factor) * self.sensitive
        return dataclasses.replace(self, prior=dataclasses.replace(self.prior, mean=mean))

    @property
    def fixed(self) -> ProgramKey:
        """Structure that a program is compiled for."""
        prior = self.prior
        return ProgramKey(prior.population, prior.patient, prior.parameters, tuple(prior.known), self.steps, self.site)

    @property
    def numbers(self) -> Numbers:
        """Arguments of a program."""
        return Numbers(self.prior.mean, self.prior.factor, tuple(map(float, self.prior.known.values())))

    @property
    def coordinates(self) -> int:
        """Number of coordinates of a person."""
        return len(self.prior.parameters) + WAVES + len(NOISES)

    def noises(self, p: Any) -> dict[str, Any]:
        """Time constants and noises by name."""
        own = p[-len(NOISES) :]
        return {name: of.median * jnp.exp(of.log_sd * own[k]) for k, (name, of) in enumerate(NOISES.items())}

    def values(self, p: Any) -> dict[str, Any]:
        """Value ``(1,)`` of each parameter, the known ones too."""
        return self.prior.values(jnp.asarray(p)[: len(self.prior.parameters), None])

    def person(self, p: jax.Array) -> Any:
        """The patient of coordinates, with one person on the trailing axis."""
        unknown = jnp.full(1, jnp.nan)
        return patient_entry(self.prior.patient).build(self.values(p), unknown, unknown)

    def fall_mg_dl_U(self, p: Values, working_mg_dl: float, *, returned: bool = False) -> float:
        """Largest fall of glucose by 1 U, without or with `r`; NaN for a person whom no rate holds at the glucose."""
        return float(_fall_program(self.fixed)(p, self.numbers, working_mg_dl)[int(returned)])

    def with_return(self, p: Values, return_min: float) -> Values:
        """Coordinates of a person with another time constant of `r`."""
        of, result = NOISES["return_min"], p.copy()
        result[-len(NOISES) + list(NOISES).index("return_min")] = math.log(return_min / of.median) / of.log_sd
        return result

    def moments(self, person: Any, days: Days) -> jax.Array:
        """Moments ``(samples, steps, 3, 1)`` of the appearance of the meals."""
        eaten = Eaten(
            t_min=jnp.asarray(days.meal_min)[:, None],
            carbs_g=jnp.asarray(days.carbs_g)[:, None],
            eating_min=jnp.zeros((len(days.meal_min), 1)),
        )
        return absorb(meal_model_of(person), eaten).moments(
            len(days.insulin_mU_min), self.steps, SAMPLE_MIN / self.steps
        )

    def step(
        self,
        person: Any,
        noises: dict[str, Any],
        state: jax.Array,
        insulin_mU_min: Any,
        moments: jax.Array,
        appearance_mg_min: Any,
        clock_min: Any,
        w: Any = (0.0, 0.0, 0.0),
    ) -> jax.Array:
        """Extended state ``(states, people)`` after a sample; `w` are the disturbances at its beginning [mg/min]."""
        followed, later = self._followed(noises, state, w)
        x, u = state[:-EXTRA_STATES], appearance_mg_min + followed
        plant = ExplicitPlant(patient=person, clock_min=0.0, step_min=SAMPLE_MIN / self.steps, steps_per_point=1)
        insulin = jnp.broadcast_to(insulin_mU_min, x.shape[1:])
        meals = jnp.broadcast_to(moments, (self.steps, 3, *x.shape[1:])).at[:, 0].add(u)

        def one(x: jax.Array, entry: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, None]:
            after_min, of_step = entry
            return plant.step(x, clock_min + after_min, insulin, of_step), None

        x, _ = jax.lax.scan(one, x, (plant.step_min * jnp.arange(self.steps), meals))
        return jnp.concatenate([x, later])

    def _followed(self, noises: dict[str, Any], state: jax.Array, w: Any) -> tuple[jax.Array, jax.Array]:
        """Mean of the appearance ``a_2 + d + w_2`` over a sample, and the states ``a_1, a_2, d`` after it."""
        a_1, a_2, d = state[-EXTRA_STATES:]
        ratio = SAMPLE_MIN / noises["appearance_min"]
        fast, slow = jnp.exp(-ratio), jnp.exp(-SAMPLE_MIN / noises["drift_min"])
        a_1, d = a_1 + w[0], d + w[2]
        later = jnp.stack([fast * a_1, fast * (a_2 + ratio * a_1), slow * d])
        return 0.5 * (a_2 + d + later[1] + later[2]) + w[1], later

    def glucose_mg_dl(self, person: Any, state: jax.Array) -> jax.Array:
        """Glucose at the sensor."""
        return seen_mg_dl(person, state[:-EXTRA_STATES], self.site)

    def linearised(self, person: Any, p: jax.Array, working_mg_dl: Any) -> Linearised:
        """Equations of a sample about the steady state at a glucose, with the gain of the stationary filter."""
        noises = self.noises(p)
        rate, x = rest_at(person, jnp.broadcast_to(working_mg_dl, (1,)))
        state = jnp.concatenate([x, jnp.zeros((EXTRA_STATES, 1))])
        no_meal = jnp.zeros((self.steps, 3, 1))

        def after(state: jax.Array, insulin: jax.Array, w: jax.Array) -> jax.Array:
            return self.step(person, noises, state[:, None], insulin, no_meal, 0.0, 0.0, w[:, None])[:, 0]

        def seen(state: jax.Array) -> jax.Array:
            return self.glucose_mg_dl(person, state[:, None])[0]

        A, B, G = jax.jacfwd(after, (0, 1, 2))(state[:, 0], rate, jnp.zeros(3))
        c = jax.jacfwd(seen)(state[:, 0])

        def responses(A: jax.Array) -> jax.Array:
            _, rows = jax.lax.scan(lambda row, _: (row @ A, row), c, None, length=_RESPONSE)
            return jnp.asarray(rows)

        rows = responses(A)
        of_w = rows @ G
        largest, whole = jnp.max(of_w, axis=0), jnp.sum(of_w, axis=0)
        returning = SAMPLE_MIN / (noises["return_min"] * largest[1])
        A = A - returning * jnp.outer(G[:, 1], c)
        slow = jnp.exp(-SAMPLE_MIN / noises["drift_min"])
        unit = jnp.stack(
            [
                1.0 / largest[0],
                noises["glucose_noise"] / largest[1],
                noises["drift_sd"] * jnp.sqrt(1.0 - slow**2) / whole[1],
            ]
        )
        G = G * unit
        noise = G @ G.T
        variance = noises["reading_sd"] ** 2
        predicted = _stationary(A, c, noise, variance)
        gain = predicted @ c / (c @ predicted @ c + variance)
        b = (
            p[len(self.prior.parameters) : len(self.prior.parameters) + WAVES]
            * jnp.asarray(np.append(_LEVEL_SD_MG_DL, harmonics_sd()))
            / whole[1]
        )
        fall, returned = (-jnp.min(of @ B[:, 0]) * MU_PER_U / SAMPLE_MIN for of in (rows, responses(A)))
        return Linearised(state, A, G, c, noise, variance, predicted, gain, unit, b, returning, fall, returned)

    def disturbed(
        self,
        person: Any,
        p: jax.Array,
        linear: Linearised,
        days: Days,
        moments: jax.Array,
        w_mg_min: jax.Array,
        feedback_mg_min: Any,
    ) -> tuple[jax.Array, jax.Array, jax.Array, jax.Array]:
        """Unexplained appearance, glucose at the sensor and the controlled one after each sample, ``(samples,)`` each.

        They follow from the disturbances ``(samples, 3)``, the last of what is handed back, without the filter. A
        feedback adds so much to `w_2` for each mg/dl by which the last reading was above the glucose.
        """
        noises = self.noises(p)
        inputs = (
            days.insulin_mU_min,
            moments,
            days.waves @ linear.level_mg_min,
            w_mg_min,
            days.reading_mg_dl,
            _clock(days),
        )

        def sample(carry: tuple[jax.Array, jax.Array], entry: Any) -> tuple[tuple[jax.Array, jax.Array], Any]:
            (state, missed), (insulin, of_sample, appearance, w, reading, clock) = carry, entry
            w = w.at[1].add(feedback_mg_min * missed)
            appearance = appearance + linear.return_mg_min * (days.mean_mg_dl - self.glucose_mg_dl(person, state))
            unexplained = appearance + self._followed(noises, state, w)[0]
            state = self.step(person, noises, state, insulin, of_sample, appearance, clock, w)
            seen, glucose = self.glucose_mg_dl(person, state)[0], person.glucose_mg_dl(state[:-EXTRA_STATES])[0]
            missed = jnp.where(jnp.isfinite(reading), reading - seen, 0.0)
            return (state, missed), (unexplained[0], seen, glucose, w)

        start = (linear.state, jnp.zeros(()))
        result: tuple[jax.Array, jax.Array, jax.Array, jax.Array]
        _, result = jax.lax.scan(sample, start, jax.tree.map(jnp.asarray, inputs))
        return result

    def under_doses(
        self,
        person: Any,
        p: jax.Array,
        start: jax.Array,
        days: Days,
        moments: jax.Array,
        appearance_mg_min: jax.Array,
        return_mg_min: Any,
    ) -> jax.Array:
        """Controlled glucose ``(samples,)`` after each sample, from a state ``(states,)``.

        The appearance of each sample is known but for the part of the glucose at its beginning, which it is less by.
        """
        noises = self.noises(p)

        def sample(state: jax.Array, entry: Any) -> tuple[jax.Array, jax.Array]:
            insulin, of_sample, appearance, clock = entry
            appearance = appearance - return_mg_min * person.glucose_mg_dl(state[:-EXTRA_STATES])
            state = self.step(person, noises, state, insulin, of_sample, appearance, clock)
            return state, person.glucose_mg_dl(state[:-EXTRA_STATES])[0]

        begun = jnp.concatenate([start, jnp.zeros(EXTRA_STATES)])[:, None]
        inputs = (days.insulin_mU_min, moments, appearance_mg_min, _clock(days))
        return jax.lax.scan(sample, begun, jax.tree.map(jnp.asarray, inputs))[1]

    def filtered(self, person: Any, p: jax.Array, linear: Linearised, days: Days, moments: jax.Array) -> jax.Array:
        """Extended states ``(samples, states)`` after each reading."""
        noises = self.noises(p)
        inputs = (days.insulin_mU_min, moments, days.waves @ linear.level_mg_min, days.reading_mg_dl, _clock(days))

        def sample(state: jax.Array, entry: Any) -> tuple[jax.Array, jax.Array]:
            insulin, of_sample, appearance, reading, clock = entry
            returning = linear.return_mg_min * (days.mean_mg_dl - self.glucose_mg_dl(person, state))
            state = self.step(person, noises, state, insulin, of_sample, appearance + returning, clock)
            there = jnp.isfinite(reading)
            innovation = jnp.where(there, jnp.where(there, reading, 0.0) - self.glucose_mg_dl(person, state), 0.0)
            state = state + linear.gain[:, None] * innovation
            return state, state[:, 0]

        return jax.lax.scan(sample, linear.state, jax.tree.map(jnp.asarray, inputs))[1]

    def ahead(
        self,
        person: Any,
        p: jax.Array,
        return_mg_min: Any,
        mean_mg_dl: Any,
        states: jax.Array,
        entries: Any,
        inputs_of: Callable[[Any], SampleInputs] = lambda entry: entry,
    ) -> jax.Array:
        """Glucose ``(samples, origins)`` after each sample from extended states ``(states, origins)`` on.

        An entry, of which there is one for each sample on the first axis, is the inputs of the sample, or what
        `inputs_of` makes them of.
        """
        noises = self.noises(p)

        def sample(state: jax.Array, entry: Any) -> tuple[jax.Array, jax.Array]:
            inputs = inputs_of(entry)
            returning = return_mg_min * (mean_mg_dl - self.glucose_mg_dl(person, state))
            inputs = inputs._replace(appearance_mg_min=inputs.appearance_mg_min + returning)
            state = self.step(person, noises, state, *inputs)
            return state, self.glucose_mg_dl(person, state)

        return jax.lax.scan(sample, states, entries)[1]


@functools.lru_cache(maxsize=8)
def _fall_program(fixed: ProgramKey) -> Any:
    @jax.jit
    def fall(p: jax.Array, numbers: Numbers, working_mg_dl: jax.Array) -> tuple[jax.Array, jax.Array]:
        patient = ExtendedPatient.traced(fixed, numbers)
        linear = patient.linearised(patient.person(p), p, working_mg_dl)
        return linear.fall_mg_dl_U, linear.returned_fall_mg_dl_U

    return fall


def _clock(days: Days) -> Any:
    return SAMPLE_MIN * (np.arange(len(days.insulin_mU_min)) % SAMPLES_PER_DAY)


def _stationary(A: jax.Array, c: jax.Array, noise: jax.Array, variance: jax.Array) -> jax.Array:
    """Stationary covariance before a reading, by doubling."""
    eye = jnp.eye(A.shape[0])

    def doubled(carry: Any, _: None) -> tuple[Any, None]:
        F, information, covariance = carry
        inverse = jnp.linalg.solve(eye + information @ covariance, jnp.concatenate([F, information], axis=1))
        of_F, of_information = inverse[:, : A.shape[0]], inverse[:, A.shape[0] :]
        return (
            F @ of_F,
            information + F @ of_information @ F.T,
            covariance + F.T @ covariance @ of_F,
        ), None

    start = (A.T, jnp.outer(c, c) / variance, noise)
    return jax.lax.scan(doubled, start, None, length=_DOUBLINGS)[0][2]
