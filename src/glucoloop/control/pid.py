"""PID control in velocity form, tuned by hand or from a first-order model with dead time.

D. E. Rivera, M. Morari, S. Skogestad, "Internal model control. 4. PID controller design", Ind. Eng. Chem. Process Des.
Dev. 25(1), 1986.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp

from glucoloop._pytree import pytree, static
from glucoloop.arguments import checked, is_traced
from glucoloop.control.decision import decide, delivered_since, is_known, rate_at_start
from glucoloop.control.design_case import DesignCase
from glucoloop.control.protocol import Decision, Observation
from glucoloop.control.settings import PIDSettings
from glucoloop.control.tuning import check_gain, check_sample_time
from glucoloop.pumps.limits import PARKER_1999_LIMITS, DoseLimits
from glucoloop.refusal import Refusal


@checked
@dataclass(frozen=True)
class PIDTuning:
    """Parameters of a PID controller.

    Parameters
    ----------
    gain_mU_min_per_mg_dl : float
        Insulin for each mg/dl above the setpoint, above 0.
    integral_time_min : float
        Integral time, above 0; infinite for no integral action.
    derivative_time_min : float
        Derivative time, 0 or more.

    Raises
    ------
    ValueError
        Outside these bounds.
    """

    gain_mU_min_per_mg_dl: float
    integral_time_min: float
    derivative_time_min: float = 0.0

    def __post_init__(self) -> None:
        if not is_traced(self.gain_mU_min_per_mg_dl) and not 0.0 < self.gain_mU_min_per_mg_dl < math.inf:
            raise Refusal(
                f"a gain of {self.gain_mU_min_per_mg_dl:g} mU/min per mg/dl is not possible; "
                "give a finite value above 0"
            )
        if not is_traced(self.integral_time_min) and not self.integral_time_min > 0.0:
            raise Refusal(f"an integral time of {self.integral_time_min:g} min is not possible; give a value above 0")
        if not is_traced(self.derivative_time_min) and not 0.0 <= self.derivative_time_min < math.inf:
            raise Refusal(
                f"a derivative time of {self.derivative_time_min:g} min is not possible; "
                "give a finite value of 0 or more"
            )


@checked
def internal_model_tuning(gain: float, tau_min: float, delay_min: float, closed_loop_min: float) -> PIDTuning:
    """Tuning for a first-order model with dead time.

    Parameters
    ----------
    gain : float
        Gain of the model, mg/dl per mU/min; below 0, since insulin lowers glucose.
    tau_min, delay_min : float
        Lag and dead time of the model.
    closed_loop_min : float
        Desired time constant of the loop, above 0.

    Raises
    ------
    ValueError
        For a gain that is not below 0 or a time that is not possible.
    """
    check_gain(gain)
    known = not is_traced(tau_min, delay_min, closed_loop_min)
    if known and not (tau_min > 0.0 and delay_min >= 0.0 and closed_loop_min > 0.0):
        raise Refusal(
            f"a lag of {tau_min:g}, a dead time of {delay_min:g} and a closed loop of {closed_loop_min:g} min are not "
            "possible together; give a lag and a closed loop above 0 and a dead time of 0 or more"
        )
    half = delay_min / 2.0
    return PIDTuning(
        gain_mU_min_per_mg_dl=(tau_min + half) / (-gain * (closed_loop_min + half)),
        integral_time_min=tau_min + half,
        derivative_time_min=tau_min * half / (tau_min + half),
    )


@pytree
class PIDState:
    """Last two readings, the setpoint at the last one, and the rate in force."""

    last_mg_dl: jax.Array
    before_last_mg_dl: jax.Array
    setpoint_mg_dl: jax.Array
    insulin_mU_min: jax.Array


@pytree
class PID:
    """PID controller; see `design_pid`."""

    proportional: jax.Array | float
    integral: jax.Array | float
    derivative: jax.Array | float
    limits: DoseLimits
    sample_time_min: float = static()

    def settled(self) -> dict[str, Any]:
        """Gain in mU/min per mg/dl, and times."""
        gain, sample_time_min = self.proportional, self.sample_time_min
        integral = {"integral_time_min": gain * sample_time_min / self.integral} if self.integral else {}
        return {"gain": gain, **integral, "derivative_time_min": self.derivative * sample_time_min / gain}

    def init(self, observation: Observation) -> PIDState:
        """State in which earlier readings equal the first one."""
        reading = jnp.where(is_known(observation), observation.glucose_mg_dl, observation.setpoint_mg_dl)
        return PIDState(
            last_mg_dl=reading,
            before_last_mg_dl=reading,
            setpoint_mg_dl=jnp.broadcast_to(observation.setpoint_mg_dl, reading.shape),
            insulin_mU_min=rate_at_start(observation, self.limits.min_mU_min),
        )

    def step(self, state: PIDState, observation: Observation) -> tuple[PIDState, Decision]:
        """Change the rate from the delivered one, so that the integral does not wind up."""
        delivered = delivered_since(observation, state.insulin_mU_min)
        known = is_known(observation)
        y = jnp.where(known, observation.glucose_mg_dl, state.last_mg_dl)
        setpoint = jnp.broadcast_to(observation.setpoint_mg_dl, y.shape)
        error, last_error = y - setpoint, state.last_mg_dl - state.setpoint_mg_dl
        bend = y - 2.0 * state.last_mg_dl + state.before_last_mg_dl
        move = self.proportional * (error - last_error) + self.integral * error + self.derivative * bend
        # A held reading says nothing about the error now: no move is made on it.
        move = jnp.where(known, move, 0.0)
        state = PIDState(
            last_mg_dl=y,
            before_last_mg_dl=jnp.where(known, state.last_mg_dl, state.before_last_mg_dl),
            setpoint_mg_dl=jnp.where(known, setpoint, state.setpoint_mg_dl),
            insulin_mU_min=delivered,
        )
        return state, decide(delivered + move, delivered, self.limits, known)


@checked
def design_pid(tuning: PIDTuning, limits: DoseLimits = PARKER_1999_LIMITS, *, sample_time_min: float = 5.0) -> PID:
    """PID controller in velocity form, with the derivative on the reading.

    With the error ``e = y - r`` each sample moves insulin by::

        K_c ( e_k - e_(k-1) + (T / T_I) e_k + (T_D / T) (y_k - 2 y_(k-1) + y_(k-2)) )

    from what the pump delivered, so the integral cannot wind up.

    ============  =========================  ====
    variable      meaning                    size
    ============  =========================  ====
    ``K_c``       gain                       1
    ``T_I, T_D``  integral, derivative time  1
    ``T``         sample time                1
    ============  =========================  ====

    Parameters
    ----------
    tuning : PIDTuning
    limits : DoseLimits
    sample_time_min : float
        Sample time, above 0.

    Raises
    ------
    ValueError
        For a sample time that is not possible.

    Examples
    --------
    >>> controller = design_pid(internal_model_tuning(-3.45, 89.1, 5.0, 30.0))
    >>> round(float(controller.proportional), 3)
    0.817
    """
    check_sample_time(sample_time_min)
    return PID(
        proportional=tuning.gain_mU_min_per_mg_dl,
        integral=tuning.gain_mU_min_per_mg_dl * sample_time_min / tuning.integral_time_min,
        derivative=tuning.gain_mU_min_per_mg_dl * tuning.derivative_time_min / sample_time_min,
        limits=limits,
        sample_time_min=sample_time_min,
    )


def design(case: DesignCase, settings: PIDSettings) -> PID:
    """PID; what is not given comes from a first-order model of the patient, a known dead time included."""
    model = case.first_order(settings.step_mU_min or None)
    delay_min = float(model.delay_min) + case.dead_time_samples * case.sample_time_min
    fitted = internal_model_tuning(float(model.gain), float(model.tau_min), delay_min, settings.closed_loop_min)
    derivative_time_min = settings.derivative_time_min
    tuning = PIDTuning(
        gain_mU_min_per_mg_dl=settings.gain or fitted.gain_mU_min_per_mg_dl,
        integral_time_min=settings.integral_time_min or fitted.integral_time_min,
        derivative_time_min=fitted.derivative_time_min if derivative_time_min == -1.0 else derivative_time_min,
    )
    return design_pid(tuning, case.limits, sample_time_min=case.sample_time_min)
