"""Low and high blood glucose index.

References
----------
B. P. Kovatchev, D. J. Cox, L. A. Gonder-Frederick, W. Clarke, "Symmetrization of the blood glucose measurement scale
and its applications", Diabetes Care 20(11), 1655-1658, 1997.
B. P. Kovatchev, M. Straume, D. J. Cox, L. S. Farhy, "Risk analysis of blood glucose data: a quantitative approach to
optimizing the control of insulin dependent diabetes", J. Theor. Med. 3, 1-10, 2000.
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp

from glucoloop._pytree import pytree
from glucoloop.metrics.protocol import Course, Ended, Metric


@pytree
class _Risks:
    """Sums over the grid."""

    low: jax.Array
    high: jax.Array


class RiskIndices(Metric):
    """Means over the grid of the risk to be low and of the risk to be high.

    ::

        f = 1.509 (ln(glucose)^1.084 - 5.381),    LBGI = mean(10 min(f, 0)^2),    HBGI = mean(10 max(f, 0)^2)

    The scale is made for 20 to 600 mg/dl, on which the risk ``10 f^2`` falls from 100 to 0 at 112.5 mg/dl and rises to
    100 again. Glucose beyond is taken at the nearer end, since the logarithm fails below 1 mg/dl.
    """

    def init(self, course: Course, glucose_mg_dl: jax.Array, insulin_mU_min: jax.Array) -> _Risks:
        """Sums of no points."""
        zero = jnp.zeros_like(glucose_mg_dl)
        return _Risks(low=zero, high=zero)

    def point(self, course: Course, state: _Risks, glucose_mg_dl: jax.Array, t_min: jax.Array) -> _Risks:
        """Sums with a further point of the grid."""
        f = 1.509 * (jnp.log(jnp.clip(glucose_mg_dl, 20.0, 600.0)) ** 1.084 - 5.381)
        return _Risks(
            low=state.low + 10.0 * jnp.minimum(f, 0.0) ** 2, high=state.high + 10.0 * jnp.maximum(f, 0.0) ** 2
        )

    def finish(self, course: Course, state: _Risks, ended: Ended) -> dict[str, Any]:
        """Means over the points of the grid."""
        return {
            "lbgi": ended.of_glucose(state.low / ended.points),
            "hbgi": ended.of_glucose(state.high / ended.points),
        }
