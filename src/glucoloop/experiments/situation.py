"""Situation of a controller: the patient, the sensor and the pump with their faults."""

from __future__ import annotations

import functools
from dataclasses import dataclass

from glucoloop.meals import MealModel, meal_model
from glucoloop.parts.patients import USUAL_PATIENT, PatientEntry, patient_entry
from glucoloop.parts.pumps import USUAL_PUMP
from glucoloop.parts.sensors import USUAL_SENSOR
from glucoloop.patients import SemilinearPatient
from glucoloop.patients import patient as named_patient
from glucoloop.pumps import BolusLimits, DoseLimits, bolus_limits, dose_limits


@functools.cache
def _nominal(name: str, operating_point: str | None) -> SemilinearPatient:
    return named_patient(name, operating_point)


@dataclass(frozen=True, kw_only=True)
class Situation:
    """Complete description of a loop apart from its meals and its controller."""

    patient: str = USUAL_PATIENT.name
    """Name of the nominal patient, for whom controllers are designed."""
    operating_point: str | None = None
    """Operating point of the nominal patient, or None for the usual one."""
    setpoint_mg_dl: float | None = None
    """Target of the controller, or None for glucose at the operating point."""
    meal_model: str | MealModel | None = None
    """Model of digestion and absorption, by a name of `meals.MEAL_MODELS` or a model itself, or None for the patient's
    own.
    """
    announced: bool = False
    """Whether meals are announced to the controller when they begin."""
    carb_error_pct: float = 0.0
    """Standard deviation of the announced carbohydrate of a meal, in percent of the true one; see `meals.counting`."""
    carb_bias_pct: float = 0.0
    """Mean error of the announced carbohydrate, in percent."""
    start_min: float | None = None
    """Time of day at the start, in minutes after midnight, which the controller gets, or None if it gets none."""
    sensor: str = USUAL_SENSOR
    """Sensor, around which are noise and dead time; see `parts.sensors`."""
    noise_variance: float = 0.0
    noise_bound_mg_dl: float = 5.0
    dead_time_samples: int = 0
    site: str | None = None
    """Site of the sensor, or None for the site at which glucose is controlled."""
    pump: str = USUAL_PUMP
    """Pump, which is given the limits below, and around which is the resolution; see `parts.pumps`."""
    max_change_mU_min: float = USUAL_PATIENT.max_change_mU_min
    min_insulin_mU_min: float = USUAL_PATIENT.min_insulin_mU_min
    max_insulin_mU_min: float = USUAL_PATIENT.max_insulin_mU_min
    pump_resolution_mU_min: float | None = None
    max_bolus_U: float = 25.0
    min_bolus_U: float = 0.05
    bolus_step_U: float = 0.05
    faults: tuple[str, ...] = ()
    """Faults of sensor and pump, the first innermost, each as its text."""
    metrics: tuple[str, ...] = ()
    """Metrics that are computed beside the usual ones; see `parts.metrics`."""
    sample_time_min: float = 5.0
    seed: int = 0
    allow_unusual: bool = False
    """Whether unusual values were confirmed, and models whose gain is in doubt."""

    @property
    def miscounts(self) -> bool:
        """Whether the announced carbohydrate differs from the true one."""
        return self.announced and (self.carb_error_pct != 0.0 or self.carb_bias_pct != 0.0)

    @property
    def whom(self) -> tuple[PatientEntry, str]:
        """Entry of the patient, and name of the operating point."""
        entry = patient_entry(self.patient)
        return entry, entry.usual_point if self.operating_point is None else self.operating_point

    @property
    def nominal(self) -> SemilinearPatient:
        """The nominal patient at the operating point.

        Raises
        ------
        ValueError
            For an unknown patient or operating point.
        """
        return _nominal(self.patient, self.operating_point)

    @property
    def gut(self) -> MealModel | None:
        """Meal model that replaces the patient's own; None if the patient's own is used.

        Raises
        ------
        ValueError
            For an unknown meal model.
        """
        return meal_model(self.meal_model) if isinstance(self.meal_model, str) else self.meal_model

    @property
    def target_mg_dl(self) -> float:
        """The setpoint, or glucose at the operating point."""
        return float(self.nominal.setpoint_mg_dl) if self.setpoint_mg_dl is None else self.setpoint_mg_dl

    @property
    def limits(self) -> DoseLimits:
        """Limits of the pump.

        Raises
        ------
        ValueError
            If the bounds are not possible.
        """
        return dose_limits(
            max_change_mU_min=self.max_change_mU_min,
            min_mU_min=self.min_insulin_mU_min,
            max_mU_min=self.max_insulin_mU_min,
        )

    @property
    def bolus(self) -> BolusLimits:
        """Limits of a bolus of the pump.

        Raises
        ------
        ValueError
            If the bounds are not possible.
        """
        return bolus_limits(max_U=self.max_bolus_U, min_U=self.min_bolus_U, step_U=self.bolus_step_U)


def usual_situation(patient: str = USUAL_PATIENT.name) -> Situation:
    """A patient at the usual operating point with the usual pump and noise-free readings.

    Raises
    ------
    ValueError
        For an unknown patient.
    """
    entry = patient_entry(patient)
    return Situation(
        patient=patient,
        max_change_mU_min=entry.max_change_mU_min,
        min_insulin_mU_min=entry.min_insulin_mU_min,
        max_insulin_mU_min=entry.max_insulin_mU_min,
    )
