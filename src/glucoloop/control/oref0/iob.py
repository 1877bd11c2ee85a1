"""Insulin on board and its activity, by the exponential curve (``iob/calculate.js``, ``iob/total.js``).

With the peak ``tp`` and the end ``td`` of insulin action, after L. Maksimovic (LoopKit/Loop, discussion 388)::

    tau = tp (1 - tp/td) / (1 - 2 tp/td),   a = 2 tau/td,   S = 1 / (1 - a + (1 + a) exp(-td/tau))
    activity(t) = S/tau^2 t (1 - t/td) exp(-t/tau)
    IOB(t) = 1 - S (1 - a) ((t^2 / (tau td (1 - a)) - t/tau - 1) exp(-t/tau) + 1)

The original cuts the insulin of temporary basal rates into pulses of 0.05 U (``iob/history.js``). Here the insulin that
the pump reports for a sample, less the basal rate, is one treatment at the start of that sample.
"""

from __future__ import annotations

import math
from typing import Final, TypeAlias

from glucoloop._lazy_jax import jax, jnp, np, npt
from glucoloop.control.oref0.records import InsulinOnBoard
from glucoloop.control.oref0.rounding import rounded

SAMPLE_MIN: Final = 5
TICKS: Final = 48
"""Number of points of 5 min for which activity is predicted, four hours."""
PEAKS_MIN: Final = {"rapid-acting": 75.0, "ultra-rapid": 55.0}
"""Time of the peak by kind of insulin."""
Floats: TypeAlias = "npt.NDArray[np.float64]"


def treatments(dia_h: float) -> int:
    """Number of samples of which insulin is still at work, this one included."""
    return math.ceil(dia_h * 60.0 / SAMPLE_MIN)


def insulin_curve(minutes: Floats, dia_h: float, peak_min: float) -> tuple[Floats, Floats]:
    """Insulin on board [U] and activity [U/min] of 1 U, some minutes after it was given; 0 from the end on."""
    end, t = 60.0 * dia_h, minutes
    tau = peak_min * (1.0 - peak_min / end) / (1.0 - 2.0 * peak_min / end)
    a = 2.0 * tau / end
    S = 1.0 / (1.0 - a + (1.0 + a) * math.exp(-end / tau))
    fades = np.exp(-t / tau)
    activity = S / tau**2 * t * (1.0 - t / end) * fades
    on_board = 1.0 - S * (1.0 - a) * ((t**2 / (tau * end * (1.0 - a)) - t / tau - 1.0) * fades + 1.0)
    return np.where(t < end, on_board, 0.0), np.where(t < end, activity, 0.0)


def iob_total(
    insulin_U: jax.Array,
    current_basal_U_h: jax.Array | float,
    last_bolus_age_min: jax.Array,
    *,
    dia_h: float,
    peak_min: float,
) -> InsulinOnBoard:
    """Insulin on board of treatments ``(treatments,)`` every 5 min, of which the first is now and the last the oldest.

    Activity is predicted for insulin that was given, and for no basal insulin from now on (``iobWithZeroTemp``).
    """
    count = treatments(dia_h)
    on_board, activity = insulin_curve(SAMPLE_MIN * np.arange(count + TICKS, dtype=float), dia_h, peak_min)
    ahead = activity[np.arange(TICKS)[:, None] + np.arange(count)]
    # A sample without basal insulin begins now and at each tick before the one that is looked at.
    missing = np.r_[0.0, np.cumsum(activity[1:TICKS])]
    basal = jnp.asarray(current_basal_U_h) * (SAMPLE_MIN / 60.0)
    given = _summed(ahead, insulin_U)
    by_basal = jnp.asarray(missing, insulin_U.dtype).reshape((TICKS,) + (1,) * (given.ndim - 1))
    given, without = rounded(given, 4), rounded(given - by_basal * basal, 4)
    return InsulinOnBoard(
        iob_U=rounded(_summed(on_board[:count], insulin_U), 3),
        activity_U_min=given[0],
        ahead_U_min=given,
        zero_temp_ahead_U_min=without,
        last_bolus_age_min=last_bolus_age_min,
    )


def _summed(weights: Floats, insulin_U: jax.Array) -> jax.Array:
    """Sums over treatments, weighted; constants have the precision of the insulin."""
    return jnp.tensordot(jnp.asarray(weights, insulin_U.dtype), insulin_U, 1)
