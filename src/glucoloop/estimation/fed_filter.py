"""Extended Kalman filter of a fed person: glucose, gut and its speed, a disturbance, and the error of the sensor.

What insulin does is known from what was delivered: states that glucose from meals does not reach are carried along
without an error. The others, the two compartments of the gut, the unexplained appearance, a correlated error of the
sensor and the time constant of the gut have a covariance. Meals nobody announced are noise on the first compartment of
the gut, so that a rise is taken for a meal that goes on as meals do; an announced meal enters both, the content with
what was counted and the covariance with the error of counting.

The time constant is the person's own and is learned, from meal to meal, as a share of the default one: with a gut of
one speed, a meal that appears fast is taken for a larger meal. By default it is never accepted to be longer than the
default one, since glucose that rises for longer than a meal should is then taken for the tail of a meal, and gets
insulin for hours. A guard asks for no insulin, and accepts more.

At the start all states of glucose are wrong by one share, as those of a person at rest at another glucose are.

Where the model has states for it, the filter learns what the profile has wrong too: the drift of glucose under the
basal rate, and the gains of insulin and of meals, as logarithms. Each has a standard deviation at the start and walks
from day to day, and none is accepted beyond a bound.

References
----------
A. H. Jazwinski, Stochastic Processes and Filtering Theory, Academic Press, 1970, Sec. 8.3 (the filter).
R. Hovorka et al., Physiol. Meas. 25, 2004, 905-920 (the gut).
"""

from __future__ import annotations

import dataclasses
from typing import Any, Final

from glucoloop._lazy_jax import jax, jnp, np
from glucoloop._pytree import pytree, static
from glucoloop.models.profiled import GutCompartments, ProfiledModel, Step
from glucoloop.units import MG_PER_G, MIN_PER_DAY

SAMPLE_MIN: Final = 5.0
"""Time in which the noise of the settings comes in."""
_FASTEST: Final = -1.0
"""Minimum logarithm of the time of a gut, relative to the default one, that is accepted."""
_MAX_LOG_GAIN: Final = 0.9
"""Maximum size of the logarithm of a gain, a factor of 2.5: somebody's ratio and factor may be told half or twice."""
_MAX_DRIFT: Final = 0.6
"""Maximum size of the drift under the basal rate, relative to the effect of that: of a rate told twice it is half."""


@pytree
class Learning:
    """Errors of a profile that are learned."""

    basal_error: Any
    """Relative standard deviation of the basal rate."""
    insulin_gain_error: Any
    """Standard deviation of the logarithm of the gain of insulin."""
    meal_gain_error: Any
    """The same of the gain of meals."""
    walk: Any
    """Standard deviation of the change of each in a day."""
    states: tuple[int, int] = static()
    """Numbers of the model's states for the drift of glucose under the basal rate and the log gain of insulin."""


@pytree
class FedEstimate:
    """Estimate of a person."""

    x: jax.Array
    """(n,) state of the model."""
    gut_mg: jax.Array
    """(2,) content of the gut."""
    disturbance_mg_min: jax.Array
    """Appearance that no meal explains, as in the nominal person."""
    sensor_mg_dl: jax.Array
    """Correlated error of the sensor."""
    log_gut_time: jax.Array
    """Logarithm of the time constant of the gut relative to the default one."""
    covariance: jax.Array
    """(m, m) covariance of gut, disturbance, error of the sensor, log time, the fed states, and where gains are learned
    drift, log gain of insulin and log gain of meals, in this order."""
    log_meal_gain: jax.Array | None = None
    """Logarithm of the gain of meals relative to the profile's; None where it is not learned."""

    @property
    def gut_error_mg(self) -> jax.Array:
        """Standard deviation of the content of the gut."""
        return jnp.sqrt(jnp.maximum(jnp.sum(self.covariance[:2, :2]), 0.0))


