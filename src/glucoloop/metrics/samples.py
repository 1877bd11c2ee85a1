"""Numbers of samples at which the controller or its guard met a difficulty."""

from __future__ import annotations

from typing import Any, Final

import jax
import jax.numpy as jnp

from glucoloop.control.protocol import Status
from glucoloop.metrics.protocol import Course, Ended, Metric, count
from glucoloop.simulation.loop import Sampled

_STATUS: Final = {
    "saturated": (Status.SATURATED,),
    "not_converged": (Status.NOT_CONVERGED,),
    "non_finite": (Status.NON_FINITE, Status.RESTARTED, Status.NO_FINITE_DOSE),
    "rejected": (Status.READING_REJECTED,),
    "fallback": (Status.FALLBACK_BASAL, Status.FALLBACK_REDUCED),
    "suspended": (Status.SUSPENDED,),
    "dose_limited": (Status.DOSE_LIMITED,),
}
"""Statuses that are counted together, by the end of the name of the result."""


class Samples(Metric):
    """Numbers of samples with each of some statuses, and without a reading."""

    def init(self, course: Course, glucose_mg_dl: jax.Array, insulin_mU_min: jax.Array) -> dict[str, jax.Array]:
        """Numbers before the first sample."""
        return {name: jnp.zeros_like(glucose_mg_dl) for name in (*_STATUS, "missing")}

    def sample(
        self, course: Course, state: dict[str, jax.Array], happened: Sampled, t_min: jax.Array
    ) -> dict[str, jax.Array]:
        """Numbers with a further sample."""
        status, reading = happened.decision.status, happened.reading
        there = {name: jnp.zeros_like(reading.valid) for name in _STATUS}
        for name, of in _STATUS.items():
            for one in of:
                there[name] = there[name] | (status == one)
        there["missing"] = ~(reading.valid & jnp.isfinite(reading.glucose_mg_dl))
        return {name: number + count(there[name], number) for name, number in state.items()}

    def finish(self, course: Course, state: dict[str, jax.Array], ended: Ended) -> dict[str, Any]:
        """Numbers of samples of the run."""
        return {f"samples_{name}": number.astype(int) for name, number in state.items()}
