"""Equations of a person of whom nothing is known but what insulin therapy is set by, for a model by profile.

Insulin goes through three lags, and what acts above the basal rate lowers glucose G, half in proportion to it::

    q_1' = (u - q_1) / 55,    q_2' = (q_1 - q_2) / 55,    q_3' = (q_2 - q_3) / 60
    G' = (b - K exp(g) (q_3 - u_n)) (1 + G / G_n) / 2 - 0.002 (G - G_n) + m / V,    b' = g' = 0

u_n and G_n are the basal rate and the target, m is the appearance of glucose from meals. The drift b under the basal
rate and the logarithm g of the gain of insulin are 0 at the operating point; a filter may learn them. K and V are such
that a person of 70 kg who needs 35 U a day has a correction factor of 1800 and a carbohydrate ratio of 500 over the
total daily dose, as the rules of Walsh et al. (2011) have it; `models.profiled` scales both to the ratio and the factor
of a person. With them the time courses are all that a model assumes. The lags are between those of the models of
Hovorka et al. (2004), Wilinska et al. (2010), Dalla Man et al. (2007) and Kanderian et al. (2009).
"""

from __future__ import annotations

from typing import Any, Final

from glucoloop._lazy_jax import jax, jnp
from glucoloop._pytree import pytree, static
from glucoloop.models.state_space import LinearModel, discretise, linearise
from glucoloop.therapy import BASAL_SHARE
from glucoloop.units import MIN_PER_DAY, MU_PER_U

WEIGHT_KG: Final = 70.0
DAILY_DOSE_U: Final = 35.0
_BASAL_MU_MIN: Final = BASAL_SHARE * DAILY_DOSE_U * MU_PER_U / MIN_PER_DAY
_LAGS_MIN: Final = (55.0, 55.0, 60.0)
_SELF_REGULATION_PER_MIN: Final = 0.002
_EFFECT_MG_DL_MU: Final = 0.0855
"""K, fall of glucose by a mU that acts."""
_VOLUME_DL: Final = 107.0
"""V, volume in which glucose from meals is diluted."""
DRIFT: Final = 3
LOG_GAIN: Final = 4
"""Places of b and g in the state."""
_GLUCOSE: Final = 5


@pytree
class TherapySettingsModel:
    """The equations; implements `models.nonlinear.Equations`. The state is q_1 to q_3, b, g, G, and a reading."""

    target_mg_dl: Any
    sensor_lag_min: Any
    """First-order lag of the reading behind glucose; 0 for a reading that is glucose."""
    sample_time_min: float = static()

    @property
    def insulin_mU_min(self) -> jax.Array:
        """Basal rate of the nominal person."""
        return jnp.asarray(_BASAL_MU_MIN)

    @property
    def state(self) -> jax.Array:
        """Steady state at the target."""
        rate, target = self.insulin_mU_min, jnp.asarray(self.target_mg_dl, float)
        zero = jnp.zeros_like(rate)
        return jnp.stack([rate, rate, rate, zero, zero, target, target])

    def fed(self, x: jax.Array, insulin_mU_min: jax.Array, appearance_mg_min: jax.Array) -> jax.Array:
        """Rate of change of the state, per minute, while glucose appears from meals."""
        q_1, q_2, q_3, drift, log_gain, glucose, reading = x
        first, second, third = _LAGS_MIN
        insulin = _EFFECT_MG_DL_MU * jnp.exp(log_gain) * (q_3 - _BASAL_MU_MIN)
        slope = 0.5 * (drift - insulin) * (1.0 + glucose / self.target_mg_dl)
        slope = slope - _SELF_REGULATION_PER_MIN * (glucose - self.target_mg_dl) + appearance_mg_min / _VOLUME_DL
        behind = (glucose - reading) / jnp.maximum(self.sensor_lag_min, 1.0)
        zero = jnp.zeros_like(glucose)
        return jnp.stack(
            [(insulin_mU_min - q_1) / first, (q_1 - q_2) / second, (q_2 - q_3) / third, zero, zero, slope, behind]
        )

    def derivative(self, x: jax.Array, insulin_mU_min: jax.Array) -> jax.Array:
        """Rate of change of the state, per minute."""
        return self.fed(x, insulin_mU_min, jnp.zeros_like(x[0]))

    def glucose_mg_dl(self, x: jax.Array) -> jax.Array:
        """Glucose of a state."""
        return x[_GLUCOSE]

    def reading_mg_dl(self, x: jax.Array) -> jax.Array:
        """Reading of a sensor without noise."""
        return jnp.where(jnp.asarray(self.sensor_lag_min) > 0.0, x[_GLUCOSE + 1], x[_GLUCOSE])

    def linearised(self) -> LinearModel:
        """The equations linearised at steady state, with appearance as the disturbance."""
        return discretise(
            linearise(self.fed, self.glucose_mg_dl, self.state, self.insulin_mU_min, 0.0, reading=self.reading_mg_dl),
            self.sample_time_min,
        )
