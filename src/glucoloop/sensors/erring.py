"""Sensor with given errors, sample by sample, whose reading is stuck during given stretches of time.

A search for the worst errors puts it around a sensor: the errors are data, so that one compiled program tries thousands
of sequences.
"""

from __future__ import annotations

from typing import Any

from glucoloop._lazy_jax import jax, jnp, np, npt
from glucoloop._pytree import pytree
from glucoloop.refusal import Refusal
from glucoloop.sensors.protocol import IdealSensor, Reading, Sensor


@pytree
class _State:
    inner: Any
    errors: jax.Array
    """(samples, ...) errors of the coming samples, the next first."""
    index: jax.Array
    """Number of the next sample, as a float."""
    last: Reading


@pytree
class Erring:
    """Multiplies the reading of the inner sensor by one plus an error; make it with `erring`."""

    inner: Sensor
    errors: jax.Array
    """(samples, ...) relative error of each reading; the last one stays for all samples after it."""
    stuck_from: jax.Array
    """(stretches, ...) number of the sample from which on the reading stays as it is."""
    stuck_samples: jax.Array | float
    """Number of equal readings in each stretch, the first one included."""

    def init(self, glucose_mg_dl: jax.Array, key: jax.Array) -> _State:
        """State before the first reading."""
        zero = jnp.zeros_like(glucose_mg_dl)
        return _State(
            inner=self.inner.init(glucose_mg_dl, key),
            errors=jnp.asarray(self.errors, zero.dtype),
            index=zero,
            last=Reading(glucose_mg_dl=glucose_mg_dl, valid=jnp.ones(jnp.shape(glucose_mg_dl), bool)),
        )

    def read(self, state: _State, glucose_mg_dl: jax.Array, key: jax.Array) -> tuple[_State, Reading]:
        """Read the inner sensor with the error of this sample, or repeat the last reading while it is stuck."""
        inner, reading = self.inner.read(state.inner, glucose_mg_dl, key)
        since = state.index - self.stuck_from
        stuck = jnp.any((since > 0.0) & (since < self.stuck_samples), axis=0)
        reported = Reading(
            glucose_mg_dl=jnp.where(stuck, state.last.glucose_mg_dl, reading.glucose_mg_dl * (1.0 + state.errors[0])),
            valid=jnp.where(stuck, state.last.valid, reading.valid),
        )
        errors = jnp.concatenate([state.errors[1:], state.errors[-1:]])
        return _State(inner=inner, errors=errors, index=state.index + 1.0, last=reported), reported


def erring(
    errors: npt.ArrayLike,
    stuck_from: npt.ArrayLike = (),
    stuck_samples: int = 1,
    inner: Sensor | None = None,
) -> Erring:
    """Sensor with given errors.

    Parameters
    ----------
    errors : (samples,) or (samples, people) array
        Relative error of each reading: 0.1 reads 10 % too high. The last one stays for all samples after it.
    stuck_from : (stretches,) or (stretches, people) array
        Numbers of the samples from which on the reading stays as it is; the first sample is number 0.
    stuck_samples : int
        Number of equal readings in each stretch, the first one included.
    inner : Sensor, optional
        Sensor to which the errors are added; an ideal sensor by default.

    Raises
    ------
    ValueError
        For no error, one that is not finite or makes readings negative, or a stretch that cannot be.
    """
    each, first = np.asarray(errors, float), np.asarray(stuck_from, float)
    if each.ndim == 0 or not each.shape[0]:
        raise Refusal("there is no error for any sample; give at least one, which then holds for all")
    if not np.all(np.isfinite(each) & (each >= -1.0)):
        worst = each[~(np.isfinite(each) & (each >= -1.0))].flat[0]
        raise Refusal(f"a relative error of {worst:g} is not possible; give finite numbers of -1 or more")
    if not np.all(np.isfinite(first) & (first >= 0.0) & (first == np.floor(first))):
        raise Refusal(f"{stuck_from!r} are no numbers of samples; give whole numbers of 0 or more")
    if isinstance(stuck_samples, bool) or not isinstance(stuck_samples, int) or stuck_samples < 1:
        raise Refusal(f"{stuck_samples!r} readings of a stretch are not possible; give a whole number of 1 or more")
    return Erring(
        inner=IdealSensor() if inner is None else inner,
        errors=jnp.asarray(each),
        stuck_from=jnp.asarray(first),
        stuck_samples=float(stuck_samples),
    )
