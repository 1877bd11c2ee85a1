"""Memory and Laguerre functions that a record chooses by itself."""

import re

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import brentq

import glucoloop as gl
from glucoloop.identification import (
    Record,
    bases_given,
    chosen_basis,
    design_csrs,
    identify_record,
    random_binary_sequence,
)


def first_order(gain, tau_min, samples=576, noise=1.2, seed=3):
    """Record of a first-order lag under a binary input."""
    t_min = 5.0 * np.arange(2000)
    h = gain * (np.exp(-t_min / tau_min) - np.exp(-(t_min + 5.0) / tau_min))
    insulin = np.asarray(random_binary_sequence(samples, 5.0, seed, hold_samples=6))
    glucose = 120.0 + np.append(0.0, np.convolve(insulin, h)[:samples])
    glucose += noise * np.random.default_rng(seed).standard_normal(samples + 1)
    return Record(insulin_mU_min=jnp.asarray(25.0 + insulin), glucose_mg_dl=jnp.asarray(glucose), sample_time_min=5.0)


@pytest.mark.long
@pytest.mark.parametrize("starts_at_rest", [True, False])
@pytest.mark.parametrize("tau_min", [60.0, 150.0, 300.0])
def test_the_gain_of_a_slow_system_is_found(tau_min, starts_at_rest):
    found = identify_record(
        first_order(-5.0, tau_min), "least-squares", basal_insulin_mU_min=25.0, starts_at_rest=starts_at_rest
    )
    assert float(found.model.gain) == pytest.approx(-5.0, rel=0.15)
    assert found.reliability.gain_from - 0.2 < -5.0 < found.reliability.gain_to + 0.2
    assert found.doubts() == ()


def covers(found):
    return found.reliability.gain_from <= -5.0 <= found.reliability.gain_to


def covers_or_is_refused(found):
    return covers(found) or bool(found.doubts())


@pytest.mark.long
@pytest.mark.parametrize("starts_at_rest", [True, False])
@pytest.mark.parametrize(("tau_min", "samples"), [(500.0, 576), (800.0, 576), (300.0, 250)])
def test_the_margin_reaches_the_gain_of_a_system_that_is_too_slow_or_it_is_refused(tau_min, samples, starts_at_rest):
    for seed in range(10, 14):
        found = identify_record(
            first_order(-5.0, tau_min, samples, seed=seed),
            "least-squares",
            basal_insulin_mU_min=25.0,
            starts_at_rest=starts_at_rest,
        )
        assert covers_or_is_refused(found)


@pytest.mark.long
def test_what_is_given_is_kept():
    record = first_order(-5.0, 300.0)
    paper = {"memory": 36, "laguerre_pole": 0.84, "laguerre_functions": 2, "subcutaneous": False}
    found = identify_record(record, "least-squares", basal_insulin_mU_min=25.0, **paper)
    assert (found.model.memory, found.laguerre_pole, found.laguerre_coefficients.size) == (36, 0.84, 2)
    assert float(found.model.gain) > -4.0  # such functions miss what comes after three hours
    memories = {basis.memory for basis in bases_given(record, "least-squares", 100, None, "usual", None)}
    assert memories == {100}


@pytest.mark.long
@pytest.mark.parametrize("noise", [0.0, 1.45])
def test_the_papers_patient_keeps_the_papers_functions(noise):
    person = gl.patient()
    basal, sensor = float(person.basal_insulin_mU_min), gl.white_noise(noise) if noise else None
    pulses = basal + np.asarray(design_csrs(36, 22.33))
    lively = basal + np.random.default_rng(0).uniform(-5, 5, 300)
    for insulin in (pulses, lively):
        record = gl.excite(person, insulin, sensor)
        basis = chosen_basis(record, bases_given(record, "least-squares", None, None, "usual", None))
        assert (basis.memory, basis.pole, basis.functions, basis.subcutaneous) == (36, 0.84, 2, False)


