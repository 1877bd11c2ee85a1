"""Extended Kalman filter of a fed person: glucose, gut and its speed, a disturbance, and the error of the sensor.

What insulin does is known from what was delivered: states that glucose from meals does not reach are carried along
without an error. The others, the two compartments of the gut, the unexplained appearance, a correlated error of the
sensor and the time constant of the gut have a covariance. Meals nobody announced are noise on the first compartment of
the gut, so that a rise is taken for a meal that goes on as meals do; an announced meal enters both, the content with
what was counted and the covariance with the error of counting.

The time constant is the person's own and is learned, from meal to meal, as a share of the default one: with a gut of
one speed, a meal that appears fast is taken for a larger meal. It is never accepted to be longer than the default one,
since glucose that rises for longer than a meal should is then taken for the tail of a meal, and gets insulin for hours.

At the start all states of glucose are wrong by one share, as those of a person at rest at another glucose are.

References
----------
A. H. Jazwinski, Stochastic Processes and Filtering Theory, Academic Press, 1970, Sec. 8.3 (the filter).
R. Hovorka et al., Physiol. Meas. 25, 2004, 905-920 (the gut).
"""

from __future__ import annotations

import dataclasses
from typing import Final

from glucoloop._lazy_jax import jax, jnp, np
from glucoloop._pytree import pytree, static
from glucoloop.models.profiled import GutCompartments, ProfiledModel, Step
from glucoloop.units import MG_PER_G

