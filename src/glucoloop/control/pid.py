"""PID control whose integral never winds up, tuned by hand or from a first-order model with dead time.

K. J. Astrom, L. Rundqwist, "Integrator windup and how to avoid it", Proc. American Control Conference, 1989, 1693-1698
(back-calculation at the maximum rate of the pump, conditional integration at the minimum and where a guard cuts).
D. E. Rivera, M. Morari, S. Skogestad, "Internal model control. 4. PID controller design", Ind. Eng. Chem. Process Des.
Dev. 25(1), 1986.
"""

from __future__ import annotations

import dataclasses
from dataclasses import KW_ONLY, dataclass
from typing import Annotated, Any, ClassVar, Final, Self

from glucoloop._lazy_jax import jax, jnp
from glucoloop._pytree import pytree
from glucoloop.arguments import checked, is_traced
from glucoloop.component.effects import ONLY_READINGS
from glucoloop.component.pytree_component import DATA, HOST, STATIC, wired
from glucoloop.component.request import Request
from glucoloop.component.setting import About
from glucoloop.control.decision import decide, delivered_since, is_known, rate_at_start
from glucoloop.control.design_case import DesignCase, check_gain, check_number, check_sample_time
from glucoloop.control.part import ControllerComponent, FittedStep
from glucoloop.control.protocol import Decision, Observation
from glucoloop.pumps.limits import PARKER_1999_LIMITS, DoseLimits
from glucoloop.refusal import Refusal
from glucoloop.unit_guess import PID_GAIN


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
        check_number("gain", self.gain_mU_min_per_mg_dl, "mU/min per mg/dl")
        if not is_traced(self.integral_time_min) and not self.integral_time_min > 0.0:
            raise Refusal(f"an integral time of {self.integral_time_min:g} min is not possible; give a value above 0")
        check_number("derivative time", self.derivative_time_min, "min", at_least=0.0)


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


ROUNDING: Final = 0.02
"""Part of the highest rate by which a delivered rate may differ from the wanted one and is not limited: a pump rounds
its rate to steps, and the integral has to grow by less than a step at a sample.
"""


@pytree
class _PIDState:
    """Last reading, integral part of the rate, the last rate within the limits, and the rate in force."""

    last_mg_dl: jax.Array
    integral_mU_min: jax.Array
    requested_mU_min: jax.Array
    """Last rate that was asked for, within the range of the pump."""
    insulin_mU_min: jax.Array
    """Rate in force."""


