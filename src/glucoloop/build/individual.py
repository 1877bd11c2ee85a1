"""Controllers designed for each person of a trial, many at a time.

The entry of a controller names the function that designs it. Linear MPC is designed on a model identified from each
person's own pulse experiment, and MPC/SE on the person's own linearisation; both are computed for a block of people at
once. The model of the meal-aware controller has the person's basal rate, and the gain and lag of insulin of the
person's own record. Other controllers are designed one by one.

The information that a trial may have of a person is a record: some hours of fasting with two pulses, up and down, and
readings as noisy as in the loop.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any, Final

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from glucoloop._pytree import chosen, replaced, varying
from glucoloop.build.designs import controller_of
from glucoloop.build.random_keys import keys_of_records
from glucoloop.build.surroundings import record_sensor
from glucoloop.build.titration import profile_of
from glucoloop.component.code import loaded
from glucoloop.control import Controller
from glucoloop.control.mpc_se import FilteredModels
from glucoloop.control.protocol import computed_settings
from glucoloop.estimation import filter_gain, steady_state_covariance
from glucoloop.identification import (
    cross_correlation,
    design_csrs,
    filtered_input,
    laguerre_coefficients,
    laguerre_functions,
    laguerre_realisation,
    subcutaneous_coefficients,
)
from glucoloop.identification.gain_and_lag import identify_gain_and_lag
from glucoloop.models.state_space import LinearModel
from glucoloop.patients.capabilities import process_noise
from glucoloop.patients.population import VirtualPeople, of_people
from glucoloop.refusal import Refusal
from glucoloop.simulation.experiment import PulseExperiment
from glucoloop.simulation.internal_model import linear_model, linear_model_at
from glucoloop.situations.case import Case
from glucoloop.situations.situation import Situation
from glucoloop.therapy import given_profile

Floats = npt.NDArray[np.float64]
Design = Callable[[VirtualPeople], Controller]
Known = Callable[[VirtualPeople], tuple[Floats, Floats]]
"""Estimated gain and lag ``(people,)``."""

_BY_FILTER: Final = ("held-innovation", "none")
"""Ways of removing an offset in MPC/SE without a further state."""
_SHARE_OF_BASAL: Final = 0.25
"""Amplitude of the pulses in basal rates. Larger ones leave the range in which the nominal response may be scaled."""
_PACE_MIN: Final = 180.0
"""Time from one pulse to the next, the paper's memory."""
_HOLD_MIN: Final = 30.0
"""Length of a pulse. With pulses of a single sample, as in the paper, the small response would be lost in noise."""
_MIN_VARIANCE: Final = 0.01
_DOUBLINGS: Final = 12
"""Number of doublings, exact to rounding for filters that forget within two days."""


def individual_design(
    situation: Situation, case: Case, controller: Controller, example: VirtualPeople
) -> Design | None:
    """Function that designs controllers of people's own; None for a controller that is the same for all people.

    `controller` is that of the case for the nominal patient, and `example` some of the people, which show what varies.
    """
    place = case.controller.individual
    if place is None:
        return None
    design: Design = loaded(place)(situation, _with_horizon(situation, case, controller), example)
    return design


def _with_horizon(situation: Situation, case: Case, controller: Controller) -> Case:
    """A case whose horizon, where it follows from the model, is that of the nominal patient for all people.

    One horizon makes their controllers of one shape, and a person's does not depend on who else is in a block.
    """
    horizon = computed_settings(controller).get("prediction_horizon")
    if case.tuning.get("prediction_horizon") != 0 or horizon is None:
        return case
    if case.known_dead_time:
        horizon -= situation.dead_time_samples
    settings: Any = case.controller
    return dataclasses.replace(case, controller=dataclasses.replace(settings, prediction_horizon=round(horizon)))


def _records(
    situation: Situation, example: VirtualPeople, noise_variance: float
) -> Callable[[VirtualPeople, Floats], Floats]:
    """Function of people and their rates ``(samples, people)`` that gives the readings of their records."""
    sensor = record_sensor(situation, noise_variance)
    experiment = PulseExperiment(situation.nominal, example.patient, sensor, sample_time_min=situation.sample_time_min)

    def read(people: VirtualPeople, rates_mU_min: Floats) -> Floats:
        keys = keys_of_records(situation.seed, people.draw.person)
        return experiment.run(people.patient, people.rest, rates_mU_min, keys)

    return read


