"""Effect of doses and meals on glucose between the origin of a forecast and its horizon, by a response curve."""

from __future__ import annotations

from typing import TYPE_CHECKING

from glucoloop._lazy_jax import np, scipy

if TYPE_CHECKING:
    from glucoloop.forecasts.grid import Values


def effect_of_history(amounts: Values, curve: Values, horizon: int) -> Values:
    """Change of glucose from each sample to `horizon` samples later by the amounts up to that sample, ``(samples,)``.

    `curve` is the effect of one unit 0, 1, 2, ... samples after it, and stays at its last value.
    """
    size = amounts.size
    whole = _extended(curve, size + horizon)
    return _convolved(amounts, whole[horizon : size + horizon] - whole[:size])


def effect_of_future(amounts: Values, curve: Values, horizon: int) -> Values:
    """Effect `horizon` samples after each sample of the amounts in between, ``(samples,)``; 0 beyond the last one."""
    size = amounts.size
    effects = _convolved(amounts, _extended(curve, horizon))
    result = np.zeros(size)
    result[: max(size - horizon, 0)] = effects[horizon:]
    return result


def _extended(curve: Values, size: int) -> Values:
    return np.concatenate([curve, np.full(max(size - curve.size, 0), curve[-1])])[:size]


def _convolved(amounts: Values, kernel: Values) -> Values:
    """Causal convolution; the end of the kernel that stays 0 is left out."""
    there = np.flatnonzero(kernel)
    if not there.size or not amounts.any():
        return np.zeros(amounts.size)
    result: Values = scipy.signal.oaconvolve(amounts, kernel[: there[-1] + 1])[: amounts.size]
    return result
