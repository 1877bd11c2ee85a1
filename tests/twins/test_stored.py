"""A twin that was kept is checked like a stranger's file when it is used again."""

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from glucoloop import Refusal
from glucoloop.patients.catalogue import patient_entry
from glucoloop.twins import StoredTwin

PATIENT = "hovorka-2004"
NAMES = sorted(patient_entry(PATIENT).nominal)[:2]
KEPT = {
    "patient": PATIENT,
    "posterior": {
        "parameters": NAMES,
        "log_mean": [0.1, -2.0],
        "log_covariance": [[0.04, 0.01], [0.01, 0.09]],
        "start": 0.3,
    },
    "known": {},
    "profile": {"total_daily_dose_U": 40.0},
    "notes": ["more than what is used"],
}


def test_a_twin_is_read_as_it_was():
    twin = StoredTwin.of(KEPT)
    assert twin.posterior.parameters == tuple(NAMES)
    np.testing.assert_allclose(twin.posterior.covariance, KEPT["posterior"]["log_covariance"], rtol=1e-12)
    assert (twin.start, twin.profile) == (0.3, KEPT["profile"])


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
        ("posterior.parameters", ["odd", NAMES[0]], "odd"),
        ("posterior.parameters", NAMES[:1] * 2, "there twice"),
        ("posterior.parameters", [], "parameters has 0 items"),
        ("posterior.log_mean", [0.1], "of another size"),
        ("posterior.log_mean", [0.1, 1e300], "log_mean.1 is 1e\\+300"),
        ("posterior.log_covariance", [[0.0, 0.0], [0.0, 0.0]], "positive definite"),
        ("posterior.log_covariance", [[0.04], [0.01, 0.09]], "of another size"),
        ("posterior.start", float("nan"), "start is nan"),
        ("posterior", [], "posterior is"),
        ("known", {"odd": 1.0}, "odd"),
        ("profile", {"odd": 1.0}, "a key of profile is 'odd'"),
        ("profile", {"total_daily_dose_U": -1.0}, "total_daily_dose_U is -1"),
        ("profile", {"total_daily_dose_U": "\x1b[2J"}, "it should be a finite number"),
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
PATHS = [*KEPT, *(f"posterior.{name}" for name in KEPT["posterior"])]


@pytest.mark.long
@given(st.sampled_from(PATHS), PLAIN)
@settings(max_examples=150, deadline=None)
def test_any_value_is_read_or_refused(path, value):
    try:
        twin = StoredTwin.of(changed(path, value))
    except Refusal:
        return
    assert np.isfinite(twin.posterior.factor).all()
    assert np.isfinite(twin.start)


@pytest.mark.parametrize("text", ["", "[", "[]", "null", '{"patient": NaN}', '{"a": 1, "a": 2}', "{}", "\x00"])
def test_a_file_that_is_none_is_refused(tmp_path, text):
    from glucoloop.studies.replay import ReplayRequest

    (tmp_path / "twin.json").write_text(text)
    with pytest.raises(Refusal, match=r"twin\.json|holds no twin"):
        ReplayRequest(files=("record.parquet",), twin=str(tmp_path))