def linear_mpc(situation: Situation, case: Case, example: VirtualPeople) -> Design:
    """Linear MPC on a model identified from each person's own pulse experiment."""
    identification = case.identified
    memory, functions = identification.memory or 0, identification.laguerre_functions
    steps = np.asarray(design_csrs(memory, 1.0))
    read = _records(situation, example, identification.noise_variance or 0.0)
    late = situation.dead_time_samples if case.known_dead_time else 0
    settings: Any = case.controller
    tuning = settings.longer(late)

    def design(people: VirtualPeople) -> Controller:
        basal = people.basal_insulin_mU_min
        amplitude = np.minimum(situation.patient.pulse_mU_min, basal)  # insulin cannot be taken back
        glucose = read(people, basal + amplitude * steps[:, None])
        # a person without a basal rate has no record; those of the others must not wait for it
        known = np.isfinite(glucose).all(axis=0)
        deviation = np.where(known, (glucose - glucose.mean(axis=0)) / np.where(known, amplitude, 1.0), 0.0)
        response = cross_correlation(steps, deviation, memory)
        smooth, network = response, None
        if functions:
            pole = identification.laguerre_pole or 0.0
            if situation.patient.subcutaneous:
                columns = filtered_input(steps, pole, functions)
                coefficients = jnp.asarray(
                    subcutaneous_coefficients(columns - columns.mean(axis=0), deviation, pole, functions, memory)
                )
            else:
                coefficients = laguerre_coefficients(response, pole, functions)
            smooth = laguerre_functions(pole, functions, memory).T @ coefficients
            network = laguerre_realisation(coefficients, pole, memory)
            if network is not None:
                network = dataclasses.replace(network, after=late)
        S = np.where(known, np.cumsum(np.asarray(smooth), axis=0), np.nan)
        controllers: Controller = tuning.of_people(
            np.concatenate([np.zeros((late, S.shape[1])), S]),
            situation.limits,
            sample_time_min=situation.sample_time_min,
            realisation=network,
        )
        return controllers

    return design


