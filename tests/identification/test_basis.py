"""Memory and Laguerre functions that a record chooses by itself."""

import jax.numpy as jnp
import numpy as np
import pytest

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
    assert abs(float(found.model.gain) + 5.0) < found.reliability.gain_margin + 0.2
    assert found.doubts() == ()


@pytest.mark.long
@pytest.mark.parametrize("starts_at_rest", [True, False])
@pytest.mark.parametrize(("tau_min", "samples"), [(500.0, 576), (800.0, 576), (300.0, 250)])
def test_the_margin_reaches_the_gain_of_a_system_that_is_too_slow_for_the_record(tau_min, samples, starts_at_rest):
    for seed in range(10, 14):
        found = identify_record(
            first_order(-5.0, tau_min, samples, seed=seed),
            "least-squares",
            basal_insulin_mU_min=25.0,
            starts_at_rest=starts_at_rest,
        )
        assert abs(float(found.model.gain) + 5.0) < found.reliability.gain_margin


@pytest.mark.long
def test_what_is_given_is_kept():
    record = first_order(-5.0, 300.0)
    paper = {"memory": 36, "laguerre_pole": 0.84, "laguerre_functions": 2, "under_the_skin": False}
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
        assert (basis.memory, basis.pole, basis.functions, basis.under_the_skin) == (36, 0.84, 2, False)