def step_of(tau_min):
    """Step response of two depots of 50 min and a lag, with a gain of 1."""
    t_min, taus = np.arange(0.0, 20000.0, 5.0), np.array([50.0, 50.01, tau_min])
    return 1.0 - sum(
        np.exp(-t_min / tau) * np.prod([tau / (tau - other) for other in taus if other != tau]) for tau in taus
    )


def skin_record(hours, insulin, noise, seed, half_min=210.0, slow_min=None):
    """Record of a person with a gain of -5, half of it after a time; or two fifths of it with a far slower lag."""
    t_min = np.arange(0.0, 20000.0, 5.0)
    if slow_min is None:
        step = step_of(brentq(lambda tau_min: np.interp(0.5, step_of(tau_min), t_min) - half_min, 30.0, 2000.0))
    else:
        step = 0.6 * step_of(80.0) + 0.4 * step_of(slow_min)
    samples = 12 * hours
    glucose = 120.0 + np.append(0.0, np.convolve(insulin, -5.0 * np.diff(step))[:samples])
    glucose += noise * np.random.default_rng(seed).standard_normal(samples + 1)
    return Record(insulin_mU_min=jnp.asarray(25.0 + insulin), glucose_mg_dl=jnp.asarray(glucose), sample_time_min=5.0)


@pytest.mark.parametrize("keywords", [{}, {"subcutaneous": True}, {"memory": 72}])
def test_pulses_whose_responses_outlast_the_memory_are_refused(keywords):
    for pace in (72, 288):
        record = skin_record(48, np.asarray(design_csrs(pace, 20.0, 576)), 1.2, pace)
        (doubt,) = identify_record(record, **keywords).doubts()
        assert re.search("(from 0|twice that)\\. A longer record, a longer memory or insulin that changes more", doubt)


def held_input(hours, hold_samples, seed, amplitude=5.0):
    """Steps up and down, or a new rate in each sample."""
    samples = 12 * hours
    if hold_samples == 1:
        return np.random.default_rng(1000 + seed).uniform(-amplitude, amplitude, samples)
    return np.asarray(random_binary_sequence(samples, amplitude, seed, hold_samples=hold_samples))


def test_the_margin_reaches_the_gain_where_functions_end_before_the_response():
    for seed in range(5):
        record = skin_record(24, held_input(24, 6, seed), 1.2, seed, half_min=350.0)
        found = identify_record(record, "least-squares", basal_insulin_mU_min=25.0)
        assert covers_or_is_refused(found)
        assert float(found.model.gain) > -4.7  # what the jackknife of such functions alone takes to be certain


@pytest.mark.long
@pytest.mark.parametrize(
    ("hours", "hold_samples", "noise", "response", "least"),
    [
        (48, 6, 1.2, {}, 70),
        (48, 1, 1.2, {}, 70),
        (48, 1, 5.0, {"half_min": 120.0}, 50),  # such noise leaves open whether the response has a slow end
        (48, 6, 3.0, {"slow_min": 400.0}, 70),
        (72, 6, 3.0, {"slow_min": 1000.0}, 70),
    ],
)
def test_the_interval_covers_the_true_gain_and_most_models_are_accepted(hours, hold_samples, noise, response, least):
    accepted = covered = 0
    for seed in range(100):
        record = skin_record(hours, held_input(hours, hold_samples, seed), noise, seed, **response)
        found = identify_record(record, "least-squares", basal_insulin_mU_min=25.0)
        if not found.doubts():
            accepted += 1
            covered += covers(found)
    assert covered >= 0.9 * accepted
    assert accepted >= least


@pytest.mark.long
def test_the_papers_noisy_experiment_is_hardly_ever_doubted():
    doubted = [bool(gl.identify(gl.patient(), gl.white_noise(1.45), seed).doubts()) for seed in range(100)]
    assert sum(doubted) <= 5
