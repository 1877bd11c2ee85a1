"""Moving-horizon estimation of meals that are not announced, by enumeration.

A meal of Lehmann and Deutsch is two events: it begins, and it ends. Over the last L samples one of them may have
happened, at any sample or not at all. Each possibility is a hypothesis with a state of its own, which the nonlinear
model carries on with the meal that it stands for, and with a probability, which each reading changes by Bayes' rule::

    fasting    no meal for L samples, or more             begun j ago    j = 1 .. L
    eating     a meal for L samples, or more              ended j ago    j = 1 .. L
    fast gut   a meal for F samples, or more              begun j ago, ended j ago    j = 1 .. F
    lost       no insulin arrives, fasting or eating

Events older than L samples no longer distinguish hypotheses: those that meet are merged to their mean. A meal may go
through a gut that passes it on in half the time; that it rises and ends faster tells the two guts apart. In the last
two the line is blocked or the pump has stopped, whatever it reports. They are entered from all others and left to those
without a recent event, so that the state then has no insulin on board that never came.
Within a hypothesis a steady Kalman gain corrects the state, a disturbance, and a correlated error of the sensor. Its
size is one of a few levels, and each reading judges each hypothesis with each level together, since a meal that begins
and an error that grows explain the same readings; see `estimation.noise_level`. The disturbance is glucose that appears
for no known reason; it takes up what the model gets wrong, within a bound.

With the events of the horizon enumerated and the merged state as what is known before it, this is moving-horizon
estimation with a discrete decision; with the weights kept in place of the best alone, it is the interacting
multiple-model filter on the age of the last event.

References
----------
E. D. Lehmann, T. Deutsch, J. Biomed. Eng. 14, 1992: the meal.
C. V. Rao, J. B. Rawlings, D. Q. Mayne, "Constrained state estimation for nonlinear discrete-time systems: stability and
moving horizon approximations", IEEE Trans. Autom. Control 48(2), 2003.
H. A. P. Blom, Y. Bar-Shalom, "The interacting multiple model algorithm for systems with Markovian switching
coefficients", IEEE Trans. Autom. Control 33(8), 1988.
Y. Zhang, X. R. Li, "Detection and diagnosis of sensor and actuator failures using IMM estimator", IEEE Trans. Aerosp.
Electron. Syst. 34(4), 1998: one more model for each failure of an actuator.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from typing import Annotated, ClassVar, Final, TypeAlias

from glucoloop._lazy_jax import jax, jnp, np, npt
from glucoloop._pytree import pytree, static
from glucoloop.component.setting import About
from glucoloop.estimation.noise_level import (
    LEVELS_MG_DL,
    Innovations,
    NoisyFilters,
    drifting,
    innovations_of,
    mean_size,
    noisy_filters,
    shares,
)
from glucoloop.estimation.unknown_meal.disturbed import (
    LARGEST_INNOVATION_MG_DL,
    Waking,
    check_variances,
    fading,
    linearised,
    waking,
)
from glucoloop.estimation.unknown_meal.habits import DailyRates, MealHabits
from glucoloop.estimation.unknown_meal.protocol import EstimatorComponent, MealEstimate, Sensed
from glucoloop.meals.lehmann_deutsch import GUT_TIME_CONSTANT_MIN
from glucoloop.meals.stomach import (
    FAST_GUT_MIN,
    SERVED_G_PER_MIN,
    Announced,
    Gut,
    Stomach,
    announce,
    digest,
    empty_stomach,
    gut_of,
    nothing_announced,
    serve,
)
from glucoloop.models.nonlinear import FedModel, reading_of
from glucoloop.refusal import Refusal

Numbers: TypeAlias = "npt.NDArray[np.float64]"

_LONGEST_HORIZON: Final = 100
_MIN_GUT_MG: Final = 60.0
"""Content of a gut that is small beside a meal's and counts as that of Lehmann and Deutsch."""
_LEAST: Final = 1e-30
"""Probability below which no hypothesis falls, so that each can come back."""
_FAILS_UNREPORTED: Final = 0.5
"""Probability that insulin ceases to arrive in a sample of which the pump reports no rate."""
_STRAY: Final = 1e-3
"""Likelihood that is added to each hypothesis, so that a reading far from all of them does not tell them apart."""