class PID(ControllerComponent, name="pid"):
    """PID whose integral never winds up, tuned on a first-order model with dead time.

    With the error ``e = y - r`` the rate is::

        K_c e_k + I_k + K_c (T_D / T) (y_k - y_(k-1)),    I_k = I_(k-1) + K_c (T / T_I) e_k

    The integral part ``I`` begins with the rate in force. Beyond the maximum rate of the pump it starts again from that
    rate, so that it never winds up. Below the minimum rate, and where a guard or the limit of change cuts a dose, it
    waits: it goes no further that way until the cut ends, and forgets nothing.

    ============  =========================  =============================================
    variable      meaning                    setting
    ============  =========================  =============================================
    ``K_c``       gain                       ``gain``
    ``T_I, T_D``  integral, derivative time  ``integral_time_min``, ``derivative_time_min``
    ``T``         sample time
    ============  =========================  =============================================
    """

    sources = ("rivera1986", "astrom1989")
    used: ClassVar = ONLY_READINGS
    uses_model: ClassVar = False
    role_of_settings: ClassVar = HOST
    memory_bound: ClassVar[float] = 1e4
    """Bound on its memory for a guard: glucose is below 1000 mg/dl, and rates below 10 000 mU/min (600 U/h)."""

    closed_loop_min: Annotated[float, About("Desired time constant of the loop, in minutes.", above=0.0)] = 30.0
    gain: Annotated[
        float, About("Gain K_c, in mU/min per mg/dl; 0: from the model.", at_least=0.0, quantity=PID_GAIN)
    ] = 0.0
    integral_time_min: Annotated[float, About("Integral time T_I, in minutes; 0: from the model.", at_least=0.0)] = 0.0
    derivative_time_min: Annotated[
        float, About("Derivative time T_D, in minutes; -1: from the model.", at_least=-1.0)
    ] = -1.0
    step_mU_min: FittedStep = 0.0
    _: KW_ONLY
    proportional: jax.Array | float = wired(DATA, default=None)
    integral: jax.Array | float = wired(DATA, default=None)
    derivative: jax.Array | float = wired(DATA, default=None)
    limits: DoseLimits = wired(DATA, default=PARKER_1999_LIMITS)
    sample_time_min: float = wired(STATIC, default=5.0)

    def designed(self, case: DesignCase) -> PID:
        """PID; what is not given comes from a first-order model of the patient, a known dead time included."""
        model = case.first_order(self.step_mU_min or None)
        delay_min = float(model.delay_min) + case.dead_time_samples * case.sample_time_min
        fitted = internal_model_tuning(float(model.gain), float(model.tau_min), delay_min, self.closed_loop_min)
        derivative_time_min = self.derivative_time_min
        tuning = PIDTuning(
            gain_mU_min_per_mg_dl=self.gain or fitted.gain_mU_min_per_mg_dl,
            integral_time_min=self.integral_time_min or fitted.integral_time_min,
            derivative_time_min=fitted.derivative_time_min if derivative_time_min == -1.0 else derivative_time_min,
        )
        return self.tuned(tuning, case.limits, sample_time_min=case.sample_time_min)

    def tuned(self, tuning: PIDTuning, limits: DoseLimits, *, sample_time_min: float) -> PID:
        """The controller with the parameters of a tuning, for a pump and a sample time."""
        check_sample_time(sample_time_min)
        same = self.replaced(
            gain=tuning.gain_mU_min_per_mg_dl,
            integral_time_min=tuning.integral_time_min,
            derivative_time_min=tuning.derivative_time_min,
        )
        controller: PID = same.made(
            proportional=tuning.gain_mU_min_per_mg_dl,
            integral=tuning.gain_mU_min_per_mg_dl * sample_time_min / tuning.integral_time_min,
            derivative=tuning.gain_mU_min_per_mg_dl * tuning.derivative_time_min / sample_time_min,
            limits=limits,
            sample_time_min=sample_time_min,
        )
        return controller

    def as_request(self) -> Request[Self]:
        """The request of the same parameters, of which those of a model are no longer open in a design."""
        if self.proportional is None or is_traced(self.proportional):
            return super().as_request()
        names = ("gain", "integral_time_min", "derivative_time_min")
        return dataclasses.replace(
            self.request, explicit={**self.explicit, **{name: float(getattr(self, name)) for name in names}}
        )

    def settled(self) -> dict[str, Any]:
        """Gain in mU/min per mg/dl, and times."""
        gain, sample_time_min = self.proportional, self.sample_time_min
        integral = {"integral_time_min": gain * sample_time_min / self.integral} if self.integral else {}
        return {"gain": gain, **integral, "derivative_time_min": self.derivative * sample_time_min / gain}

    def init(self, observation: Observation) -> _PIDState:
        """State in which the first reading calls for the rate in force."""
        reading = jnp.where(is_known(observation), observation.glucose_mg_dl, observation.setpoint_mg_dl)
        insulin = rate_at_start(observation, self.limits.min_mU_min)
        return _PIDState(
            last_mg_dl=reading,
            integral_mU_min=insulin - self.proportional * (reading - observation.setpoint_mg_dl),
            requested_mU_min=insulin,
            insulin_mU_min=insulin,
        )

    def step(self, state: _PIDState, observation: Observation) -> tuple[_PIDState, Decision]:
        """Add up the three parts.

        At the maximum rate of the pump the integral becomes what makes up that rate, so that it is left as soon as
        glucose turns. At the minimum rate it only waits: if it made up that rate, each fall of a noisy reading would
        raise it, and insulin would come back while glucose is low. Where less or more was delivered than was asked for,
        as by a guard or the limit of change, it goes no further that way, and forgets nothing.
        """
        delivered = delivered_since(observation, state.insulin_mU_min)
        known = is_known(observation)
        y = jnp.where(known, observation.glucose_mg_dl, state.last_mg_dl)
        error = y - observation.setpoint_mg_dl
        cut, rounding = state.requested_mU_min - delivered, ROUNDING * self.limits.max_mU_min
        waits = ((cut > rounding) & (error > 0.0)) | ((cut < -rounding) & (error < 0.0))
        # No error is larger than one that moves the rate over the whole range; an impossible reading ends there too.
        most = self.limits.max_mU_min - self.limits.min_mU_min
        grows = known & jnp.isfinite(error) & ~waits
        integral = state.integral_mU_min + jnp.where(grows, jnp.clip(self.integral * error, -most, most), 0.0)
        wanted = self.proportional * error + integral + self.derivative * (y - state.last_mg_dl)
        # A held reading says nothing about the error now: the last rate stays.
        wanted = jnp.where(known, wanted, state.requested_mU_min)
        finite = jnp.isfinite(wanted)
        requested = jnp.clip(jnp.where(finite, wanted, delivered), self.limits.min_mU_min, self.limits.max_mU_min)
        anew = integral + (requested - wanted)
        at_limit = jnp.where(wanted < requested, jnp.maximum(integral, jnp.minimum(state.integral_mU_min, anew)), anew)
        state = _PIDState(
            last_mg_dl=y,
            integral_mU_min=jnp.where(known & finite, at_limit, integral),
            requested_mU_min=requested,
            insulin_mU_min=delivered,
        )
        return state, decide(wanted, delivered, self.limits, known)


@checked
def design_pid(tuning: PIDTuning, limits: DoseLimits = PARKER_1999_LIMITS, *, sample_time_min: float = 5.0) -> PID:
    """`PID` with given parameters, for a pump and a sample time.

    Parameters
    ----------
    tuning : PIDTuning
    limits : DoseLimits
        Limits of the pump, by default those of 1999; give ``gl.usual_limits(patient)`` for another patient.
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
    return PID().tuned(tuning, limits, sample_time_min=sample_time_min)
