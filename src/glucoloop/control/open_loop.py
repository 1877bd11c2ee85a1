"""Open loop at a constant rate, the baseline of every comparison."""

from __future__ import annotations

from dataclasses import KW_ONLY
from typing import ClassVar

from glucoloop._lazy_jax import jax, jnp
from glucoloop.arguments import checked
from glucoloop.component.pytree_component import DATA, STATIC, wired
from glucoloop.control.decision import decide, delivered_since, is_known, rate_at_start
from glucoloop.control.design_case import check_rate, check_sample_time
from glucoloop.control.part import ControllerComponent
from glucoloop.control.protocol import Decision, Observation
from glucoloop.pumps.limits import PARKER_1999_LIMITS, DoseLimits


class OpenLoop(ControllerComponent, name="basal"):
    """The rate at which the loop starts, without a controller; see `design_open_loop` for another one."""

    uses_model: ClassVar = False
    on_equations: ClassVar = False
    individual: ClassVar = None
    used: ClassVar = frozenset()

    _: KW_ONLY
    insulin_mU_min: jax.Array | None = wired(DATA, default=None)
    limits: DoseLimits = wired(DATA, default=PARKER_1999_LIMITS)
    sample_time_min: float = wired(STATIC, default=5.0)

    def init(self, observation: Observation) -> jax.Array:
        """State of the controller: the rate to keep."""
        if self.insulin_mU_min is None:
            return rate_at_start(observation, self.limits.min_mU_min)
        return jnp.broadcast_to(self.insulin_mU_min, observation.delivered_mU_min.shape)

    def step(self, state: jax.Array, observation: Observation) -> tuple[jax.Array, Decision]:
        """Keep the rate; the reading is not used, but a missing one is reported."""
        delivered = delivered_since(observation, state)
        return state, decide(state, delivered, self.limits, is_known(observation))


@checked
def design_open_loop(
    insulin_mU_min: float | None = None,
    limits: DoseLimits = PARKER_1999_LIMITS,
    *,
    sample_time_min: float = 5.0,
) -> OpenLoop:
    """Open loop with a constant infusion.

    Parameters
    ----------
    insulin_mU_min : float, optional
        Rate; by default that at which the loop starts, the patient's basal rate.
    limits : DoseLimits
        Limits of the pump, by default those of 1999; give ``gl.usual_limits(patient)`` for another patient.

    Raises
    ------
    ValueError
        For a rate outside the limits, or a sample time that is not possible.
    """
    check_sample_time(sample_time_min)
    if insulin_mU_min is None:
        return OpenLoop(insulin_mU_min=None, limits=limits, sample_time_min=sample_time_min)
    check_rate("constant", insulin_mU_min, limits)
    return OpenLoop(insulin_mU_min=jnp.asarray(insulin_mU_min), limits=limits, sample_time_min=sample_time_min)