_samples: Final = functools.partial(About, at_least=2, at_most=100)


class MovingHorizonSettings(EstimatorComponent, name="moving-horizon"):
    """Beginning and end of a meal, over the latest samples; learns the sensor's noise, and knows of lost insulin."""

    sources = ("lehmann1992", "rao2003", "blom1988", "zhang1998")
    make: ClassVar = "glucoloop.estimation.unknown_meal.moving_horizon:design_meal_horizon"
    horizon: Annotated[int, _samples("Samples over which the beginning or end of a meal is searched for, L.")] = 6
    fast_horizon: Annotated[int, _samples("The same for meals through a fast gut, F.")] = 4
    largest_disturbance_mg_min: Annotated[
        float, About("Largest unexplained appearance of glucose that is accepted, to either side.", above=0.0)
    ] = 100.0
    noise_drift: Annotated[
        float,
        About(
            "Probability that the size of the sensor's correlated error changes by 1 mg/dl from sample to sample; "
            "0: the noise is as told.",
            at_least=0.0,
            at_most=1.0,
        ),
    ] = 0.01
    noise_patience: Annotated[
        float,
        About(
            "Decay of the expected number of meals with the size of the sensor's correlated error, per mg/dl.",
            at_least=0.0,
        ),
    ] = 3.0
    ends_unseen: Annotated[
        float,
        About(
            "Probability that a meal ends in a sample without a reading, if above the usual.", at_least=0.0, below=1.0
        ),
    ] = 0.3
    failures_per_h: Annotated[
        float,
        About("Expected number of times per hour at which insulin ceases to arrive, unreported.", at_least=0.0),
    ] = 0.002
    failure_min: Annotated[float, About("Mean time until insulin arrives again.", above=0.0)] = 90.0
    fast_meals: Annotated[
        float,
        About("Share of the meals that go through a gut of 30 min in place of 60 min.", at_least=0.0, below=1.0),
    ] = 0.1


@pytree
class Hypothesis:
    """State of each hypothesis; the axis of hypotheses is the last one."""

    x: jax.Array
    """(n, ...) state of the model."""
    stomach: Stomach
    disturbance_mg_min: jax.Array
    carbs_g: jax.Array
    """Carbohydrate served so far of the meal that the hypothesis is about, the latest one."""
    error_mg_dl: jax.Array
    """Correlated error of the sensor."""
    innovation_mg_dl: jax.Array
    """Last reading less its prediction."""


@pytree
class _MealHorizonState:
    """State of the estimator."""

    hypotheses: Hypothesis
    probability: jax.Array
    """(levels, 2 L + 2 F + 5) probability of each size of the sensor's error together with each hypothesis."""
    announced: Announced


