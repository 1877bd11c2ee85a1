"""A model at steady state with a disturbance: glucose that appears, or is lost, for no known reason."""

from __future__ import annotations

from typing import Final

from glucoloop._lazy_jax import jax, jit, jnp, np, npt
from glucoloop._pytree import pytree
from glucoloop.meals.stomach import Stomach, steadily
from glucoloop.models.nonlinear import FedModel, reading_of
from glucoloop.refusal import Refusal

LARGEST_INNOVATION_MG_DL: Final = 30.0
"""Largest innovation by which a reading corrects an estimate."""
_REST_MG: Final = 2000.0
"""Content of the gut that is small beside a meal's: the plateau of the emptying fills it to 21 600 mg."""
_FARTHEST_MG_DL: Final = 300.0
"""Largest distance of an accepted reading from the glucose at which the model rests."""
_BELIEVED: Final = 5.0
"""Number of standard deviations within which a reading is accepted; more is not explained by noise."""


def fading(disturbance_mg_min: jax.Array, before: Stomach, after: Stomach) -> jax.Array:
    """The disturbance a sample later: the part that appears beyond a meal fades as the meal is digested.

    The meal of the model may be smaller or slower than the person's. The difference is in the disturbance, and would
    stay there after the meal if it did not shrink as the gut empties. At rest it stays as it is.
    """
    share = (after.gut_mg + _REST_MG) / (before.gut_mg + _REST_MG)
    return jnp.where(disturbance_mg_min > 0.0, disturbance_mg_min * jnp.clip(share, 0.0, 1.0), disturbance_mg_min)


@pytree
class _Linearised:
    """A model about its rest, with the disturbance as its last state: ``x+ = Phi x``, and a reading ``C x``."""

    Phi: npt.NDArray[np.float64]
    """(n + 1, n + 1) transition matrix."""
    C: npt.NDArray[np.float64]
    """(n + 1,) output row of the sensor."""
    Gamma: npt.NDArray[np.float64]
    """(n,) effect of insulin."""


@jit()
def _slopes(model: FedModel, x: jax.Array, u: jax.Array) -> tuple[jax.Array, ...]:
    def sample(x: jax.Array, u: jax.Array, d: jax.Array) -> jax.Array:
        return model.advance_fed(x, u, steadily(d))

    return *jax.jacfwd(sample, argnums=(0, 1, 2))(x, u, jnp.zeros(())), jax.jacfwd(reading_of(model))(x)


def linearised(model: FedModel) -> _Linearised:
    """Linearise a model about its rest, by forward-mode differentiation of one sample."""
    x, u = model.state, jnp.asarray(model.insulin_mU_min, float)
    Phi, Gamma, Psi, C = (np.asarray(part) for part in _slopes(model, x, u))
    n = x.shape[0]
    return _Linearised(
        Phi=np.block([[Phi, Psi[:, None]], [np.zeros((1, n)), np.ones((1, 1))]]),
        C=np.append(C, 0.0),
        Gamma=Gamma,
    )


@pytree
class Waking:
    """Initial estimate for a person whose glucose is not that at which the model rests."""

    by_insulin: jax.Array
    """(n,) steady state per mU/min."""
    by_disturbance: jax.Array
    """(n,) steady state per mg/min of appearance."""
    glucose_by_disturbance: jax.Array
    noise_mg_dl: jax.Array
    """Standard deviation of a reading."""

    def wake(
        self, model: FedModel, insulin_mU_min: jax.Array, glucose_mg_dl: jax.Array, known: jax.Array
    ) -> tuple[jax.Array, jax.Array]:
        """Steady state and disturbance under a rate that explain the part of a reading that noise does not."""
        x = model.state + self.by_insulin * (insulin_mU_min - model.insulin_mU_min)
        away = jnp.where(known, glucose_mg_dl - model.glucose_mg_dl(x), 0.0)
        away = jnp.clip(away, -_FARTHEST_MG_DL, _FARTHEST_MG_DL)
        unexplained = jnp.sign(away) * jnp.maximum(jnp.abs(away) - _BELIEVED * self.noise_mg_dl, 0.0)
        disturbance = unexplained / self.glucose_by_disturbance
        return x + self.by_disturbance * disturbance, disturbance


def waking(linear: _Linearised, measurement_variance: float) -> Waking:
    """Prepare the initial estimate from a linearised model."""
    n = linear.Gamma.size
    still = np.eye(n) - linear.Phi[:n, :n]
    by_disturbance = np.linalg.solve(still, linear.Phi[:n, n])
    return Waking(
        by_insulin=jnp.asarray(np.linalg.solve(still, linear.Gamma)),
        by_disturbance=jnp.asarray(by_disturbance),
        glucose_by_disturbance=jnp.asarray(linear.C[:n] @ by_disturbance),
        noise_mg_dl=jnp.sqrt(jnp.asarray(measurement_variance)),
    )


def check_variances(disturbance_variance: float, measurement_variance: float) -> None:
    """Refuse variances that are not positive and finite."""
    for value, what in ((disturbance_variance, "disturbance"), (measurement_variance, "measurement")):
        if not 0.0 < value < np.inf:
            raise Refusal(f"a {what} variance of {value:g} is not possible; give a finite value above 0")
