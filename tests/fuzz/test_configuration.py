"""Configurations of any content are read or refused in a sentence, and what was read is read again the same."""

import tomllib

import pytest
import tomli_w
from glucoloop.config.comparison import read_comparison
from glucoloop.config.identification import read_identification
from glucoloop.config.key import declared
from glucoloop.config.options.identification import IdentificationKeys
from glucoloop.config.run import read_run, run_keys
from glucoloop.config.trial import read_trial, trial_key_names, trial_keys
from hypothesis import example, given, settings
from hypothesis import strategies as st

from glucoloop.control.catalogue import CONTROLLERS
from glucoloop.patients.sorensen.varying import NOMINAL
from glucoloop.situations.population import read_population
from glucoloop.situations.toml import read_toml

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
controllers = st.sampled_from([*CONTROLLERS])


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


@given(keys_among(run_keys()))
@example({"sample_time_min": 1e-310, "dead_time_min": 5.0})
@example({"output_weight": 10**400})
@example({"meals": ["1" * 50_000]})
@example({"seed": 2**400})
@settings(max_examples=200)
def test_run(refusal, keys):
    if refusal(read_run, keys) is None:
        run = read_run(keys)
        again = tomllib.loads(tomli_w.dumps({key: value for key, value in run.keys().items() if value is not None}))
        assert read_run(again) == run


@given(keys_among(run_keys()), st.lists(keys_among({"label", *run_keys()}), max_size=3))
@example({}, [{"label": "a\nb"}, {"label": "b"}])
@settings(max_examples=100)
def test_comparison(refusal, keys, cases):
    refusal(read_comparison, keys, [{"label": "one"}, *cases])


@given(keys_among(declared(IdentificationKeys)))
@example({"sample_time_min": 1e-320})
@settings(max_examples=150)
def test_identification(refusal, keys):
    refusal(read_identification, keys)


@pytest.mark.long
@given(keys_among({"guard", *trial_key_names()}), st.lists(keys_among({"label", *run_keys()}), max_size=2))
@example({"traces": "9" * 5000}, [])
@example({"sample_time_min": 1e-310}, [])
@example({"dead_time_min": 10**400}, [])
@settings(max_examples=200)
def test_trial(refusal, keys, cases):
    if refusal(read_trial, keys, cases) is None:
        trial = read_trial(keys, cases)
        told = {key: value for key, value in trial_keys(trial).items() if value is not None}
        read = tomllib.loads(tomli_w.dumps(told))
        assert read_trial(read, read.pop("case")) == trial


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
    assert refusal(read_run, {"output_weight": value}) == f"output_weight is {value:g}; give a finite number above 0"


def test_short_sample_time_is_refused_for_itself_and_not_for_what_follows_from_it(refusal):
    for read in (read_run, read_identification, read_trial):
        assert refusal(read, {"sample_time_min": 0.001}) == (
            "sample_time_min is 0.001 min; give a number from 0.1 to 120 min"
        )
        assert refusal(read, {"sample_time_min": 0.1, "allow_unusual": True}) is None
