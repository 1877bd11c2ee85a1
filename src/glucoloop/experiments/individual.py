"""Controllers designed for each person of a trial, many at a time.

The entry of a controller names the function that designs it. Linear MPC is designed on a model identified from each
person's own pulse experiment, and MPC/SE on the person's own linearisation; both are computed for a block of people at
once. The model of the meal-aware controller is scaled to each person's own record, in `individual_meal_mpc`. Other
controllers are designed one by one.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any, Final

import jax
import jax.numpy as jnp
import numpy as np

from glucoloop.control import Controller
from glucoloop.control.linear_mpc import linear_mpc_of_people
from glucoloop.control.mpc_se import FilteredModels, mpc_se_of_people
from glucoloop.control.protocol import settled
from glucoloop.estimation import filter_gain, steady_state_covariance
from glucoloop.experiments.designs import controller_of, with_individual_basal
from glucoloop.experiments.random_keys import keys_of_records
from glucoloop.experiments.surroundings import record_sensor
from glucoloop.identification import (
    cross_correlation,
    design_csrs,
    filtered_input,
    laguerre_coefficients,
    laguerre_functions,
    laguerre_realisation,
    skin_coefficients,
)
from glucoloop.patients.capabilities import process_noise
from glucoloop.patients.population import VirtualPeople, of_people
from glucoloop.refusal import Refusal
from glucoloop.simulation.internal_model import linear_model_at
from glucoloop.simulation.people_plant import chosen, replaced, varying
from glucoloop.simulation.pulse_experiment import PulseExperiment
from glucoloop.situations.case import Case
from glucoloop.situations.situation import Situation

Design = Callable[[VirtualPeople], Controller]

_BY_FILTER: Final = ("held-innovation", "none")
"""Ways of removing an offset in MPC/SE without a further state."""


def individual_design(
    situation: Situation, case: Case, controller: Controller, example: VirtualPeople
) -> Design | None:
    """Function that designs controllers of people's own; None for a controller that is the same for all people.

    `controller` is that of the case for the nominal patient, and `example` some of the people, which show what varies.
    """
    designer = case.controller.individual_designer()
    if designer is None:
        return None
    design: Design = designer(situation, _with_horizon(situation, case, controller), example)
    return design


def _with_horizon(situation: Situation, case: Case, controller: Controller) -> Case:
    """A case whose horizon, where it follows from the model, is that of the nominal patient for all people.

    One horizon makes their controllers of one shape, and a person's does not depend on who else is in a block.
    """
    horizon = settled(controller).get("prediction_horizon")
    if case.tuning.get("prediction_horizon") != 0 or horizon is None:
        return case
    if case.known_dead_time:
        horizon -= situation.dead_time_samples
    settings: Any = case.controller
    return dataclasses.replace(case, controller=dataclasses.replace(settings, prediction_horizon=round(horizon)))


def linear_mpc(situation: Situation, case: Case, example: VirtualPeople) -> Design:
    """Linear MPC on a model identified from each person's own pulse experiment."""
    asked = case.identified
    memory, functions = asked.memory or 0, asked.laguerre_functions
    pulses = np.asarray(design_csrs(memory, 1.0))
    experiment = PulseExperiment(
        situation.nominal,
        example.patient,
        record_sensor(situation, asked.noise_variance or 0.0),
        sample_time_min=situation.sample_time_min,
    )
    late = situation.dead_time_samples if case.known_dead_time else 0
    settings: Any = case.controller
    tuning = settings.longer(late)

    def design(people: VirtualPeople) -> Controller:
        basal = people.basal_insulin_mU_min
        amplitude = np.minimum(situation.patient.pulse_mU_min, basal)  # insulin cannot be taken back
        keys = keys_of_records(situation.seed, people.draw.person)
        glucose = experiment.run(people.patient, people.rest, basal + amplitude * pulses[:, None], keys)
        # a person without a basal rate has no record; those of the others must not wait for it
        known = np.isfinite(glucose).all(axis=0)
        deviation = np.where(known, (glucose - glucose.mean(axis=0)) / np.where(known, amplitude, 1.0), 0.0)
        response = cross_correlation(pulses, deviation, memory)
        smooth, network = response, None
        if functions:
            pole = asked.laguerre_pole or 0.0
            if situation.patient.under_the_skin:
                columns = filtered_input(pulses, pole, functions)
                coefficients = jnp.asarray(
                    skin_coefficients(columns - columns.mean(axis=0), deviation, pole, functions, memory)
                )
            else:
                coefficients = laguerre_coefficients(response, pole, functions)
            smooth = laguerre_functions(pole, functions, memory).T @ coefficients
            network = laguerre_realisation(coefficients, pole, memory)
            if network is not None:
                network = dataclasses.replace(network, after=late)
        S = np.where(known, np.cumsum(np.asarray(smooth), axis=0), np.nan)
        return linear_mpc_of_people(
            np.concatenate([np.zeros((late, S.shape[1])), S]),
            tuning,
            situation.limits,
            sample_time_min=situation.sample_time_min,
            realisation=network,
            **settings.moves,
        )

    return design


