"""Internal models of a controller whose sensor lags: the reading is one more state, behind glucose.

With glucose G and the reading r, ``lag r' = G - r``. A controller estimates the state from r and regulates G, so that
its setpoint, its constraints and its forecasts are of glucose itself.
"""

from __future__ import annotations

import dataclasses

from glucoloop._lazy_jax import jax, jnp
from glucoloop._pytree import pytree
from glucoloop.models.nonlinear import FedModel, roughly
from glucoloop.models.state_space import ContinuousModel
from glucoloop.refusal import Refusal
from glucoloop.sensors.delay import lagged


@pytree
class _LaggedModel:
    """A nonlinear model and the reading behind a lag, its last state; implements `FedModel`.

    Over a sample glucose is taken to change evenly between its values at both ends, as the sensor `lag` does.
    """

    inner: FedModel
    lag_min: jax.Array

    @property
    def sample_time_min(self) -> float:
        """Time between samples, that of the inner model."""
        return self.inner.sample_time_min

    @property
    def insulin_mU_min(self) -> jax.Array:
        """Infusion at the operating point, that of the inner model."""
        return self.inner.insulin_mU_min

    @property
    def state(self) -> jax.Array:
        """Steady state at the operating point, where the reading is glucose."""
        rest = self.inner.state
        return jnp.append(rest, self.inner.glucose_mg_dl(rest))

    def roughly(self) -> _LaggedModel:
        """The same model by a less accurate integrator."""
        return dataclasses.replace(self, inner=roughly(self.inner))

    def derivative(self, x: jax.Array, insulin_mU_min: jax.Array) -> jax.Array:
        """Rate of change of the state, per minute."""
        following = (self.glucose_mg_dl(x) - self.reading_mg_dl(x)) / self.lag_min
        return jnp.append(self.inner.derivative(x[:-1], insulin_mU_min), following)

    def _and_reading(self, x: jax.Array, later: jax.Array) -> jax.Array:
        before, now = self.glucose_mg_dl(x), self.inner.glucose_mg_dl(later)
        return jnp.append(later, lagged(self.reading_mg_dl(x), before, now, self.lag_min, self.sample_time_min))

    def advance(self, x: jax.Array, insulin_mU_min: jax.Array) -> jax.Array:
        """State one sample on, under a held infusion."""
        return self._and_reading(x, self.inner.advance(x[:-1], insulin_mU_min))

    def advance_fed(self, x: jax.Array, insulin_mU_min: jax.Array, appearance_mg_min: jax.Array) -> jax.Array:
        """State one sample on, under a held infusion, with glucose from meals."""
        return self._and_reading(x, self.inner.advance_fed(x[:-1], insulin_mU_min, appearance_mg_min))

    def glucose_mg_dl(self, x: jax.Array) -> jax.Array:
        """Glucose of a state, before the lag."""
        return self.inner.glucose_mg_dl(x[:-1])

    def reading_mg_dl(self, x: jax.Array) -> jax.Array:
        """Reading of a sensor without noise."""
        return x[-1]


def behind_lag(model: FedModel, lag_min: float) -> _LaggedModel:
    """A nonlinear model of a person and of a sensor, whose readings lag by a time constant above 0."""
    _check(lag_min)
    return _LaggedModel(inner=model, lag_min=jnp.asarray(lag_min, float))


def linear_behind_lag(model: ContinuousModel, lag_min: float) -> ContinuousModel:
    """A linear model in continuous time whose sensor lags, which `discretise` then samples exactly.

    Lag and errors are those of `behind_lag`.
    """
    _check(lag_min)
    n = model.C.shape[0]

    def extended(row: jax.Array, value: jax.typing.ArrayLike = 0.0) -> jax.Array:
        return jnp.append(row, value)

    return dataclasses.replace(
        model,
        A=jnp.zeros((n + 1, n + 1)).at[:n, :n].set(model.A).at[n].set(extended(model.C, -1.0) / lag_min),
        B=extended(model.B),
        C=extended(model.C),
        E=None if model.E is None else extended(model.E),
        C_reading=extended(jnp.zeros(n), 1.0),
        state=extended(model.state, model.glucose_mg_dl),
    )


def _check(lag_min: float) -> None:
    if not 0.0 < lag_min < float("inf"):
        raise Refusal(f"a lag of the sensor of {lag_min:g} min is not possible; give a finite time above 0")
