"""From a record to a model: known patients come back, unfit records are refused."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from glucoloop.identification import (
    Record,
    best_pole,
    cross_correlation,
    design_csrs,
    identify_record,
    laguerre_smooth,
    meal_answer,
    random_binary_sequence,
    validate,
)
from glucoloop.models.step_response import StepResponseModel

BASAL, BASELINE, MEMORY = 25.0, 81.0, 20
TRUTH = StepResponseModel.from_impulse_response(-np.arange(1, MEMORY + 1) * 0.05 * 0.7 ** np.arange(MEMORY), 5.0)


def record_of(deviation, noise=0.0, basal=BASAL):
    deviation = np.asarray(deviation)
    return Record(
        insulin_mU_min=jnp.asarray(basal + deviation),
        glucose_mg_dl=BASELINE + TRUTH.predict(deviation) + noise,
        sample_time_min=5.0,
    )


PULSES = record_of(design_csrs(MEMORY, 20.0))
BINARY = random_binary_sequence(120, 5.0, seed=2)


def test_a_known_patient_comes_back_from_the_shortest_record():
    found = identify_record(PULSES, memory=MEMORY, laguerre_pole=0.7, laguerre_functions=2)
    np.testing.assert_allclose(found.impulse_response, TRUTH.impulse_response, atol=1e-12)
    # j 0.7^j lies in the span of two Laguerre functions with that pole, so smoothing takes nothing away.
    np.testing.assert_allclose(found.model.step_response, TRUTH.step_response, atol=1e-11)
    assert found.smoothing_residual_norm < 1e-11
    assert found.estimate_rms_mg_dl < 1e-11
    assert found.model_rms_mg_dl < 1e-10
    assert found.baseline_glucose_mg_dl == pytest.approx(BASELINE)
    assert found.basal_insulin_mU_min == BASAL
    assert found.model.sample_time_min == 5.0


@pytest.mark.long
@pytest.mark.parametrize("keywords", [{"basal_insulin_mU_min": BASAL}, {"starts_at_rest": False}])
def test_a_known_patient_comes_back_from_any_input_by_least_squares(keywords):
    found = identify_record(record_of(BINARY), "least-squares", memory=MEMORY, laguerre_functions=None, **keywords)
    np.testing.assert_allclose(found.model.step_response, TRUTH.step_response, atol=1e-9)
    np.testing.assert_array_equal(found.smoothed_impulse_response, found.impulse_response)
    assert found.laguerre_coefficients.size == 0
    # Away from the true basal rate the baseline moves along the gain.
    moved = float(TRUTH.gain) * (found.basal_insulin_mU_min - BASAL)
    assert found.baseline_glucose_mg_dl == pytest.approx(BASELINE + moved)


@pytest.mark.long
def test_a_baseline_that_is_given_is_used():
    found = identify_record(
        record_of(BINARY),
        "least-squares",
        memory=MEMORY,
        basal_insulin_mU_min=BASAL,
        baseline_glucose_mg_dl=BASELINE,
        laguerre_functions=None,
    )
    np.testing.assert_allclose(found.impulse_response, TRUTH.impulse_response, atol=1e-10)
    assert found.baseline_glucose_mg_dl == BASELINE
    off = identify_record(PULSES, memory=MEMORY, baseline_glucose_mg_dl=BASELINE + 10)
    assert off.estimate_rms_mg_dl == pytest.approx(10.0)
    np.testing.assert_allclose(off.impulse_response, TRUTH.impulse_response, atol=1e-11)


def test_residuals_are_those_of_the_estimate_and_of_the_model():
    noise = np.random.default_rng(0).normal(0, 1.2, 2 * MEMORY + 1)
    record = record_of(design_csrs(MEMORY, 20.0), noise)
    found = identify_record(record, memory=MEMORY)
    deviation = record.insulin_mU_min - BASAL
    y = record.glucose_mg_dl - found.baseline_glucose_mg_dl
    raw = StepResponseModel.from_impulse_response(found.impulse_response, 5.0)
    assert found.estimate_rms_mg_dl == pytest.approx(np.sqrt(np.mean((y - raw.predict(deviation)) ** 2)))
    assert found.model_rms_mg_dl == pytest.approx(np.sqrt(np.mean((y - found.model.predict(deviation)) ** 2)))
    assert found.estimate_rms_mg_dl < found.model_rms_mg_dl
    left = found.impulse_response - laguerre_smooth(found.impulse_response, 0.84, 2)
    assert found.smoothing_residual_norm == pytest.approx(float(jnp.linalg.norm(left)))


def test_smoothing_makes_a_noisy_model_predict_better():
    # What Fig. 3 of the paper shows: sums of residuals of 12.1 against 35.4 mg/dl.
    u, y = design_csrs(MEMORY, 20.0), np.asarray(TRUTH.predict(BINARY))
    pole = float(best_pole(TRUTH.impulse_response, 2).pole)
    rng = np.random.default_rng(1)
    sums = np.array(
        [
            [
                validate(
                    identify_record(record, memory=MEMORY, laguerre_pole=pole, laguerre_functions=functions).model,
                    BINARY,
                    y,
                ).sum_absolute_residual_mg_dl
                for functions in (2, None)
            ]
            for record in (record_of(u, rng.normal(0, 1.2, u.size + 1)) for _ in range(20))
        ]
    )
    assert np.median(sums[:, 0]) < 0.6 * np.median(sums[:, 1])


@pytest.mark.long
def test_meals_do_not_bias_the_gain():
    """Insulin given at meals, as people do: what meals add is the response of their own."""
    rng = np.random.default_rng(0)
    carbs = np.zeros(600)
    carbs[rng.choice(500, 12, replace=False)] = rng.uniform(20, 80, 12)
    t_min = 5.0 * np.arange(1, 73)
    per_gram = 1.2 * (t_min / 80) * np.exp(1 - t_min / 80)  # rises for 80 min
    insulin = rng.uniform(-5, 5, 600) + 0.5 * np.convolve(carbs, np.ones(6))[:600]
    glucose = BASELINE + TRUTH.predict(insulin) + np.append(0.0, np.convolve(carbs, per_gram)[:600])
    record = Record(
        insulin_mU_min=jnp.asarray(BASAL + insulin),
        glucose_mg_dl=glucose + rng.normal(0, 1.2, 601),
        sample_time_min=5.0,
        carbs_g=jnp.asarray(carbs),
    )
    settings = {"memory": MEMORY, "laguerre_pole": 0.7, "basal_insulin_mU_min": BASAL}
    found = identify_record(record, "least-squares", **settings)
    assert float(found.model.gain) == pytest.approx(float(TRUTH.gain), rel=0.1)
    assert found.reliability.gain_from < float(TRUTH.gain) < found.reliability.gain_to
    assert found.baseline_glucose_mg_dl == pytest.approx(BASELINE, abs=2)
    assert found.reliability.explained_percent > 95
    np.testing.assert_allclose(found.meal_impulse_response, per_gram, atol=0.15)
    left = record.glucose_mg_dl - meal_answer(record, found.meal_impulse_response) - found.baseline_glucose_mg_dl
    assert float(jnp.sqrt(jnp.mean((left - found.model.predict(insulin)) ** 2))) == pytest.approx(found.model_rms_mg_dl)

    blind = identify_record(dataclasses.replace(record, carbs_g=None), "least-squares", **settings)
    assert "more insulin would raise glucose" in blind.doubts()[0]
    late = identify_record(record, "least-squares", starts_at_rest=False, **settings)
    assert float(late.model.gain) == pytest.approx(float(TRUTH.gain), rel=0.15)
    with pytest.raises(ValueError, match="there are meals: use method='least-squares'"):
        identify_record(record, **settings)


def test_the_pipeline_over_noise_is_the_pipeline_at_each_noise():
    u = design_csrs(MEMORY, 20.0)
    noise = 1.2 * jax.random.normal(jax.random.key(0), (5, u.size + 1))

    @jax.jit
    @jax.vmap
    def step_response(e):
        h = laguerre_smooth(cross_correlation(u, TRUTH.predict(u) + e, MEMORY), 0.84, 2)
        return StepResponseModel.from_impulse_response(h, 5.0).step_response

    for together, e in zip(step_response(noise), noise, strict=True):
        alone = identify_record(record_of(u, e), memory=MEMORY).model.step_response
        np.testing.assert_allclose(together, alone, atol=1e-12)


@pytest.mark.long
def test_a_record_behind_a_dead_time_gives_the_delayed_model():
    u = design_csrs(MEMORY + 2, 20.0)
    late = np.r_[0.0, 0.0, np.asarray(TRUTH.predict(u))[:-2]]
    record = Record(insulin_mU_min=BASAL + u, glucose_mg_dl=jnp.asarray(BASELINE + late), sample_time_min=5.0)
    found = identify_record(record, memory=MEMORY + 2, laguerre_functions=None)
    np.testing.assert_allclose(found.model.step_response, TRUTH.delayed(2).step_response, atol=1e-11)


@pytest.mark.parametrize(
    ("record", "keywords", "sentence"),
    [
        (PULSES, {"method": "wiener"}, "Unknown identification method 'wiener': use one of 'csrs', 'least-squares'"),
        (PULSES, {"memory": 0}, "memory is 0"),
        (PULSES, {"memory": 21}, "40 samples is too short for cross-correlation over 21 samples: at least 42"),
        (PULSES, {"laguerre_functions": 21}, "21 Laguerre functions are more than the 20"),
        (PULSES, {"laguerre_pole": 1.0}, "pole of 1.0 is not strictly between 0 and 1"),
        (PULSES, {"starts_at_rest": False}, "takes the record to start at steady state: use method='least-squares'"),
        (PULSES, {"basal_insulin_mU_min": -1.0}, "basal insulin rate is -1.0"),
        (PULSES, {"baseline_glucose_mg_dl": np.nan}, "baseline glucose is nan"),
        (record_of(np.zeros(40)), {}, "never leaves its basal rate.*design_csrs"),
        (
            record_of(BINARY),
            {"basal_insulin_mU_min": BASAL},
            r"correlated with itself \d+ samples later.*use method='least-squares'",
        ),
        (
            record_of(np.r_[5.0, np.zeros(34), -5.0, np.zeros(4)]),
            {},
            "moves too close to the end of the record.*'least-squares'",
        ),
        (record_of(np.r_[5.0, np.zeros(39)]), {}, "deviates up and down unequally.*use method='least-squares'"),
        (
            record_of(BINARY),
            {"method": "least-squares"},
            "only the two levels 20 and 30 mU/min.*give basal_insulin_mU_min, or starts_at_rest=False",
        ),
        (
            Record(insulin_mU_min=jnp.ones(40), glucose_mg_dl=jnp.ones(40), sample_time_min=5.0),
            {},
            "40 insulin samples need 41 glucose readings",
        ),
        (
            Record(insulin_mU_min=jnp.ones(40), glucose_mg_dl=jnp.ones((41, 2)), sample_time_min=5.0),
            {},
            "one record at a time",
        ),
        (
            Record(insulin_mU_min=PULSES.insulin_mU_min, glucose_mg_dl=jnp.full(41, jnp.nan), sample_time_min=5.0),
            {},
            "not finite at sample 0: use record_from_samples",
        ),
    ],
)
def test_records_and_settings_that_cannot_be_identified_are_refused(record, keywords, sentence):
    with pytest.raises(ValueError, match=sentence):
        identify_record(record, **{"memory": MEMORY, **keywords})
