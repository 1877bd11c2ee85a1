"""A model in its file: the same numbers when it is read, and refusals of what is no model."""

import json

import jax
import numpy as np
import pytest

from glucoloop.identification import Record, design_csrs, identify_record
from glucoloop.storage.model_file import model_file, read_model


@pytest.fixture(scope="module")
def slow():
    """Identification of a response that outlasts the memory of 20 samples."""
    pulses = np.asarray(design_csrs(20, 2.0))
    answer = np.convolve(pulses, np.r_[0.0, -0.3 * 0.95 ** np.arange(pulses.size)])[: pulses.size + 1]
    record = Record(insulin_mU_min=10.0 + pulses, glucose_mg_dl=150.0 + answer, sample_time_min=5.0)
    return identify_record(record, memory=20, laguerre_pole=0.95, laguerre_functions=2, basal_insulin_mU_min=10.0)


@pytest.fixture
def written(slow, tmp_path):
    path = tmp_path / "model.json"
    contents = model_file(slow, operating_point=None, source="identified in a test", dead_time_min=0.0, settings={})
    path.write_text(contents.text(), encoding="utf-8")
    return path


@pytest.mark.long
def test_a_model_that_outlasts_its_memory_is_read_as_it_was(slow, written):
    assert slow.model.realisation is not None
    jax.tree.map(np.testing.assert_array_equal, read_model(written).step_response_model(), slow.model)


@pytest.mark.parametrize(
    ("key", "value", "sentence"),
    [
        ("output", [-0.3, 0.1], "a realisation that differs from the impulse response by .* within its memory"),
        ("output", [-0.3], "do not have the same number of states"),
        ("after", 21, "a realisation of the response after 21 samples does not tell what comes after the memory of 20"),
        ("transition", [[1.0, 0.0], [0.1, 0.5]], "an eigenvalue of magnitude 1 does not decay"),
    ],
)
def test_a_realisation_of_another_response_is_refused(written, key, value, sentence):
    contents = json.loads(written.read_text(encoding="utf-8"))
    contents["realisation"][key] = value
    written.write_text(json.dumps(contents), encoding="utf-8")
    with pytest.raises(ValueError, match=sentence):
        read_model(written)
