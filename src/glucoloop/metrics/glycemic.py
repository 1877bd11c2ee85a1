"""Safety of a course of glucose: times in ranges, variability and risk indices, as diabetes care reports them.

Time stands on the leading axis, on an even grid; people trail. A time is the percentage of the points of the grid, both
ends included; it needs no time axis. A person whose glucose is not finite throughout gets NaN.

References
----------
T. Battelino et al., "Clinical targets for continuous glucose monitoring data interpretation: recommendations from the
international consensus on time in range", Diabetes Care 42(8), 1593-1603, 2019.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike

from glucoloop._pytree import pytree
from glucoloop.metrics._finite import all_or_nan, nan_where_nan


@pytree
class RiskIndices:
    """Low and high blood glucose index."""

    lbgi: jax.Array
    hbgi: jax.Array


def time_below_pct(glucose_mg_dl: ArrayLike, threshold_mg_dl: ArrayLike) -> jax.Array:
    """Percentage of points with ``glucose < threshold``.

    Parameters
    ----------
    glucose_mg_dl : array_like, shape (points, ...)
    threshold_mg_dl : array_like
    """
    glucose = all_or_nan(glucose_mg_dl)
    return nan_where_nan(100.0 * (glucose < threshold_mg_dl).mean(axis=0, dtype=glucose.dtype), glucose[0])


def time_above_pct(glucose_mg_dl: ArrayLike, threshold_mg_dl: ArrayLike) -> jax.Array:
    """Percentage of points with ``glucose > threshold``; arguments as for `time_below_pct`."""
    glucose = all_or_nan(glucose_mg_dl)
    return nan_where_nan(100.0 * (glucose > threshold_mg_dl).mean(axis=0, dtype=glucose.dtype), glucose[0])


def time_between_pct(glucose_mg_dl: ArrayLike, low_mg_dl: ArrayLike, high_mg_dl: ArrayLike) -> jax.Array:
    """Percentage of points with ``low <= glucose <= high``, so that below, between and above add up to 100.

    Parameters
    ----------
    glucose_mg_dl : array_like, shape (points, ...)
    low_mg_dl, high_mg_dl : array_like
    """
    glucose = all_or_nan(glucose_mg_dl)
    inside = (glucose >= low_mg_dl) & (glucose <= high_mg_dl)
    return nan_where_nan(100.0 * inside.mean(axis=0, dtype=glucose.dtype), glucose[0])


def coefficient_of_variation_pct(glucose_mg_dl: ArrayLike) -> jax.Array:
    """Standard deviation, with ``points - 1`` as its denominator, in percent of the mean."""
    glucose = all_or_nan(glucose_mg_dl)
    return 100.0 * glucose.std(axis=0, ddof=1) / glucose.mean(axis=0)


def glucose_management_indicator_pct(mean_glucose_mg_dl: ArrayLike) -> jax.Array:
    """Glycated haemoglobin that such a mean would go with [%]: ``3.31 + 0.02392 mean``.

    References
    ----------
    R. M. Bergenstal et al., "Glucose management indicator (GMI): a new term for estimating A1C from continuous glucose
    monitoring", Diabetes Care 41(11), 2275-2280, 2018.
    """
    return 3.31 + 0.02392 * jnp.asarray(mean_glucose_mg_dl)


def risk_indices(glucose_mg_dl: ArrayLike) -> RiskIndices:
    """Low and high blood glucose index.

    ::

        f = 1.509 (ln(glucose)^1.084 - 5.381),    LBGI = mean(10 min(f, 0)^2),    HBGI = mean(10 max(f, 0)^2)

    The scale is made for 20 to 600 mg/dl, on which the risk ``10 f^2`` falls from 100 to 0 at 112.5 mg/dl and rises to
    100 again. Glucose beyond is taken at the nearer end, since the logarithm fails below 1 mg/dl.

    Parameters
    ----------
    glucose_mg_dl : array_like, shape (points, ...)

    References
    ----------
    B. P. Kovatchev, D. J. Cox, L. A. Gonder-Frederick, W. Clarke, "Symmetrization of the blood glucose measurement
    scale and its applications", Diabetes Care 20(11), 1655-1658, 1997.
    B. P. Kovatchev, M. Straume, D. J. Cox, L. S. Farhy, "Risk analysis of blood glucose data: a quantitative approach
    to optimizing the control of insulin dependent diabetes", J. Theor. Med. 3, 1-10, 2000.
    """
    low, high = risks(all_or_nan(glucose_mg_dl))
    return RiskIndices(lbgi=low.mean(axis=0), hbgi=high.mean(axis=0))


def risks(glucose_mg_dl: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Risk of each glucose to be low, and to be high; `risk_indices` gives their means."""
    f = 1.509 * (jnp.log(jnp.clip(glucose_mg_dl, 20.0, 600.0)) ** 1.084 - 5.381)
    return 10.0 * jnp.minimum(f, 0.0) ** 2, 10.0 * jnp.maximum(f, 0.0) ** 2


def glycemia_risk_index(glucose_mg_dl: ArrayLike) -> jax.Array:
    """One number from 0 (best) to 100: ``min(100, 3 VLow + 2.4 Low + 1.6 VHigh + .8 High)``.

    VLow, Low, High, VHigh are the percentages of points below 54, from 54 to below 70, above 180 to 250, and above
    250 mg/dl.

    References
    ----------
    D. C. Klonoff et al., "A glycemia risk index (GRI) of hypoglycemia and hyperglycemia for continuous glucose
    monitoring validated by clinician ratings", J. Diabetes Sci. Technol. 17(5), 1226-1242, 2023.
    """
    very_low, very_high = time_below_pct(glucose_mg_dl, 54.0), time_above_pct(glucose_mg_dl, 250.0)
    low = time_below_pct(glucose_mg_dl, 70.0) - very_low
    high = time_above_pct(glucose_mg_dl, 180.0) - very_high
    return risk_index_of_pct(very_low, low, high, very_high)


def risk_index_of_pct(very_low: ArrayLike, low: ArrayLike, high: ArrayLike, very_high: ArrayLike) -> jax.Array:
    """Glycemia risk index from the four percentages."""
    very_low, low, high, very_high = (jnp.asarray(pct) for pct in (very_low, low, high, very_high))
    return jnp.minimum(3.0 * very_low + 2.4 * low + 1.6 * very_high + 0.8 * high, 100.0)