@pytree
class FedFilter:
    """The filter; see the head of the file."""

    gut: GutCompartments
    """The usual gut."""
    step: Step
    """Step of the model over a sample."""
    meal_noise_mg: jax.Array | float
    """Standard deviation of what is eaten unannounced in `SAMPLE_MIN`."""
    disturbance_noise_mg_min: jax.Array | float
    """Standard deviation of the change of the disturbance in `SAMPLE_MIN`."""
    disturbance_min: jax.Array | float
    """Time constant with which the disturbance fades."""
    glucose_noise_mg_min: jax.Array | float
    """Standard deviation of further appearance, new at every sample."""
    counting_error: jax.Array | float
    """Relative standard deviation of announced carbohydrate."""
    measurement_variance: jax.Array | float
    """Variance of white noise of a reading, (mg/dl)^2."""
    sensor_error_mg_dl: jax.Array | float
    """Standard deviation of the correlated error of the sensor."""
    sensor_correlation: jax.Array | float
    """Correlation of that error from one sample to the next."""
    gut_time_error: jax.Array | float
    """Relative standard deviation of the time constants of people's guts."""
    start_error_mg_dl: jax.Array | float
    """Standard deviation of glucose at the start from that of the model at steady state."""
    fed: tuple[int, ...] = static()
    """Numbers of the states of the model that appearance reaches."""
    learning: Learning | None = None
    """Errors of the profile that are learned, or None."""
    slowest_log_time: float = static(default=0.0)
    """Maximum logarithm of the time of a gut, relative to the default one, that is accepted."""

    @property
    def _estimated(self) -> tuple[int, ...]:
        """Numbers of the states of the model that have a covariance."""
        return self.fed + (() if self.learning is None else self.learning.states)

    def _vector(self, estimate: FedEstimate) -> jax.Array:
        """Numbers that have a covariance, ``(m,)``."""
        others = (estimate.disturbance_mg_min, estimate.sensor_mg_dl, estimate.log_gut_time)
        of_meals = () if estimate.log_meal_gain is None else (estimate.log_meal_gain,)
        states = [estimate.x[i] for i in self._estimated]
        return jnp.concatenate([estimate.gut_mg, jnp.stack([*others, *states, *of_meals])])

    def _with_vector(self, estimate: FedEstimate, v: jax.Array) -> FedEstimate:
        states, x = self._estimated, estimate.x
        return dataclasses.replace(
            estimate,
            x=jnp.stack([v[5 + states.index(i)] if i in states else x[i] for i in range(x.shape[0])]),
            gut_mg=v[:2],
            disturbance_mg_min=v[2],
            sensor_mg_dl=v[3],
            log_gut_time=v[4],
            log_meal_gain=None if estimate.log_meal_gain is None else v[5 + len(states)],
        )

    def _diagonal(self, of_others: tuple[Any, ...], of_learned: tuple[Any, ...]) -> jax.Array:
        """Diagonal matrix ``(m, m)``: of gut to log time, none of the fed states, and of what is learned."""
        values = [*of_others, *(0.0 for _ in self.fed), *(() if self.learning is None else of_learned)]
        return jnp.diag(jnp.stack([jnp.asarray(value, float) for value in values]))

    def gut_of(self, estimate: FedEstimate) -> GutCompartments:
        """The person's gut."""
        return GutCompartments(time_to_peak_min=self.gut.time_to_peak_min * jnp.exp(estimate.log_gut_time))

    def meal_gain_of(self, model: ProfiledModel, estimate: FedEstimate) -> jax.Array:
        """Gain of meals in the person, relative to the nominal person's."""
        gain, log = jnp.asarray(model.meal_gain), estimate.log_meal_gain
        return gain if log is None else gain * jnp.exp(log)

    def less_sure(self, estimate: FedEstimate, deviations: jax.Array | float) -> FedEstimate:
        """Estimate in which insulin does more than is learned, by so many standard deviations of its gain."""
        if self.learning is None:
            return estimate
        place = 5 + len(self.fed) + 1
        error = jnp.sqrt(jnp.maximum(estimate.covariance[place, place], 0.0))
        state = self.learning.states[1]
        x = [value + deviations * error if i == state else value for i, value in enumerate(estimate.x)]
        return dataclasses.replace(estimate, x=jnp.stack(x))

    def drifting_down(self, estimate: FedEstimate, deviations: float) -> FedEstimate:
        """Estimate in which glucose drifts down under the basal rate, by so many standard deviations of the drift."""
        if self.learning is None:
            return estimate
        place, state = 5 + len(self.fed), self.learning.states[0]
        error = jnp.sqrt(jnp.maximum(estimate.covariance[place, place], 0.0))
        x = [value - deviations * error if i == state else value for i, value in enumerate(estimate.x)]
        return dataclasses.replace(estimate, x=jnp.stack(x))

    def init(self, model: ProfiledModel) -> FedEstimate:
        """Estimate of a person at steady state with an empty gut, whose glucose is yet to be read."""
        none = jnp.zeros_like(jnp.asarray(model.basal_mU_min, float))
        rest, learning = jnp.asarray(model.nominal.state, float), self.learning
        of_glucose = rest * (self.start_error_mg_dl / model.glucose_mg_dl(rest))
        share = jnp.stack([of_glucose[i] for i in self.fed])
        after = 0 if learning is None else len(learning.states) + 1
        learned: tuple[Any, ...] = ()
        if learning is not None:
            drift = learning.basal_error * model.basal_effect_mg_dl_min
            learned = (drift**2, learning.insulin_gain_error**2, learning.meal_gain_error**2)
        others = (0.0, 0.0, 0.0, self.sensor_error_mg_dl**2, self.gut_time_error**2)
        return FedEstimate(
            x=rest + none,
            gut_mg=jnp.zeros(2) + none,
            disturbance_mg_min=none,
            sensor_mg_dl=none,
            log_gut_time=none,
            covariance=jnp.pad(jnp.outer(share, share), (5, after)) + self._diagonal(others, learned) + none,
            log_meal_gain=None if learning is None else none,
        )

    def predict(self, model: ProfiledModel, estimate: FedEstimate, insulin_mU_min: jax.Array) -> FedEstimate:
        """Estimate a sample later, under the rate that was delivered, a bolus being part of it."""
        minutes, correlation = self.step.minutes, jnp.asarray(self.sensor_correlation, float)

        def later(v: jax.Array) -> tuple[jax.Array, FedEstimate]:
            before = self._with_vector(estimate, v)
            gut, gain = self.gut_of(before), self.meal_gain_of(model, before)
            flux = gain * gut.appearance_mg_min(before.gut_mg, minutes) + before.disturbance_mg_min
            after = dataclasses.replace(
                before,
                x=model.advance(before.x, insulin_mU_min, flux, self.step),
                gut_mg=gut.after(before.gut_mg, minutes),
                disturbance_mg_min=jnp.exp(-minutes / self.disturbance_min) * before.disturbance_mg_min,
                sensor_mg_dl=correlation * before.sensor_mg_dl,
            )
            return self._vector(after), after

        F, after = jax.jacfwd(later, has_aux=True)(self._vector(estimate))
        r, share, learning = len(self.fed), minutes / SAMPLE_MIN, self.learning
        of_flux = F[5 : 5 + r, 2]
        noise = (
            share * self.meal_noise_mg**2,
            0.0,
            share * self.disturbance_noise_mg_min**2,
            (1.0 - correlation**2) * self.sensor_error_mg_dl**2,
            0.0,
        )
        walk: tuple[Any, ...] = ()
        if learning is not None:
            walks = learning.walk**2 * (minutes / MIN_PER_DAY)
            walk = (walks * model.basal_effect_mg_dl_min**2, walks, walks)
        after_fed = F.shape[0] - 5 - r
        Q = jnp.pad(self.glucose_noise_mg_min**2 * jnp.outer(of_flux, of_flux), (5, after_fed))
        Q = Q + self._diagonal(noise, walk)
        predicted: FedEstimate = dataclasses.replace(after, covariance=F @ estimate.covariance @ F.T + Q)
        return predicted

    def update(
        self, model: ProfiledModel, estimate: FedEstimate, reading_mg_dl: jax.Array, known: jax.Array
    ) -> FedEstimate:
        """Estimate corrected by a reading, if it is known."""

        def reading(v: jax.Array) -> jax.Array:
            seen = self._with_vector(estimate, v)
            return model.reading_mg_dl(seen.x) + seen.sensor_mg_dl

        v = self._vector(estimate)
        predicted, C = jax.value_and_grad(reading)(v)
        seen = estimate.covariance @ C
        K = seen / (C @ seen + self.measurement_variance)
        correction = K * jnp.where(known, reading_mg_dl - predicted, 0.0)
        corrected = self._bounded(model, self._with_vector(estimate, v + correction))
        return dataclasses.replace(
            corrected, covariance=estimate.covariance - jnp.where(known, 1.0, 0.0) * jnp.outer(K, seen)
        )

    def _bounded(self, model: ProfiledModel, estimate: FedEstimate) -> FedEstimate:
        """Estimate whose learned numbers are those that are accepted."""
        bounded = dataclasses.replace(
            estimate, log_gut_time=jnp.clip(estimate.log_gut_time, _FASTEST, self.slowest_log_time)
        )
        if self.learning is None or estimate.log_meal_gain is None:
            return bounded
        most = dict(zip(self.learning.states, (_MAX_DRIFT * model.basal_effect_mg_dl_min, _MAX_LOG_GAIN), strict=True))
        x = [jnp.clip(value, -most[i], most[i]) if i in most else value for i, value in enumerate(estimate.x)]
        log_meal_gain = jnp.clip(estimate.log_meal_gain, -_MAX_LOG_GAIN, _MAX_LOG_GAIN)
        return dataclasses.replace(bounded, x=jnp.stack(x), log_meal_gain=log_meal_gain)

    def announce(self, estimate: FedEstimate, carbs_g: jax.Array) -> FedEstimate:
        """Estimate with a meal that begins now."""
        m, carbs_mg = estimate.covariance.shape[0], MG_PER_G * carbs_g
        counted = np.zeros((m, m))
        counted[0, 0] = 1.0
        return dataclasses.replace(
            estimate,
            gut_mg=estimate.gut_mg + jnp.stack([carbs_mg, jnp.zeros_like(carbs_mg)]),
            covariance=estimate.covariance + counted * (self.counting_error * carbs_mg) ** 2,
        )