def mpc_se(situation: Situation, case: Case, example: VirtualPeople) -> Design:
    """MPC with state estimation on each person's own linearisation."""
    tuned = case.tuning
    if tuned["offset_free"] not in _BY_FILTER or tuned["noise_pace"] or tuned["sensor_lag_min"]:
        return one_by_one(situation, case, example)
    nominal = situation.nominal
    varies = varying(example.patient, nominal)
    settings: Any = case.controller
    noise, variance = process_noise(nominal, *settings.process_noise), settings.measurement_variance

    def of_person(own: Any, x: jax.Array, insulin: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
        model = linear_model_at(replaced(nominal, varies, own), x, insulin, situation.sample_time_min)
        return model.Phi, model.Gamma, model.C

    @jax.jit
    def gains(own: Any, x: jax.Array, insulin: jax.Array) -> tuple[jax.Array, ...]:
        Phi, Gamma, C = jax.vmap(of_person, in_axes=(-1, -1, 0), out_axes=-1)(own, x, insulin)
        P = steady_state_covariance(Phi, C, jnp.diag(jnp.asarray(noise)), variance, doublings=_DOUBLINGS)
        still = jnp.eye(noise.size) - jnp.moveaxis(Phi, -1, 0)
        rest = jnp.linalg.solve(still, jnp.moveaxis(Gamma, -1, 0)[..., None])[..., 0].T
        return Phi, Gamma, C, filter_gain(P, C, variance), rest

    def design(people: VirtualPeople) -> Controller:
        basal = jnp.asarray(people.basal_insulin_mU_min)
        found = gains(chosen(people.patient, varies), jnp.asarray(people.rest), basal)
        Phi, Gamma, C, gain, rest = (np.asarray(part) for part in found)
        return mpc_se_of_people(
            FilteredModels(Phi=Phi, Gamma=Gamma, C=C, kalman_gain=gain, rest=rest),
            settings,
            situation.limits,
            basal_mU_min=basal,
            basal_glucose_mg_dl=people.patient.setpoint_mg_dl,
            sample_time_min=situation.sample_time_min,
            hold_innovation=settings.offset_free == "held-innovation",
            dead_time_samples=situation.dead_time_samples if case.known_dead_time else 0,
            **settings.moves,
        )

    return design


_DOUBLINGS: Final = 12
"""Number of doublings, exact to rounding for filters that forget within two days."""


def by_basal_rate(situation: Situation, case: Case, example: VirtualPeople) -> Design:
    """A controller that depends on a person by the basal rate alone."""
    del example
    controller = controller_of(situation, case)
    return lambda people: with_individual_basal(controller, people.basal_insulin_mU_min)


def one_by_one(situation: Situation, case: Case, example: VirtualPeople) -> Design:
    """Any controller, designed for one person after another."""
    del example  # what varies need not be known

    def design(people: VirtualPeople) -> Controller:
        # a block is filled up by repetition, and nobody is designed for twice
        numbers, first, place = np.unique(people.draw.person, return_index=True, return_inverse=True)
        designed: list[Any] = [None] * numbers.size
        for which in np.flatnonzero(people.feasible[first]):
            try:
                designed[which] = controller_of(situation, case, of_people(people.patient, first[which]))
            except Refusal as error:
                raise Refusal(
                    f"no {case.controller.called} can be designed for person {numbers[which]}: {error}; "
                    "or design it once for the nominal patient (--design nominal)"
                ) from None
        sound = next((controller for controller in designed if controller is not None), None)
        if sound is None:
            sound = controller_of(situation, case)
        designed = [sound if controller is None else controller for controller in designed]
        stacked: Controller = jax.tree.map(
            lambda *leaves: jnp.stack([jnp.asarray(leaf) for leaf in leaves], axis=-1)[..., place], *designed
        )
        return stacked

    return design