def mpc_se(situation: Situation, case: Case, example: VirtualPeople) -> Design:
    """MPC with state estimation on each person's own linearisation."""
    tuned = case.tuning
    if tuned["offset_free"] not in _BY_FILTER or tuned["noise_pace"] or tuned["sensor_lag_min"]:
        return one_by_one(situation, case, example)
    nominal = situation.nominal
    varies = varying(example.patient, nominal)
    settings: Any = case.controller
    noise, variance = process_noise(nominal, *settings.noise_variances), settings.measurement_variance

    def of_person(leaves: Any, x: jax.Array, insulin: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
        model = linear_model_at(replaced(nominal, varies, leaves), x, insulin, situation.sample_time_min)
        return model.Phi, model.Gamma, model.C

    @jax.jit
    def gains(leaves: Any, x: jax.Array, insulin: jax.Array) -> tuple[jax.Array, ...]:
        Phi, Gamma, C = jax.vmap(of_person, in_axes=(-1, -1, 0), out_axes=-1)(leaves, x, insulin)
        P = steady_state_covariance(Phi, C, jnp.diag(jnp.asarray(noise)), variance, doublings=_DOUBLINGS)
        still = jnp.eye(noise.size) - jnp.moveaxis(Phi, -1, 0)
        rest = jnp.linalg.solve(still, jnp.moveaxis(Gamma, -1, 0)[..., None])[..., 0].T
        return Phi, Gamma, C, filter_gain(P, C, variance), rest

    def design(people: VirtualPeople) -> Controller:
        basal = jnp.asarray(people.basal_insulin_mU_min)
        result = gains(chosen(people.patient, varies), jnp.asarray(people.rest), basal)
        Phi, Gamma, C, gain, rest = (np.asarray(part) for part in result)
        controllers: Controller = settings.of_people(
            FilteredModels(Phi=Phi, Gamma=Gamma, C=C, kalman_gain=gain, rest=rest),
            situation.limits,
            basal_mU_min=basal,
            basal_glucose_mg_dl=people.patient.setpoint_mg_dl,
            sample_time_min=situation.sample_time_min,
            dead_time_samples=situation.dead_time_samples if case.known_dead_time else 0,
        )
        return controllers

    return design


def by_profile(situation: Situation, case: Case, example: VirtualPeople) -> Design:
    """A controller that depends on a person by the profile alone."""
    del example
    controller = controller_of(situation, case)
    return lambda people: given_profile(controller, people.profile)


def one_by_one(situation: Situation, case: Case, example: VirtualPeople) -> Design:
    """Any controller, designed for one person after another."""
    del example  # what varies need not be known

    def design(people: VirtualPeople) -> Controller:
        # a block is filled up by repetition, and nobody is designed for twice
        numbers, first, place = np.unique(people.draw.person, return_index=True, return_inverse=True)
        designed: list[Any] = [None] * numbers.size
        for which in np.flatnonzero(people.feasible[first]):
            try:
                person, profile = of_people(people.patient, first[which]), of_people(people.profile, first[which])
                designed[which] = controller_of(situation, case, person, profile=profile)
            except Refusal as error:
                raise Refusal(
                    f"no {case.controller.display_name} can be designed for person {numbers[which]}: {error.problem}",
                    *error.remedies,
                    "design it once for the nominal patient (--design nominal)",
                ) from None
        sound = next((controller for controller in designed if controller is not None), None)
        if sound is None:
            sound = given_profile(controller_of(situation, case), profile_of(situation).like(people.profile))
        designed = [sound if controller is None else controller for controller in designed]
        stacked: Controller = jax.tree.map(
            lambda *leaves: jnp.stack([jnp.asarray(leaf) for leaf in leaves], axis=-1)[..., place], *designed
        )
        return stacked

    return design


def individual_meal_mpc(situation: Situation, case: Case, example: VirtualPeople) -> Design:
    """Meal-aware controller with each person's own model.

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
    known = by_record(situation, example, lag_min) if by == "record" else _nominal_gain_and_lag

    def design(people: VirtualPeople) -> Controller:
        individual: Controller = controller.for_person(people.basal_insulin_mU_min, *known(people))
        return individual

    return design


def pulses(sample_time_min: float) -> Floats:
    """Pulses of the record ``(samples,)``, of height 1: up and then down, each held for half an hour."""
    pace, window = (max(1, round(minutes / sample_time_min)) for minutes in (_PACE_MIN, _HOLD_MIN))
    starts = np.asarray(design_csrs(pace, 1.0))
    return np.convolve(starts, np.ones(window))[: starts.size]


def by_record(situation: Situation, example: VirtualPeople, sensor_lag_min: float = 0.0) -> Known:
    """Gain and lag of people from their records, which are read behind a lag of the sensor that is known."""
    shape = pulses(situation.sample_time_min)
    read = _records(situation, example, situation.noise_variance)
    nominal = linear_model(situation.nominal, sample_time_min=situation.sample_time_min, sensor_lag_min=sensor_lag_min)
    response = impulse_response(nominal, shape.size)

    def known(people: VirtualPeople) -> tuple[Floats, Floats]:
        basal = people.basal_insulin_mU_min
        away = _SHARE_OF_BASAL * basal * shape[:, None]
        glucose = read(people, basal + away)
        # somebody without a basal rate has no record, and is taken for the nominal person
        result = identify_gain_and_lag(
            np.where(people.feasible, away, 0.0),
            glucose - np.asarray(people.patient.setpoint_mg_dl),
            response,
            sample_time_min=situation.sample_time_min,
            noise_variance=max(situation.noise_variance, _MIN_VARIANCE),
        )
        return np.asarray(result.gain), np.asarray(result.lag)

    return known


def _nominal_gain_and_lag(people: VirtualPeople) -> tuple[Floats, Floats]:
    return np.ones(people.feasible.size), np.ones(people.feasible.size)


def impulse_response(model: LinearModel, memory: int) -> Floats:
    """Response of readings ``(memory,)`` to a rate of 1 mU/min that is held for one sample."""

    def sample(x: jax.Array, _: None) -> tuple[jax.Array, jax.Array]:
        return model.Phi @ x, model.reading_row @ x

    return np.asarray(jax.lax.scan(sample, jnp.asarray(model.Gamma), None, length=memory)[1])
