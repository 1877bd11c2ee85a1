"""Discrete internal model control with a filter, on a first-order model with dead time.

Parker, Doyle and Peppas (1999), Sec. VII, compare with the controller of Sorensen (1985); the design is in M. Morari,
E. Zafiriou, Robust Process Control, 1989, ch. 4 and 8.
"""

from __future__ import annotations

import math
from dataclasses import KW_ONLY
from typing import Annotated, Any, ClassVar

from glucoloop._lazy_jax import jax, jnp
from glucoloop._pytree import pytree
from glucoloop.arguments import ArgumentTypeError, checked, is_traced
from glucoloop.component.effects import ONLY_READINGS
from glucoloop.component.pytree_component import DATA, HOST, STATIC, wired
from glucoloop.component.setting import About
from glucoloop.control.decision import decide, delivered_since, is_known, rate_at_start
from glucoloop.control.design_case import DesignCase, check_gain, check_number, check_sample_time
from glucoloop.control.part import ControllerComponent, FittedStep
from glucoloop.control.protocol import Decision, Observation
from glucoloop.pumps.limits import PARKER_1999_LIMITS, DoseLimits
from glucoloop.refusal import Refusal


@pytree
class _IMCState:
    """State of the controller; deviations from its initial operating point."""

    model_mg_dl: jax.Array
    """Output of the internal model."""
    filtered_mg_dl: jax.Array
    """Filtered change of glucose asked of the model."""
    pending_mU_min: jax.Array
    """(delay, ...) delivered rates that have not reached the model's output yet, the oldest first."""
    error_mg_dl: jax.Array
    basal_mU_min: jax.Array
    insulin_mU_min: jax.Array


