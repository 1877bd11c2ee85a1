"""The test sequence: balanced, paced, white over the memory."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from glucoloop.identification import design_csrs
from glucoloop.models.step_response import lagged_inputs


def test_the_paper_s_record_is_one_pulse_up_and_one_down_in_72_samples():
    insulin = np.asarray(design_csrs(36, 22.33))
    expected = np.zeros(72)
    expected[0], expected[36] = 22.33, -22.33
    np.testing.assert_array_equal(insulin, expected)


@pytest.mark.long
@settings(deadline=None, max_examples=60)
@given(st.integers(1, 40), st.integers(1, 6), st.integers(0, 100), st.integers(0, 2**32 - 1))
def test_pulses_are_balanced_apart_and_away_from_the_end(memory, pairs, spare, seed):
    samples = 2 * pairs * memory + spare
    insulin = np.asarray(design_csrs(memory, 3.0, samples, seed=seed))
    at = np.flatnonzero(insulin)
    assert insulin.size == samples
    assert insulin.sum() == 0.0
    assert set(np.abs(insulin[at])) == {3.0}
    assert len(at) == 2 * (samples // (2 * memory)), "as many pairs as fit"
    assert len(set(np.diff(at))) == 1, "a constant pace"
    assert np.diff(at).min() >= memory
    assert at[0] == 0
    assert samples - at[-1] >= memory


@pytest.mark.long
@pytest.mark.parametrize(("samples", "pulses"), [(None, None), (150, None), (None, 6), (100, 4)])
def test_the_sequence_is_white_over_the_memory(samples, pulses):
    insulin = design_csrs(12, 2.0, samples, pulses)
    past = np.asarray(lagged_inputs(insulin, 12))
    np.testing.assert_allclose(past.T @ past, float(insulin @ insulin) * np.eye(12), atol=1e-12)


def test_the_seed_decides_the_signs():
    first = design_csrs(4, 1.0, pulses=20, seed=1)
    np.testing.assert_array_equal(first, design_csrs(4, 1.0, pulses=20, seed=1))
    assert (np.asarray(first) != np.asarray(design_csrs(4, 1.0, pulses=20, seed=2))).any()


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ({"samples": 71}, r"71 samples is too short: 2 pulses .* need at least 72 samples"),
        ({"samples": 100, "pulses": 4}, r"100 samples is too short: 4 pulses .* need at least 144"),
        ({"pulses": 3}, "3 pulses are an odd number.*use 4"),
        ({"pulses": 0}, "number of pulses is 0: it must be a whole number of at least 2"),
        ({"samples": 0}, "number of samples is 0"),
        ({"samples": 72.0}, "number of samples is 72.0: it must be a whole number"),
        ({"memory": 0}, "memory is 0: it must be a whole number of at least 1"),
        ({"amplitude_mU_min": 0.0}, "amplitude is 0.0 mU/min: it must be a finite number above 0"),
        ({"amplitude_mU_min": np.nan}, "amplitude is nan"),
    ],
)
def test_what_cannot_be_designed_is_refused(arguments, sentence):
    with pytest.raises(ValueError, match=sentence):
        design_csrs(**{"memory": 36, "amplitude_mU_min": 22.33, **arguments})
