"""Design of the controllers of the catalogue for a patient, a model and a tuning."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable
from dataclasses import dataclass

import jax
import numpy as np
import numpy.typing as npt

from glucoloop.build.random_keys import record_key
from glucoloop.build.surroundings import record_sensor
from glucoloop.build.titration import profile_of
from glucoloop.control import Controller, Guard, GuardSettings, guarded, paced
from glucoloop.control.part import ControllerComponent
from glucoloop.control.scheduled import scheduled
from glucoloop.identification import FirstOrderModel, Identification
from glucoloop.models.nonlinear import FedModel
from glucoloop.models.sensor_lag import behind_lag
from glucoloop.models.state_space import LinearModel
from glucoloop.models.step_response import StepResponseModel
from glucoloop.patients import Patient
from glucoloop.patients.capabilities import process_noise
from glucoloop.pumps import DEFAULT_BOLUS_LIMITS, BolusLimits, DoseLimits
from glucoloop.refusal import Refusal
from glucoloop.simulation import fit_step, identify, linear_model, nonlinear_model
from glucoloop.situations.case import Case
from glucoloop.situations.situation import Situation
from glucoloop.therapy import Profile
from glucoloop.unit_guess import CONFIRM_OPTION


@dataclass(frozen=True)
class SituationDesignCase:
    """Information on which a controller may be designed; implements `control.design_case.DesignCase`."""

    patient: Patient
    """Patient, for designs on a linearised or nonlinear model."""
    model: StepResponseModel | None
    """Identified model that includes the known dead time; None for a controller that does not use one."""
    limits: DoseLimits
    sample_time_min: float
    noise_variance: float
    """Noise variance of the readings."""
    dead_time_samples: int
    """Dead time that the controller knows, 0 if it does not know it."""
    bolus: BolusLimits = DEFAULT_BOLUS_LIMITS
    """Limits of a bolus of the pump."""
    person: Profile | None = None
    """Profile of the person; None for one of whom only the basal rate and the setpoint are known."""
    setpoint_mg_dl: float | None = None
    """Target of the controller, at which a model of the equations rests, or None for the patient's operating point."""
    sensor_lag_min: float = 0.0
    """Lag of the sensor that the controller knows of, 0 for none."""

    @property
    def basal_insulin_mU_min(self) -> float:
        """The patient's basal rate."""
        return float(self.patient.basal_insulin_mU_min)

    @property
    def profile(self) -> Profile:
        """Profile of the person, as whoever doses insulin knows it."""
        if self.person is not None:
            return self.person
        return Profile(basal_mU_min=self.basal_insulin_mU_min, setpoint_mg_dl=self.patient.setpoint_mg_dl)

    @property
    def identified(self) -> StepResponseModel:
        """The model, for a design that needs one."""
        if self.model is None:
            raise TypeError("the catalogue says that this controller uses no model, but its design asks for one")
        return self.model

    def behind_lag(self, lag_min: float) -> SituationDesignCase:
        """The same case with a sensor that lags; 0: no lag."""
        return dataclasses.replace(self, sensor_lag_min=lag_min) if lag_min else self

    def linearised(self) -> LinearModel:
        """The patient linearised at steady state at the setpoint."""
        return self._linear

    def nonlinear(self) -> FedModel:
        """The equations of the patient, at steady state at the setpoint."""
        return self._nonlinear

    # Kept, since a search designs many controllers on the same models.
    @functools.cached_property
    def _linear(self) -> LinearModel:
        return linear_model(
            self.patient,
            sample_time_min=self.sample_time_min,
            setpoint_mg_dl=self.setpoint_mg_dl,
            sensor_lag_min=self.sensor_lag_min,
        )

    @functools.cached_property
    def _nonlinear(self) -> FedModel:
        model = nonlinear_model(self.patient, sample_time_min=self.sample_time_min, setpoint_mg_dl=self.setpoint_mg_dl)
        return behind_lag(model, self.sensor_lag_min) if self.sensor_lag_min else model

    def first_order(self, step_mU_min: float | None, delay_min: float | None = None) -> FirstOrderModel:
        """First-order model fitted to the response to a step.

        For None the step is the default one, and the dead time is fitted too.
        """
        return fit_step(
            self.patient, step_mU_min=step_mU_min, delay_min=delay_min, sample_time_min=self.sample_time_min
        )

    def process_noise(self, glucose: float, other: float, glucagon: float) -> npt.NDArray[np.float64]:
        """Diagonal of Q ``(states,)`` of a filter for the models; a lag of the sensor has no noise of its own."""
        of_patient = process_noise(self.patient, glucose, other, glucagon)
        return np.append(of_patient, 0.0) if self.sensor_lag_min else of_patient


def controller_of(
    situation: Situation,
    case: Case,
    patient: Patient | None = None,
    model: StepResponseModel | None = None,
    *,
    model_is_late: bool = False,
    profile: Profile | None = None,
) -> Controller:
    """Design the controller of a case; see `design_of` for parameters and errors."""
    return design_of(situation, case, patient, model, model_is_late=model_is_late, profile=profile)(case.controller)