class IMC(ControllerComponent, name="imc"):
    """Internal model control with a filter, on a first-order model with dead time.

    The model is ``y_k = a y_(k-1) + b u_(k-1-d)`` with ``a = exp(-T / tau)`` and ``b = K (1 - a)``. With the filter
    ``v_k = f v_(k-1) + (1 - f) e_k``, ``f = exp(-T / lambda)``, on the error ``e = y_model - (y - r)``, the
    controller inverts the model without its dead time: ``u_k = u_0 + (v_k - a v_(k-1)) / b``.
    """

    sources = ("parker1999", "sorensen1985", "morari1989")
    used: ClassVar = ONLY_READINGS
    uses_model: ClassVar = False
    role_of_settings: ClassVar = HOST
    memory_bound: ClassVar[float] = 1e4
    """Bound on its memory for a guard: glucose is below 1000 mg/dl, and rates below 10 000 mU/min (600 U/h)."""

    filter_min: Annotated[float, About("Time constant of the filter, λ, in minutes.", above=0.0)] = 1.0
    delay_min: Annotated[float, About("Dead time of the first-order model, in minutes.", at_least=0.0)] = 5.0
    step_mU_min: FittedStep = 0.0
    _: KW_ONLY
    pole: jax.Array | float = wired(DATA, default=None)
    gain: jax.Array | float = wired(DATA, default=None)
    filter_pole: jax.Array | float = wired(DATA, default=None)
    limits: DoseLimits = wired(DATA, default=PARKER_1999_LIMITS)
    delay_samples: int = wired(STATIC, default=0)
    sample_time_min: float = wired(STATIC, default=5.0)

    def designed(self, case: DesignCase) -> IMC:
        """IMC on a first-order model of the patient; a known dead time is added to the model's own."""
        model = case.first_order(self.step_mU_min or None, self.delay_min)
        return self.of_model(
            float(model.gain),
            float(model.tau_min),
            self.delay_min + case.dead_time_samples * case.sample_time_min,
            case.limits,
            sample_time_min=case.sample_time_min,
        )

    def of_model(
        self, gain: float, tau_min: float, delay_min: float, limits: DoseLimits, *, sample_time_min: float
    ) -> IMC:
        """The controller on a first-order model, of which the dead time is `delay_min`; see `design_imc`."""
        check_sample_time(sample_time_min)
        check_gain(gain)
        check_number("lag", tau_min, "min")
        check_number("filter", self.filter_min, "min")
        if is_traced(delay_min):
            raise ArgumentTypeError(
                "delay_min is traced by JAX, but it decides how many doses the controller remembers; "
                "give a plain number"
            )
        delay = round(delay_min / sample_time_min) if math.isfinite(delay_min) else -1
        if delay < 0 or abs(delay * sample_time_min - delay_min) > 1e-9:
            raise Refusal(
                f"a dead time of {delay_min:g} min is not possible; "
                f"give a multiple of the sample time, {sample_time_min:g} min"
            )
        exp: Any = jnp.exp if is_traced(tau_min, self.filter_min) else math.exp
        a = exp(-sample_time_min / tau_min)
        controller: IMC = self.made(
            pole=a,
            gain=gain * (1.0 - a),
            filter_pole=exp(-sample_time_min / self.filter_min),
            limits=limits,
            delay_samples=delay,
            sample_time_min=sample_time_min,
        )
        return controller

    def settled(self) -> dict[str, Any]:
        """Model, with its gain in mg/dl per mU/min, and the filter."""
        return {
            "gain": self.gain / (1.0 - self.pole),
            "tau_min": -self.sample_time_min / math.log(self.pole),
            "delay_min": self.delay_samples * self.sample_time_min,
            "filter_min": -self.sample_time_min / math.log(self.filter_pole),
        }

    def init(self, observation: Observation) -> _IMCState:
        """State of a controller at steady state under the delivered rate."""
        delivered = rate_at_start(observation, self.limits.min_mU_min)
        zero = jnp.zeros_like(delivered)
        return _IMCState(
            model_mg_dl=zero,
            filtered_mg_dl=zero,
            pending_mU_min=jnp.zeros((self.delay_samples, *delivered.shape), delivered.dtype),
            error_mg_dl=zero,
            basal_mU_min=delivered,
            insulin_mU_min=delivered,
        )

    def step(self, state: _IMCState, observation: Observation) -> tuple[_IMCState, Decision]:
        """Advance the model with the delivered rate, compare it with the reading, invert it without its dead time."""
        delivered = delivered_since(observation, state.insulin_mU_min)
        line = jnp.concatenate([state.pending_mU_min, (delivered - state.basal_mU_min)[None]])
        model = self.pole * state.model_mg_dl + self.gain * line[0]
        known = is_known(observation)
        error = model - (observation.glucose_mg_dl - observation.setpoint_mg_dl)
        # Without a reading or a setpoint there is no error to take in; the filter would never forget what is no number.
        error = jnp.where(known & jnp.isfinite(error), error, state.error_mg_dl)
        filtered = self.filter_pole * state.filtered_mg_dl + (1.0 - self.filter_pole) * error
        wanted = state.basal_mU_min + (filtered - self.pole * state.filtered_mg_dl) / self.gain
        state = _IMCState(
            model_mg_dl=model,
            filtered_mg_dl=filtered,
            pending_mU_min=line[1:],
            error_mg_dl=error,
            basal_mU_min=state.basal_mU_min,
            insulin_mU_min=delivered,
        )
        return state, decide(wanted, delivered, self.limits, known)


@checked
def design_imc(
    gain: float,
    tau_min: float,
    delay_min: float,
    limits: DoseLimits = PARKER_1999_LIMITS,
    *,
    filter_min: float = IMC.filter_min,
    sample_time_min: float = 5.0,
) -> IMC:
    """`IMC` on a first-order model with dead time.

    Parameters
    ----------
    gain : float
        Gain K of the model, mg/dl per mU/min; below 0, since insulin lowers glucose.
    tau_min : float
        Lag tau of the model, above 0.
    delay_min : float
        Dead time of the model, a whole number d of samples; the hold itself is not counted.
    limits : DoseLimits
        Limits of the pump, by default those of 1999; give ``gl.usual_limits(patient)`` for another patient.
    filter_min : float
        Time constant lambda of the filter, above 0.
    sample_time_min : float
        Sample time T, above 0.

    Examples
    --------
    >>> controller = design_imc(-3.45, 89.1, 5.0)
    >>> round(float(controller.pole), 4), controller.delay_samples
    (0.9454, 1)
    """
    return (
        IMC()
        .replaced(filter_min=filter_min)
        .of_model(gain, tau_min, delay_min, limits, sample_time_min=sample_time_min)
    )
