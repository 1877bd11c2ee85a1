"""Linear MPC against the numbers of the paper and of an independent prototype of the same reading."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from glucoloop.control import MPCTuning, design_linear_mpc
from glucoloop.identification import cross_correlation, laguerre_smooth
from glucoloop.models.step_response import StepResponseModel
from glucoloop.sensors import dead_time, white_noise
from glucoloop.simulation import simulate

SEEDS = 60


@pytest.mark.long
def test_the_identified_model(identified_81):
    assert float(identified_81.impulse_response.sum()) == pytest.approx(-2.6036501, rel=1e-7)
    np.testing.assert_allclose(identified_81.laguerre_coefficients, [-0.37481091, -0.40937979], rtol=1e-7)


@pytest.mark.long
def test_noise_free_at_the_papers_setpoint(patient_81, identified_81, undershoot_and_settling):
    trace = simulate(patient_81, design_linear_mpc(identified_81.model))
    undershoot, settling = undershoot_and_settling(trace.fine_glucose_mg_dl, 81.1, 0.02)
    assert undershoot == pytest.approx(10.2, abs=0.2)
    assert settling == pytest.approx(345, abs=4)


def test_noise_free_at_the_papers_nominal_rate(patient_22, identified_22, undershoot_and_settling):
    trace = simulate(patient_22, design_linear_mpc(identified_22.model))
    undershoot, settling = undershoot_and_settling(trace.fine_glucose_mg_dl, patient_22.setpoint_mg_dl, 0.02)
    assert undershoot == pytest.approx(10.5, abs=0.2)
    assert settling == pytest.approx(346, abs=4)


def test_the_noise_tuning_without_noise(patient_81, identified_81):
    glucose = simulate(
        patient_81, design_linear_mpc(identified_81.model, MPCTuning(2, 10, 3.0, 1.0))
    ).fine_glucose_mg_dl
    assert float(glucose.min()) == pytest.approx(64.74, abs=0.01)
    assert int(glucose.argmin()) == 270
    assert float(glucose.max()) == pytest.approx(95.7, abs=0.1)


@pytest.fixture(scope="module")
def noisy_models(record_81, patient_81):
    """One model for each seed, from a record with the noise of the loop."""
    noise = np.random.default_rng(1).normal(0.0, np.sqrt(1.45), (73, SEEDS)).clip(-5.0, 5.0)
    glucose = record_81.glucose_mg_dl[:, None] + noise
    insulin = record_81.insulin_mU_min - patient_81.basal_insulin_mU_min
    response = laguerre_smooth(cross_correlation(insulin, glucose - glucose.mean(axis=0), 36), 0.84, 2)
    return [StepResponseModel.from_impulse_response(response[:, seed], 5.0) for seed in range(SEEDS)]


@pytest.mark.parametrize(
    ("samples", "known", "undershoot", "settling"),
    [
        (0, False, 16.4, 332),
        (1, False, 19.2, 334),
        (2, False, 22.8, 392),
        (3, False, 26.6, 551),
        (1, True, 19.8, 352),
        (2, True, 22.7, 368),
        (3, True, 25.5, 382),
    ],
)
@pytest.mark.long
def test_medians_in_noise_with_and_without_dead_time(
    patient_81, noisy_models, undershoot_and_settling, samples, known, undershoot, settling
):
    told = samples if known else 0
    tuning = MPCTuning(2, 10 + told, 3.0, 1.0)
    controllers = [design_linear_mpc(model.delayed(told), tuning) for model in noisy_models]
    together = jax.tree.map(lambda *leaves: jnp.stack([jnp.asarray(leaf) for leaf in leaves]), *controllers)
    sensor = dead_time(samples, white_noise())
    keys = jax.random.split(jax.random.key(0), SEEDS)
    glucose = jax.vmap(lambda c, key: simulate(patient_81, c, sensor, key=key).fine_glucose_mg_dl)(together, keys)
    each = np.array([undershoot_and_settling(run, 81.1, 0.05) for run in glucose])
    found = np.median(each, axis=0)
    assert found[0] == pytest.approx(undershoot, abs=1.0)
    # the medians of two samples of 60 seeds; a run that never settles counts as 551
    spread = np.subtract(*np.percentile(each[:, 1], [75, 25])) / np.sqrt(SEEDS)
    assert found[1] == pytest.approx(settling, abs=3.0 * np.sqrt(2.0) * max(spread, 1.0))
