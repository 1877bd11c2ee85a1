"""Meal-aware controller for each person of a trial: its model has the person's basal rate, and gain and lag of insulin.

The information that a trial may have of a person is a record: some hours of fasting with two pulses of a quarter of the
basal rate, up and down, each for half an hour, and readings as noisy as in the loop.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from glucoloop.control import Controller
from glucoloop.experiments.designs import controller_of
from glucoloop.experiments.random_keys import keys_of_records
from glucoloop.experiments.surroundings import record_sensor
from glucoloop.identification import design_csrs
from glucoloop.identification.gain_and_lag import identify_gain_and_lag
from glucoloop.models.state_space import LinearModel
from glucoloop.patients.population import VirtualPeople
from glucoloop.simulation.internal_model import linear_model
from glucoloop.simulation.pulse_experiment import PulseExperiment
from glucoloop.situations.case import Case
from glucoloop.situations.situation import Situation

Floats = npt.NDArray[np.float64]
Known = Callable[[VirtualPeople], tuple[Floats, Floats]]
"""Estimated gain and lag ``(people,)``."""

SHARE_OF_BASAL: Final = 0.25
"""Amplitude of the pulses in basal rates. Larger ones leave the range in which the nominal response may be scaled."""
PACE_MIN: Final = 180.0
"""Time from one pulse to the next, the paper's memory."""
HELD_MIN: Final = 30.0
"""Length of a pulse. With pulses of a single sample, as in the paper, the small response would be lost in noise."""
_LEAST_VARIANCE: Final = 0.01


def individual_meal_mpc(
    situation: Situation, case: Case, example: VirtualPeople
) -> Callable[[VirtualPeople], Controller]:
    """Function that designs controllers of people's own; see `individual.individual_design`.

    The setting ``individual_by`` is the source of gain and lag. ``"record"``: the person's own record. ``"basal"``: the
    person's basal rate, see `MealMPC.with_basal`. ``"none"``: both are nominal, whatever the basal rate.
    """
    controller: Any = controller_of(situation, case)
    if not hasattr(controller, "for_person"):
        raise TypeError(f"{type(controller).__name__} cannot be made for a person; it has no method for_person")
    by = case.tuning["individual_by"]
    if by == "basal":
        return lambda people: controller.with_basal(jnp.asarray(people.basal_insulin_mU_min))
    lag_min = float(case.tuning["sensor_lag_min"])
    known = by_record(situation, example, lag_min) if by == "record" else _by_none

    def design(people: VirtualPeople) -> Controller:
        individual: Controller = controller.for_person(people.basal_insulin_mU_min, *known(people))
        return individual

    return design


def pulses(sample_time_min: float) -> Floats:
    """Pulses of the record ``(samples,)``, of height 1: up and then down, each held for half an hour."""
    pace, held = (max(1, round(minutes / sample_time_min)) for minutes in (PACE_MIN, HELD_MIN))
    starts = np.asarray(design_csrs(pace, 1.0))
    return np.convolve(starts, np.ones(held))[: starts.size]


def by_record(situation: Situation, example: VirtualPeople, sensor_lag_min: float = 0.0) -> Known:
    """Gain and lag of people from their records, which are read behind a lag of the sensor that is known."""
    shape = pulses(situation.sample_time_min)
    experiment = PulseExperiment(
        situation.nominal,
        example.patient,
        record_sensor(situation, situation.noise_variance),
        sample_time_min=situation.sample_time_min,
    )
    nominal = linear_model(situation.nominal, sample_time_min=situation.sample_time_min, sensor_lag_min=sensor_lag_min)
    response = impulse_response(nominal, shape.size)

    def known(people: VirtualPeople) -> tuple[Floats, Floats]:
        basal = people.basal_insulin_mU_min
        away = SHARE_OF_BASAL * basal * shape[:, None]
        keys = keys_of_records(situation.seed, people.draw.person)
        glucose = experiment.run(people.patient, people.rest, basal + away, keys)
        # somebody without a basal rate has no record, and is taken for the nominal person
        found = identify_gain_and_lag(
            np.where(people.feasible, away, 0.0),
            glucose - np.asarray(people.patient.setpoint_mg_dl),
            response,
            sample_time_min=situation.sample_time_min,
            noise_variance=max(situation.noise_variance, _LEAST_VARIANCE),
        )
        return np.asarray(found.gain), np.asarray(found.lag)

    return known


def _by_none(people: VirtualPeople) -> tuple[Floats, Floats]:
    return np.ones(people.feasible.size), np.ones(people.feasible.size)


def impulse_response(model: LinearModel, memory: int) -> Floats:
    """Response of readings ``(memory,)`` to a rate of 1 mU/min that is held for one sample."""

    def sample(x: jax.Array, _: None) -> tuple[jax.Array, jax.Array]:
        return model.Phi @ x, model.reading_row @ x

    return np.asarray(jax.lax.scan(sample, jnp.asarray(model.Gamma), None, length=memory)[1])