@pytree
class MealHorizon:
    """Moving-horizon estimator of meals; see `design_meal_horizon`. Implements `MealEstimator`."""

    filters: NoisyFilters
    """Gains for the state, the disturbance and the sensor's error, at each size of the error."""
    innovations: Innovations
    first_sizes: jax.Array
    """(levels,) probability of each size before the first reading."""
    drift: jax.Array
    """(levels, levels) matrix by which the probabilities of the sizes pass from sample to sample."""
    largest_disturbance_mg_min: jax.Array | float
    """Largest disturbance that is accepted, to either side."""
    begins: jax.Array
    """(levels,) probability that a meal begins in a sample, for each of `LEVELS_MG_DL`, or (rates, levels)."""
    ends: jax.Array
    """Probability that a meal under way ends in a sample."""
    ends_unseen: jax.Array | float
    """The same without a reading, which could tell that it goes on."""
    fails: jax.Array | float
    """Probability that insulin ceases to arrive in a sample."""
    returns: jax.Array | float
    """Probability that insulin arrives again in a sample."""
    waking: Waking
    fast_meals: jax.Array | float
    """Share of the meals that go through a fast gut."""
    digests: float = static()
    """Probability that a meal through a fast gut ceases in a sample to differ from none, once it has long ended."""
    daily: DailyRates | None = None
    """Rates of meals by the time of day, or None for one rate."""
    horizon: int = static()
    fast_horizon: int = static()

    def at_each_rate(self) -> tuple[MealHorizon, ...]:
        """The same estimator at each of its rates of meals, held all day; itself alone where there is one."""
        if self.daily is None:
            return (self,)
        return tuple(dataclasses.replace(self, begins=begins, daily=None) for begins in self.begins)

    def at_noise(self, deviation_mg_dl: float) -> MealHorizon:
        """The same estimator for a sensor whose correlated error has a known standard deviation."""
        share = shares(jnp.asarray(deviation_mg_dl))
        begins = jnp.broadcast_to(jnp.sum(share * self.begins, axis=-1, keepdims=True), self.begins.shape)
        filters = self.filters.fixed(deviation_mg_dl)
        return dataclasses.replace(
            self,
            filters=filters,
            innovations=self.innovations.fixed(filters.innovation_variance[0]),
            first_sizes=share,
            drift=jnp.eye(share.size),
            begins=begins,
        )

    def init(self, model: FedModel, sensed: Sensed) -> _MealHorizonState:
        """State of a fasting person at steady state."""
        x, disturbance = self.waking.wake(model, sensed.insulin_mU_min, sensed.glucose_mg_dl, sensed.known)
        fasting = Hypothesis(
            x=x,
            stomach=empty_stomach(disturbance, model.sample_time_min),
            disturbance_mg_min=disturbance,
            carbs_g=jnp.zeros_like(disturbance),
            error_mg_dl=jnp.zeros_like(disturbance),
            innovation_mg_dl=jnp.zeros_like(disturbance),
        )
        number = self._hypotheses
        return _MealHorizonState(
            hypotheses=jax.tree.map(lambda leaf: jnp.broadcast_to(leaf[..., None], (*leaf.shape, number)), fasting),
            probability=self.first_sizes[:, None] * np.append(1.0, np.full(number - 1, _LEAST)),
            announced=nothing_announced(disturbance),
        )

    def step(self, model: FedModel, state: _MealHorizonState, sensed: Sensed) -> tuple[_MealHorizonState, MealEstimate]:
        """Age the hypotheses by a sample, carry them with the model, and correct them by the reading."""
        announced, served = serve(state.announced, model.sample_time_min)
        # Without a reading nothing may tell that a meal has begun; that one may have ended is the safe side. And who is
        # being served an announced meal does not begin another one.
        at_levels = self.begins if self.daily is None else self.daily.at(self.begins, sensed.time_of_day_min)
        begins = jnp.where(sensed.known & (served == 0.0), at_levels, 0.0)[:, None]
        ends = jnp.where(sensed.known, self.ends, self.ends_unseen)
        fails = jnp.where(sensed.reported, self.fails, _FAILS_UNREPORTED)
        returns = jnp.where(sensed.reported, self.returns, 0.0)
        drifted = self.drift @ state.probability
        hypotheses, probability = self._age(state.hypotheses, drifted, begins, ends, fails, returns)
        hypotheses = self._carry(model, hypotheses, sensed.insulin_mU_min, served)
        hypotheses, probability = self._correct(model, hypotheses, probability, sensed)
        state = _MealHorizonState(
            hypotheses=hypotheses,
            probability=probability,
            announced=announce(announced, sensed.announced_carbs_g),
        )
        return state, self._estimate(state, model.sample_time_min)

    @property
    def _hypotheses(self) -> int:
        """Number of hypotheses, whose order is that of the table above, those of the fast gut before those lost."""
        return 2 * self.horizon + 2 * self.fast_horizon + 5

    def _eating(self) -> Numbers:
        """Indicator of the hypotheses in which a meal is being served."""
        L, F = self.horizon, self.fast_horizon
        return np.repeat([0.0, 1.0, 0.0, 1.0, 0.0, 0.0, 1.0], [1, L + 1, L, F + 1, F, 1, 1])

    def _fast(self) -> Numbers:
        """Indicator of the hypotheses in which the gut is fast."""
        return np.repeat([0.0, 1.0, 0.0], [2 * self.horizon + 2, 2 * self.fast_horizon + 1, 2])

    def _arrives(self) -> Numbers:
        """Indicator of the hypotheses in which insulin arrives."""
        return np.repeat([1.0, 0.0], [self._hypotheses - 2, 2])

    def _gut_min(self) -> Numbers:
        """Time constant of the gut in each hypothesis."""
        return np.array([FAST_GUT_MIN if fast else GUT_TIME_CONSTANT_MIN for fast in self._fast()])

    def _age(
        self,
        hypothesis: Hypothesis,
        p: jax.Array,
        begins: jax.Array,
        ends: jax.Array,
        fails: jax.Array | float,
        returns: jax.Array | float,
    ) -> tuple[Hypothesis, jax.Array]:
        """Age all events by a sample: the oldest hypotheses are merged, and new events may happen.

        `begins` is ``(levels, 1)``; a state is passed on in the proportions of all sizes of the error together.
        """
        L, F = self.horizon, self.fast_horizon
        eats, arrives, fast = self._eating(), self._arrives(), self._fast()
        fasting, feasting = arrives * (1.0 - eats), arrives * eats
        lost, lost_eating = (1.0 - arrives) * (1.0 - eats), (1.0 - arrives) * eats
        number, first_fast, last_fast = np.arange(self._hypotheses), 2 * L + 2, 2 * L + 2 * F + 2

        def those(*which: int) -> Numbers:
            return np.isin(number, which).astype(float)

        stays, remains = 1.0 - returns, 1.0 - self.digests
        # What each hypothesis passes to each of those that are merged of several. The second, in which a meal has just
        # begun, may have no probability; its state is that of all who could begin one, by either gut.
        passes = jnp.stack(
            [
                p * share
                for share in (
                    (those(0, 2 * L + 1) + self.digests * those(last_fast) + returns * lost) * (1.0 - begins),
                    fasting,
                    (those(L, L + 1) + returns * lost_eating) * (1.0 - ends),
                    (1.0 - fast) * feasting * ends,
                    those(first_fast + F - 1, first_fast + F) * (1.0 - ends),
                    fast * feasting * ends,
                    (those(last_fast - 1) + remains * those(last_fast)) * (1.0 - begins),
                    fails * fasting + stays * (lost + ends * lost_eating),
                    fails * feasting + stays * (1.0 - ends) * lost_eating,
                )
            ],
            axis=1,
        )
        total, together = jnp.sum(passes, axis=-1), jnp.sum(passes, axis=0)
        mixing = together / jnp.sum(together, axis=-1, keepdims=True)

        def joined(leaf: jax.Array, merged: jax.Array, *begun: jax.Array) -> jax.Array:
            """All hypotheses, where those that are not merged come from the one a sample younger."""
            slow, quick = begun
            return jnp.concatenate(
                [
                    merged[..., :1],
                    slow,
                    leaf[..., 1:L],
                    merged[..., 2:4],
                    leaf[..., L + 2 : 2 * L + 1],
                    quick,
                    leaf[..., first_fast : first_fast + F - 1],
                    merged[..., 4:6],
                    leaf[..., first_fast + F + 1 : last_fast - 1],
                    merged[..., 6:],
                ],
                axis=-1,
            )

        def aged(leaf: jax.Array) -> jax.Array:
            merged = leaf @ mixing.T
            return joined(leaf, merged, merged[..., 1:2], merged[..., 1:2])

        begun = begins * total[:, 1:2]
        passed = joined(
            p * (1.0 - jnp.where(eats > 0.0, ends, begins)),
            total,
            (1.0 - self.fast_meals) * begun,
            self.fast_meals * begun,
        )
        later: Hypothesis = jax.tree.map(aged, hypothesis)
        return dataclasses.replace(later, carbs_g=jnp.where(those(1, first_fast) > 0.0, 0.0, later.carbs_g)), passed

    def _carry(self, model: FedModel, hypothesis: Hypothesis, insulin: jax.Array, announced: jax.Array) -> Hypothesis:
        """Carry each hypothesis through the sample that has passed."""
        h, eats = model.sample_time_min, self._eating()

        def one(given: tuple[Hypothesis, jax.Array, Gut, jax.Array]) -> Hypothesis:
            hypothesis, eats, gut, arrives = given
            stomach, appearance = digest(hypothesis.stomach, announced + eats, h, gut)
            appearance = appearance.at[0].add(hypothesis.disturbance_mg_min)
            return Hypothesis(
                x=model.advance_fed(hypothesis.x, insulin * arrives, appearance),
                stomach=stomach,
                disturbance_mg_min=fading(hypothesis.disturbance_mg_min, hypothesis.stomach, stomach),
                carbs_g=hypothesis.carbs_g + eats * (SERVED_G_PER_MIN * h),
                error_mg_dl=self.filters.correlation * hypothesis.error_mg_dl,
                innovation_mg_dl=hypothesis.innovation_mg_dl,
            )

        # one after the other, in a loop: their number must not make the program longer
        each = jax.tree.map(
            lambda leaf: jnp.moveaxis(leaf, -1, 0), (hypothesis, eats, gut_of(self._gut_min(), h), self._arrives())
        )
        later: Hypothesis = jax.tree.map(lambda leaf: jnp.moveaxis(leaf, 0, -1), jax.lax.map(one, each))
        return later

    def _correct(
        self, model: FedModel, hypothesis: Hypothesis, p: jax.Array, sensed: Sensed
    ) -> tuple[Hypothesis, jax.Array]:
        """Correct the states by the gain, and the probabilities by Bayes' rule."""
        predicted = jax.vmap(reading_of(model), in_axes=-1)(hypothesis.x) + hypothesis.error_mg_dl
        innovation = jnp.where(sensed.known, sensed.glucose_mg_dl - predicted, 0.0)
        moved = jnp.clip(innovation, -LARGEST_INNOVATION_MG_DL, LARGEST_INNOVATION_MG_DL)
        noise = mean_size(p)
        gain, _ = self.filters.at(noise)
        likelihood = self.innovations.likelihood(noise, innovation, hypothesis.innovation_mg_dl, _STRAY)
        p = p * jnp.where(sensed.known, likelihood, 1.0)
        p = jnp.maximum(p / jnp.sum(p), _LEAST)
        largest = self.largest_disturbance_mg_min
        corrected = Hypothesis(
            x=hypothesis.x + gain[:-2, None] * moved,
            stomach=hypothesis.stomach,
            disturbance_mg_min=jnp.clip(hypothesis.disturbance_mg_min + gain[-2] * moved, -largest, largest),
            carbs_g=hypothesis.carbs_g,
            error_mg_dl=hypothesis.error_mg_dl + gain[-1] * moved,
            innovation_mg_dl=moved,
        )
        return corrected, p / jnp.sum(p)

    def _estimate(self, state: _MealHorizonState, sample_time_min: float) -> MealEstimate:
        """Expected values over the hypotheses."""
        p = jnp.sum(state.probability, axis=0)
        mean: Hypothesis = jax.tree.map(lambda leaf: jnp.sum(leaf * p, axis=-1), state.hypotheses)
        eats = self._eating()
        eating = jnp.sum(p * eats)
        # Of two meals, that of the likelier half: one that may have begun just now says nothing of the one before.
        share = p * jnp.where(eating > 0.5, eats, 1.0 - eats)
        carbs_g = jnp.sum(share * state.hypotheses.carbs_g) / jnp.sum(share)
        per_sample = SERVED_G_PER_MIN * sample_time_min
        return MealEstimate(
            x=mean.x,
            stomach=mean.stomach,
            announced=state.announced,
            disturbance_mg_min=mean.disturbance_mg_min,
            eating=eating,
            carbs_g=carbs_g,
            remaining_g=eating * per_sample * (1.0 - self.ends) / self.ends,
            noise_mg_dl=mean_size(state.probability),
            gut_min=self._time_constant(p * state.hypotheses.stomach.gut_mg),
            lost=jnp.sum(p * (1.0 - self._arrives())),
        )

    def _time_constant(self, gut_mg: jax.Array) -> jax.Array:
        """Time constant of one gut from which as much appears as from the contents in all hypotheses."""
        little = _MIN_GUT_MG / GUT_TIME_CONSTANT_MIN
        hypothesis, appears = jnp.sum(gut_mg), jnp.sum(gut_mg / self._gut_min())
        return jnp.clip((hypothesis + _MIN_GUT_MG) / (appears + little), FAST_GUT_MIN, GUT_TIME_CONSTANT_MIN)


