"""Configurations of any content are read or refused in a sentence, and what was read is read again the same."""

import tomllib

import pytest
import tomli_w
from hypothesis import example, given, settings
from hypothesis import strategies as st

from glucoloop.component.grammar import as_tree
from glucoloop.component.request import configuration_from
from glucoloop.control import LinearMPC
from glucoloop.patients.sorensen.varying import NOMINAL
from glucoloop.situations.population import read_population
from glucoloop.situations.run import Run
from glucoloop.situations.toml import read_toml, toml_text
from glucoloop.studies.identification import ModelRequest
from glucoloop.studies.run import Comparison
from glucoloop.trials.trial import Trial

scalars = st.one_of(
    st.booleans(),
    st.integers(-(2**63), 2**63 - 1),
    st.sampled_from([0, 1, 2, 5, 60, 10**400]),
    st.floats(),
    st.sampled_from([0.0, -0.0, 5e-324, 1e-310, 0.05, 0.1, 5.0, 1e18, 1.7e308]),
    st.text(max_size=8),
    st.sampled_from(["", "mpc", "pid", "qp", "50g@50min", "parker2000", "a\0.toml", "all", "9" * 5000, "missing"]),
    st.dates(),
)
values = st.recursive(
    scalars, lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=3), inner, max_size=3)
)


def keys_among(known):
    return st.dictionaries(st.sampled_from(sorted(known)) | st.text(max_size=5), values, max_size=4)


@given(st.one_of(st.text(), st.text(alphabet="[]{}='\"\\.,\n#ua0-", max_size=40)))
@example("a=" + "[" * 100_000)
@example("a=" + "{a=" * 3000)
@example("a=" + "9" * 5000)
@example("a=[{b=0x" + "f" * 5000 + "}]")
@example("a" + ".a" * 10_000 + "=1")
@example("a=1\n" * 300_000)
@example("a='\\u0000'\r")
@settings(max_examples=150)
def test_any_text_is_toml_or_is_not(refusal, text):
    refusal(read_toml, text, "a.toml")


controller_keys = {"name", "label", "guard", "model", "faults", *LinearMPC.settings()}
tables_of_parts = st.one_of(
    values,
    st.sampled_from(["mpc", "lag, lag_min=8", "none", "", "a=", "(", "usual, max_hour=2", "limited", "missing"]),
    keys_among(controller_keys),
    st.lists(keys_among(controller_keys) | scalars, max_size=3),
)
parts = st.dictionaries(
    st.sampled_from(["controller", "sensor", "pump", "patient", "guard", "model", "faults", "metrics"]),
    tables_of_parts,
    max_size=2,
)


def read(root, keys):
    return configuration_from(root, as_tree(keys, "a.toml"))


def read_again(root, keys):
    found = read(root, keys)
    written = tomllib.loads(tomli_w.dumps(read_toml(toml_text(found.tree(), ""), "a.toml").keys))
    assert read(root, {"allow_unusual": found.allow_unusual, **written}) == found


@given(keys_among(Run.settings()), parts)
@example({"sample_time_min": 1e-310}, {"sensor": "dead-time"})
@example({"setpoint_mg_dl": 10**400}, {})
@example({"meals": ["1" * 50_000]}, {})
@example({"meals": [[1]]}, {})
@example({"seed": 2**400}, {})
@example({}, {"controller": {"name": []}})
@example({}, {"controller": {"guard": [1]}})
@example({}, {"patient": [["parker-1999"]]})
@settings(max_examples=300)
def test_run(refusal, keys, parts):
    if refusal(read, Run, {**keys, **parts}) is None:
        read_again(Run, {**keys, **parts})


@pytest.mark.long
@given(keys_among(Comparison.settings()), st.lists(keys_among(controller_keys), max_size=3))
@example({}, [{"label": "a\nb"}, {"label": "b"}])
@settings(max_examples=100)
def test_comparison(refusal, keys, cases):
    refusal(read, Comparison, {**keys, "controller": [{"label": "one"}, *cases]})


@pytest.mark.long
@given(keys_among(ModelRequest.settings()))
@example({"sample_time_min": 1e-320})
@settings(max_examples=150)
def test_identification(refusal, keys):
    refusal(read, ModelRequest, keys)


@pytest.mark.long
@given(keys_among(Trial.settings()), parts)
@example({"traces": "9" * 5000}, {})
@example({"sample_time_min": 1e-310}, {})
@settings(max_examples=200)
def test_trial(refusal, keys, parts):
    if refusal(read, Trial, {**keys, **parts}) is None:
        read_again(Trial, {**keys, **parts})


tables = st.fixed_dictionaries(
    {
        "parameter": st.sampled_from([*NOMINAL, "q_L"]),
        "distribution": st.sampled_from(["uniform", "normal", "lognormal", "cauchy"]),
    },
    optional={
        key: st.floats(0.1, 100.0) | st.floats(allow_subnormal=True) | st.just(10**400)
        for key in ("spread_pct", "spread", "centre", "lower", "upper")
    },
)


@pytest.mark.long
@given(st.lists(tables | keys_among({"parameter", "distribution", "spread_pct"}), max_size=3), st.text(max_size=3))
@example([{"parameter": "weight_kg", "distribution": "uniform", "centre": 1e308, "spread": 1e308}], "people")
@settings(max_examples=200)
def test_population_can_only_make_finite_people(refusal, tables, name):
    keys = {"name": name, "vary": tables}
    if refusal(read_population, keys) is None:
        for distribution in read_population(keys).distributions().values():
            assert -1e308 < distribution.lower < distribution.upper < 1e308


@pytest.mark.parametrize("value", [float("inf"), float("-inf"), float("nan")])
def test_setting_that_is_not_finite_is_refused_by_its_own_name(refusal, value):
    told = refusal(read, Run, {"controller": {"output_weight": value}})
    assert told == f"a.toml: output_weight is {value:g}; give a finite number above 0"


def test_short_sample_time_is_refused_for_itself_and_not_for_what_follows_from_it(refusal):
    for root in (Run, ModelRequest, Trial):
        assert refusal(read, root, {"sample_time_min": 0.001}) == (
            "a.toml: sample_time_min is 0.001 min; give a number from 0.1 to 120 min, or one in h, s or d"
        )
        assert refusal(read, root, {"sample_time_min": 0.1, "allow_unusual": True}) is None
