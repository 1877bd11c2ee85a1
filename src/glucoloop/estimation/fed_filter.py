"""Extended Kalman filter of a fed person: glucose, gut, a disturbance, and perhaps the error of the sensor.

What insulin does is known from what was delivered: states that glucose from meals does not reach are carried along
without an error. The others, the two compartments of the gut, the unexplained appearance and a correlated error of the
sensor have a covariance. Meals nobody announced are noise on the first compartment of the gut, so that a rise is taken
for a meal that goes on as meals do; an announced meal enters both, the content with what was counted and the covariance
with the error of counting.

References
----------
A. H. Jazwinski, Stochastic Processes and Filtering Theory, Academic Press, 1970, Sec. 8.3 (the filter).
R. Hovorka et al., Physiol. Meas. 25, 2004, 905-920 (the gut).
"""

from __future__ import annotations

from typing import Final

import jax
import jax.numpy as jnp
import numpy as np

from glucoloop._pytree import pytree, static
from glucoloop.models.profiled import GutCompartments, ProfiledModel, Step
from glucoloop.units import MG_PER_G

SAMPLE_MIN: Final = 5.0
"""Time in which the noise of the settings comes in."""


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
    covariance: jax.Array
    """(m, m) covariance of the fed states, gut, disturbance and error of the sensor, in this order."""

    @property
    def gut_error_mg(self) -> jax.Array:
        """Standard deviation of the content of the gut."""
        m = self.covariance.shape[0]
        variance = jnp.sum(self.covariance[m - 4 : m - 2, m - 4 : m - 2])
        return jnp.sqrt(jnp.maximum(variance, 0.0))


@pytree
class FedFilter:
    """The filter; see the head of the file."""

    gut: GutCompartments
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
    fed: tuple[int, ...] = static()
    """Numbers of the states of the model that appearance reaches."""

    def _fed(self, x: jax.Array) -> jax.Array:
        return jnp.stack([x[i] for i in self.fed])

    def _with_fed(self, x: jax.Array, fed: jax.Array) -> jax.Array:
        return jnp.stack([fed[self.fed.index(i)] if i in self.fed else x[i] for i in range(x.shape[0])])

    def init(self, model: ProfiledModel) -> FedEstimate:
        """Estimate of a person at rest with an empty gut."""
        none, size = jnp.zeros_like(jnp.asarray(model.basal_mU_min, float)), len(self.fed) + 4
        variance = jnp.asarray(self.sensor_error_mg_dl, float) ** 2
        return FedEstimate(
            x=jnp.asarray(model.nominal.state, float) + none,
            gut_mg=jnp.zeros(2) + none,
            disturbance_mg_min=none,
            sensor_mg_dl=none,
            covariance=jnp.diag(jnp.append(jnp.zeros(size - 1), variance)) + none,
        )

    def predict(self, model: ProfiledModel, estimate: FedEstimate, insulin_mU_min: jax.Array) -> FedEstimate:
        """Estimate a sample later, under the rate that was delivered, a bolus being part of it."""
        minutes = self.step.minutes
        appears = self.gut.appearance_mg_min(estimate.gut_mg, minutes)
        flux = model.meal_gain * appears + estimate.disturbance_mg_min

        def fed_states(of_fed: jax.Array, flux: jax.Array) -> tuple[jax.Array, jax.Array]:
            x = model.advance(self._with_fed(estimate.x, of_fed), insulin_mU_min, flux, self.step)
            return self._fed(x), x

        at = self._fed(estimate.x)
        (of_state, of_flux), x = jax.jacfwd(fed_states, argnums=(0, 1), has_aux=True)(at, flux)
        left, mean = self._of_gut(minutes)
        fades, correlation = jnp.exp(-minutes / self.disturbance_min), jnp.asarray(self.sensor_correlation, float)
        r, zero = len(self.fed), jnp.zeros
        columns = jnp.concatenate(
            [of_state, jnp.outer(of_flux, jnp.append(model.meal_gain * mean, 1.0)), zero((r, 1))], axis=1
        )
        F = jnp.concatenate(
            [
                columns,
                jnp.concatenate([zero((2, r)), left, zero((2, 2))], axis=1),
                jnp.concatenate([zero((2, r + 2)), jnp.diag(jnp.stack([fades, correlation]))], axis=1),
            ]
        )
        share, drive = minutes / SAMPLE_MIN, (1.0 - correlation**2) * self.sensor_error_mg_dl**2
        eaten, changed = share * self.meal_noise_mg**2, share * self.disturbance_noise_mg_min**2
        noise = jnp.stack([jnp.asarray(value, float) for value in (eaten, 0.0, changed, drive)])
        Q = jnp.pad(self.glucose_noise_mg_min**2 * jnp.outer(of_flux, of_flux), (0, 4))
        Q = Q + jnp.diag(jnp.concatenate([jnp.zeros(r), noise]))
        return FedEstimate(
            x=x,
            gut_mg=left @ estimate.gut_mg,
            disturbance_mg_min=fades * estimate.disturbance_mg_min,
            sensor_mg_dl=self.sensor_correlation * estimate.sensor_mg_dl,
            covariance=F @ estimate.covariance @ F.T + Q,
        )

    def _of_gut(self, minutes: float) -> tuple[jax.Array, jax.Array]:
        """Matrix of the contents a sample later, and row of their mean appearance."""
        one = jnp.eye(2)
        left = jnp.stack([self.gut.after(one[:, i], minutes) for i in range(2)], axis=1)
        mean = jnp.stack([self.gut.appearance_mg_min(one[:, i], minutes) for i in range(2)])
        return left, mean

    def update(
        self, model: ProfiledModel, estimate: FedEstimate, reading_mg_dl: jax.Array, known: jax.Array
    ) -> FedEstimate:
        """Estimate corrected by a reading, if it is known."""
        r = len(self.fed)
        C = jnp.concatenate([self._fed(jax.grad(model.reading_mg_dl)(estimate.x)), jnp.zeros(3), jnp.ones(1)])
        seen = estimate.covariance @ C
        K = seen / (C @ seen + self.measurement_variance)
        predicted = model.reading_mg_dl(estimate.x) + estimate.sensor_mg_dl
        correction = K * jnp.where(known, reading_mg_dl - predicted, 0.0)
        covariance = estimate.covariance - jnp.where(known, 1.0, 0.0) * jnp.outer(K, seen)
        return FedEstimate(
            x=self._with_fed(estimate.x, self._fed(estimate.x) + correction[:r]),
            gut_mg=estimate.gut_mg + correction[r : r + 2],
            disturbance_mg_min=estimate.disturbance_mg_min + correction[r + 2],
            sensor_mg_dl=estimate.sensor_mg_dl + correction[r + 3],
            covariance=covariance,
        )

    def announce(self, estimate: FedEstimate, carbs_g: jax.Array) -> FedEstimate:
        """Estimate with a meal that begins now."""
        m, carbs_mg = estimate.covariance.shape[0], MG_PER_G * carbs_g
        counted = np.zeros((m, m))
        counted[m - 4, m - 4] = 1.0
        return FedEstimate(
            x=estimate.x,
            gut_mg=estimate.gut_mg + jnp.stack([carbs_mg, jnp.zeros_like(carbs_mg)]),
            disturbance_mg_min=estimate.disturbance_mg_min,
            sensor_mg_dl=estimate.sensor_mg_dl,
            covariance=estimate.covariance + counted * (self.counting_error * carbs_mg) ** 2,
        )