def design_meal_horizon(
    model: FedModel,
    habits: MealHabits | None = None,
    *,
    horizon: int = MovingHorizonSettings.horizon,
    fast_horizon: int = MovingHorizonSettings.fast_horizon,
    disturbance_variance: float = 10.0,
    measurement_variance: float = 1.45,
    largest_disturbance_mg_min: float = MovingHorizonSettings.largest_disturbance_mg_min,
    noise_drift: float = MovingHorizonSettings.noise_drift,
    ends_unseen: float = MovingHorizonSettings.ends_unseen,
    noise_patience: float = MovingHorizonSettings.noise_patience,
    failures_per_h: float = MovingHorizonSettings.failures_per_h,
    failure_min: float = MovingHorizonSettings.failure_min,
    fast_meals: float = MovingHorizonSettings.fast_meals,
) -> MealHorizon:
    """Design the estimator for a model.

    Settings have the meanings, units and bounds of those of the same names in `estimation.unknown_meal`.

    Parameters
    ----------
    horizon, fast_horizon : int
        L and F, from 2 to 100 samples.
    measurement_variance : float
        R, (mg/dl)^2, above 0.
    noise_drift : float
        Probability, from 0 to 1, that the size of the correlated error changes by 1 mg/dl in a sample; 0: there is
        none, and the noise is as told.
    noise_patience : float
        Factor ``exp(-noise_patience s)`` on the probability that a meal begins, at a size s of the correlated error.

    Raises
    ------
    ValueError
        Outside these bounds, or for a model whose disturbance cannot be told from glucose.
    """
    habits = MealHabits() if habits is None else habits
    for samples, what in ((horizon, "a meal horizon"), (fast_horizon, "a horizon of meals through a fast gut")):
        if isinstance(samples, bool) or not isinstance(samples, int) or not 2 <= samples <= _LONGEST_HORIZON:
            raise Refusal(
                f"{what} of {samples} samples is not possible; give a whole number from 2 to {_LONGEST_HORIZON}"
            )
    check_variances(disturbance_variance, measurement_variance)
    if not 0.0 < largest_disturbance_mg_min < np.inf:
        raise Refusal(
            f"a largest disturbance of {largest_disturbance_mg_min:g} mg/min is not possible; "
            "give a finite value above 0"
        )
    for value, what in ((noise_patience, "patience with noise"), (failures_per_h, "rate of failures per hour")):
        if not 0.0 <= value < np.inf:
            raise Refusal(f"a {what} of {value:g} is not possible; give a finite value of 0 or more")
    if not 0.0 <= fast_meals < 1.0:
        raise Refusal(f"a share of {fast_meals:g} of meals through a fast gut is not possible; give 0 to below 1")
    if not 0.0 < failure_min < np.inf:
        raise Refusal(f"failures of {failure_min:g} min are not possible; give a finite time above 0")
    if not 0.0 <= noise_drift <= 1.0:
        raise Refusal(f"a drift of the noise with a probability of {noise_drift:g} is not possible; give 0 to 1")
    linear = linearised(model)
    n = linear.Gamma.size
    Q = np.zeros((n + 1, n + 1))
    Q[n, n] = disturbance_variance
    h = model.sample_time_min
    begins = np.outer(habits.begins_at_rates(h), np.exp(-noise_patience * np.asarray(LEVELS_MG_DL)))
    filters = noisy_filters(linear.Phi, linear.C, Q, measurement_variance)
    levels = len(LEVELS_MG_DL)
    horizon_of = MealHorizon(
        filters=filters,
        innovations=innovations_of(filters, linear.Phi, linear.C, Q, measurement_variance),
        first_sizes=jnp.full(levels, 1.0 / levels),
        drift=jnp.asarray(drifting(noise_drift)),
        largest_disturbance_mg_min=largest_disturbance_mg_min,
        begins=jnp.asarray(begins[0] if habits.daily is None else begins),
        ends=jnp.asarray(habits.ends(h)),
        ends_unseen=jnp.asarray(max(ends_unseen, habits.ends(h))),
        fails=-math.expm1(-failures_per_h * h / 60.0),
        returns=-math.expm1(-h / failure_min),
        waking=waking(linear, measurement_variance),
        daily=habits.daily,
        fast_meals=fast_meals,
        digests=-math.expm1(-h / GUT_TIME_CONSTANT_MIN),
        horizon=horizon,
        fast_horizon=fast_horizon,
    )
    return horizon_of if noise_drift > 0.0 else horizon_of.at_noise(LEVELS_MG_DL[0])
