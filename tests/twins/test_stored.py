"""A twin that was kept is checked like a stranger's file when it is used again."""

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from glucoloop import Refusal
from glucoloop.patients.catalogue import patient_entry
from glucoloop.twins import StoredTwin
from glucoloop.twins.extended import NOISES, WAVES

PATIENT = "hovorka-2004"
NAMES = sorted(patient_entry(PATIENT).nominal)[:2]
COORDINATES = len(NAMES) + WAVES + len(NOISES)
KEPT = {
    "patient": PATIENT,
    "population": "boiroux2017",
    "verdict": "The twin predicts the 2 days held out.",
    "predicts": True,
    "filter": {
        "parameters": NAMES,
        "prior_mean": [0.1, -2.0],
        "prior_factor": [[0.2, 0.0], [0.05, 0.3]],
        "coordinates": [0.1] * COORDINATES,
        "covariance": (0.04 * np.eye(COORDINATES)).tolist(),
        "mean_mg_dl": 140.0,
        "steps": 2,
        "site": "interstitial",
    },
    "known": {},
    "profile": {"total_daily_dose_U": 40.0},
    "notes": ["more than what is used"],
}


def test_a_twin_is_read_as_it_was():
    twin = StoredTwin.of(KEPT)
    assert twin.patient.prior.parameters == tuple(NAMES)
    np.testing.assert_allclose(twin.factor @ twin.factor.T, KEPT["filter"]["covariance"], atol=1e-12)
    assert (twin.p.tolist(), twin.mean_mg_dl, twin.predicts) == (KEPT["filter"]["coordinates"], 140.0, True)


def test_a_twin_of_an_earlier_version_is_to_be_found_again():
    with pytest.raises(Refusal, match="of an earlier version"):
        StoredTwin.of({"patient": PATIENT, "posterior": {"parameters": NAMES}, "known": {}})


def changed(path, value):
    plain = json.loads(json.dumps(KEPT))
    *above, last = path.split(".")
    within = plain
    for name in above:
        within = within[name]
    within[last] = value
    return plain


@pytest.mark.parametrize(
    ("path", "value", "told"),
    [
        ("patient", 1, "patient is 1; it should be a text"),
        ("patient", "nobody", "nobody"),
        ("filter.parameters", ["odd", NAMES[0]], "odd"),
        ("filter.parameters", NAMES[:1] * 2, "there twice"),
        ("filter.parameters", [], "parameters has 0 items"),
        ("filter.prior_mean", [0.1], "of another size"),
        ("filter.prior_mean", [0.1, 1e300], "prior_mean.1 is 1e\\+300"),
        ("filter.covariance", np.zeros((COORDINATES, COORDINATES)).tolist(), "positive definite"),
        ("filter.covariance", [[0.04], [0.01, 0.09]], "of another size"),
        ("filter.coordinates", [0.0], "of another size"),
        ("filter.mean_mg_dl", float("nan"), "mean_mg_dl is nan"),
        ("filter.steps", 0, "steps is 0"),
        ("filter", [], "filter is"),
        ("known", {"odd": 1.0}, "odd"),
        ("verdict", 3, "verdict is 3"),
        ("predicts", "\x1b[2J", "predicts is"),
    ],
)
def test_what_is_no_twin_is_refused(path, value, told):
    with pytest.raises(Refusal, match=told) as refused:
        StoredTwin.of(changed(path, value))
    assert str(refused.value).isprintable()


PLAIN = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=4),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=3), inner, max_size=3),
)
PATHS = [*KEPT, *(f"filter.{name}" for name in KEPT["filter"])]


@pytest.mark.long
@given(st.sampled_from(PATHS), PLAIN)
@settings(max_examples=150, deadline=None)
def test_any_value_is_read_or_refused(path, value):
    try:
        twin = StoredTwin.of(changed(path, value))
    except Refusal:
        return
    assert np.isfinite(twin.patient.prior.factor).all()
    assert np.isfinite(twin.factor).all()


@pytest.mark.parametrize("text", ["", "[", "[]", "null", '{"patient": NaN}', '{"a": 1, "a": 2}', "{}", "\x00"])
def test_a_file_that_is_none_is_refused(tmp_path, text):
    from glucoloop.studies.replay import ReplayRequest

    (tmp_path / "twin.json").write_text(text)
    with pytest.raises(Refusal, match=r"twin\.json|holds no twin"):
        ReplayRequest(files=("record.parquet",), twin=str(tmp_path))