SAMPLE_MIN: Final = 5.0
"""Time in which the noise of the settings comes in."""
_FASTEST: Final = -1.0
"""Minimum logarithm of the time of a gut, relative to the default one, that is accepted."""


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
    """Logarithm of the time constant of the gut relative to the default one, at most 0."""
    covariance: jax.Array
    """(m, m) covariance of the fed states, gut, disturbance, error of the sensor and log time, in this order."""

    @property
    def gut_error_mg(self) -> jax.Array:
        """Standard deviation of the content of the gut."""
        m = self.covariance.shape[0]
        variance = jnp.sum(self.covariance[m - 5 : m - 3, m - 5 : m - 3])
        return jnp.sqrt(jnp.maximum(variance, 0.0))


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

    def _fed(self, x: jax.Array) -> jax.Array:
        return jnp.stack([x[i] for i in self.fed])

    def _vector(self, estimate: FedEstimate) -> jax.Array:
        """Numbers that have a covariance, ``(m,)``."""
        others = (estimate.disturbance_mg_min, estimate.sensor_mg_dl, estimate.log_gut_time)
        return jnp.concatenate([self._fed(estimate.x), estimate.gut_mg, jnp.stack(others)])

    def _with_vector(self, estimate: FedEstimate, v: jax.Array) -> FedEstimate:
        r, x = len(self.fed), estimate.x
        return dataclasses.replace(
            estimate,
            x=jnp.stack([v[self.fed.index(i)] if i in self.fed else x[i] for i in range(x.shape[0])]),
            gut_mg=v[r : r + 2],
            disturbance_mg_min=v[r + 2],
            sensor_mg_dl=v[r + 3],
            log_gut_time=v[r + 4],
        )

    def gut_of(self, estimate: FedEstimate) -> GutCompartments:
        """The person's gut."""
        return GutCompartments(time_to_peak_min=self.gut.time_to_peak_min * jnp.exp(estimate.log_gut_time))

    def init(self, model: ProfiledModel) -> FedEstimate:
        """Estimate of a person at steady state with an empty gut, whose glucose is yet to be read."""
        none = jnp.zeros_like(jnp.asarray(model.basal_mU_min, float))
        rest = jnp.asarray(model.nominal.state, float)
        share = self._fed(rest) * (self.start_error_mg_dl / model.glucose_mg_dl(rest))
        errors = [jnp.asarray(error, float) ** 2 for error in (self.sensor_error_mg_dl, self.gut_time_error)]
        others = jnp.diag(jnp.concatenate([jnp.zeros(len(self.fed) + 3), jnp.stack(errors)]))
        return FedEstimate(
            x=rest + none,
            gut_mg=jnp.zeros(2) + none,
            disturbance_mg_min=none,
            sensor_mg_dl=none,
            log_gut_time=none,
            covariance=jnp.pad(jnp.outer(share, share), (0, 5)) + others + none,
        )

    def predict(self, model: ProfiledModel, estimate: FedEstimate, insulin_mU_min: jax.Array) -> FedEstimate:
        """Estimate a sample later, under the rate that was delivered, a bolus being part of it."""
        minutes, correlation = self.step.minutes, jnp.asarray(self.sensor_correlation, float)

        def later(v: jax.Array) -> tuple[jax.Array, FedEstimate]:
            before = self._with_vector(estimate, v)
            gut = self.gut_of(before)
            flux = model.meal_gain * gut.appearance_mg_min(before.gut_mg, minutes) + before.disturbance_mg_min
            after = dataclasses.replace(
                before,
                x=model.advance(before.x, insulin_mU_min, flux, self.step),
                gut_mg=gut.after(before.gut_mg, minutes),
                disturbance_mg_min=jnp.exp(-minutes / self.disturbance_min) * before.disturbance_mg_min,
                sensor_mg_dl=correlation * before.sensor_mg_dl,
            )
            return self._vector(after), after

        F, after = jax.jacfwd(later, has_aux=True)(self._vector(estimate))
        r, share = len(self.fed), minutes / SAMPLE_MIN
        of_flux = F[:r, r + 2]
        noise = (
            share * self.meal_noise_mg**2,
            0.0,
            share * self.disturbance_noise_mg_min**2,
            (1.0 - correlation**2) * self.sensor_error_mg_dl**2,
            0.0,
        )
        Q = jnp.pad(self.glucose_noise_mg_min**2 * jnp.outer(of_flux, of_flux), (0, 5))
        Q = Q + jnp.diag(jnp.concatenate([jnp.zeros(r), jnp.stack([jnp.asarray(value, float) for value in noise])]))
        predicted: FedEstimate = dataclasses.replace(after, covariance=F @ estimate.covariance @ F.T + Q)
        return predicted

    def update(
        self, model: ProfiledModel, estimate: FedEstimate, reading_mg_dl: jax.Array, known: jax.Array
    ) -> FedEstimate:
        """Estimate corrected by a reading, if it is known."""
        C = jnp.concatenate(
            [self._fed(jax.grad(model.reading_mg_dl)(estimate.x)), jnp.array([0.0, 0.0, 0.0, 1.0, 0.0])]
        )
        seen = estimate.covariance @ C
        K = seen / (C @ seen + self.measurement_variance)
        predicted = model.reading_mg_dl(estimate.x) + estimate.sensor_mg_dl
        correction = K * jnp.where(known, reading_mg_dl - predicted, 0.0)
        corrected = self._with_vector(estimate, self._vector(estimate) + correction)
        return dataclasses.replace(
            corrected,
            log_gut_time=jnp.clip(corrected.log_gut_time, _FASTEST, 0.0),
            covariance=estimate.covariance - jnp.where(known, 1.0, 0.0) * jnp.outer(K, seen),
        )

    def announce(self, estimate: FedEstimate, carbs_g: jax.Array) -> FedEstimate:
        """Estimate with a meal that begins now."""
        m, carbs_mg = estimate.covariance.shape[0], MG_PER_G * carbs_g
        counted = np.zeros((m, m))
        counted[m - 5, m - 5] = 1.0
        return dataclasses.replace(
            estimate,
            gut_mg=estimate.gut_mg + jnp.stack([carbs_mg, jnp.zeros_like(carbs_mg)]),
            covariance=estimate.covariance + counted * (self.counting_error * carbs_mg) ** 2,
        )