def design_of(
    situation: Situation,
    case: Case,
    patient: Patient | None = None,
    model: StepResponseModel | None = None,
    *,
    model_is_late: bool = False,
    profile: Profile | None = None,
) -> Callable[[ControllerComponent], Controller]:
    """Make the design of a case for any settings of its controller, on models that are made once.

    The patient is the nominal one by default, with its profile. A model is identified from the patient if the
    controller uses one and none is given; `model_is_late` says that a given one holds the dead time already. What
    cannot be designed is refused.
    """
    loop_min, situation = situation.sample_time_min, paced_situation(situation, case)
    known_samples = situation.dead_time_samples if case.known_dead_time else 0
    if case.controller.uses_model and model is None:
        identified = nominal_model(situation, case) if patient is None else identified_model(situation, case, patient)
        model = identified.model
    if patient is None:
        patient, profile = situation.nominal, profile_of(situation) if profile is None else profile
    design = SituationDesignCase(
        patient=patient,
        person=profile,
        model=model if model is None or model_is_late else model.delayed(known_samples),
        limits=situation.limits,
        sample_time_min=situation.sample_time_min,
        noise_variance=situation.noise_variance,
        dead_time_samples=known_samples,
        bolus=situation.bolus,
        setpoint_mg_dl=situation.setpoint_mg_dl,
    )

    def refuse_without_clock(to: object) -> None:
        if situation.start_min is None and getattr(to, "needs_time_of_day", False):
            raise Refusal(
                f"the controller {case.controller.display_name} is to go by the time of day, of which it is not told",
                "give the time at the start, like --start 06:00 (start in a file)",
            )

    def designed(settings: ControllerComponent) -> Controller:
        refuse_without_clock(settings)  # before a design that takes long
        controller: Controller = settings.designed(design)
        refuse_without_clock(controller)
        acting = with_actions(controller, situation, profile)
        guarded_one = with_guard(acting, case.guard, situation.limits)
        if isinstance(guarded_one, Guard) and profile is not None:
            guarded_one = guarded_one.limited_by(profile)
        return paced(with_schedule(guarded_one, situation, design.profile), loop_min)

    return designed


def paced_situation(situation: Situation, case: Case) -> Situation:
    """The situation for which the controller of a case is designed: its samples are those at which it acts."""
    return situation.paced(case.every_min, known_dead_time=case.known_dead_time)


def nominal_model(situation: Situation, case: Case) -> Identification:
    """The model of a case, identified from the nominal patient; refused if no controller should be designed on it."""
    result = identified_model(situation, case, situation.nominal)
    reasons = result.doubts()
    if reasons and not situation.allow_unusual:
        identification = case.identified
        variance = identification.noise_variance
        sensors = ", ".join(sensor.name for sensor in situation.record_sensor(0.0))
        read = f" through the sensor {sensors}" if sensors else " without noise"
        noise = f" with noise of variance {variance:g}" if variance else read
        usual = situation.patient.identification(situation.sample_time_min)["memory"]
        problem = f"no controller should be designed on the model that is identified{noise}. {' '.join(reasons)}"
        mend = "give another one with --model, as `glucoloop identify --out m` writes it"
        if variance:
            mend = "identify it with less noise, like --model 'noise_variance=0'"
        if identification.memory is not None and identification.memory < usual:
            short = f"A memory of {identification.memory} samples is short for {situation.patient.display_name}"
            problem += f" {short} ({usual} are usual)"
            mend = "leave it out"
        raise Refusal(problem, mend, f"{CONFIRM_OPTION} to use it all the same")
    return result


def identified_model(situation: Situation, case: Case, patient: Patient) -> Identification:
    """The model of a case, identified from the pulse experiment on a patient."""
    identification = case.identified
    return identify(
        patient,
        record_sensor(situation, identification.noise_variance or 0.0),
        record_key(situation.seed),
        memory=identification.memory or 0,
        amplitude_mU_min=min(situation.patient.pulse_mU_min, float(patient.basal_insulin_mU_min)),
        laguerre_pole=identification.laguerre_pole or 0.0,
        laguerre_functions=identification.laguerre_functions or None,
        subcutaneous=situation.patient.subcutaneous,
        sample_time_min=situation.sample_time_min,
    )


def with_actions(controller: Controller, situation: Situation, profile: Profile | None) -> Controller:
    """A controller with glucagon, and what the person does and tells, with the profile of the person or of people."""
    if situation.glucagon is not None:
        controller = situation.glucagon.made(
            inner=controller,
            profile=profile,
            sample_time_min=controller.sample_time_min,
            subcutaneous=situation.patient.subcutaneous,
            limits=situation.limits,
        )
    for action in situation.actions:
        controller = action.made(
            inner=controller,
            profile=profile,
            sample_time_min=controller.sample_time_min,
            warm_up_min=situation.warm_up_min,
        )
    return controller


def with_schedule(controller: Controller, situation: Situation, profile: Profile) -> Controller:
    """A controller by the clock, where the situation has a therapy by the time of day."""
    schedule = situation.schedule
    return scheduled(controller, schedule, profile) if schedule.changes else controller


def with_guard(
    controller: Controller,
    guard: GuardSettings | None,
    limits: DoseLimits,
    basal_insulin_mU_min: jax.Array | None = None,
) -> Controller:
    """A controller with the requested guard, if any, which holds the given basal rates ``(people,)``.

    Without them it holds the rate at which the loop starts.
    """
    if guard is None:
        return controller
    guard_of_all = guarded(controller, guard, limits)
    if basal_insulin_mU_min is None:
        return guard_of_all
    return dataclasses.replace(guard_of_all, basal_mU_min=basal_insulin_mU_min)
