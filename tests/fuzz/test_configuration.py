"""Configurations of any content are read or refused in a sentence, and what was read is read again the same."""

import functools

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from glucoloop.cohorts.trial import Trial
from glucoloop.control.catalogue import CONTROLLERS
from glucoloop.patients.sorensen.varying import NOMINAL
from glucoloop.situations.population import read_population
from glucoloop.situations.run import Run
from glucoloop.situations.situation import configured
from glucoloop.situations.toml import read_toml, toml_text
from glucoloop.studies.identification import ModelRequest
from glucoloop.studies.run import Comparison

read_run, read_comparison, read_trial, read_identification = (
    functools.partial(configured, root) for root in (Run, Comparison, Trial, ModelRequest)
)

scalars = st.one_of(
    st.booleans(),
    st.integers(-(2**63), 2**63 - 1),
    st.sampled_from([0, 1, 2, 5, 60, 10**400]),
    st.floats(),
    st.sampled_from([0.0, -0.0, 5e-324, 1e-310, 0.05, 0.1, 5.0, 1e18, 1.7e308]),
    st.text(max_size=8),
    st.sampled_from(["", "mpc", "pid", "qp", "50g@50min", "parker2000", "a\0.toml", "all", "9" * 5000, "missing"]),
    st.sampled_from(
        ["none", "usual", "identified", "lag, lag_min=8", "mpc, move_weight=1, label='a\nb'", "variance=("]
    ),
    st.dates(),
)
values = st.recursive(
    scalars, lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=3), inner, max_size=3)
)
settings_of_parts = ["name", "label", "model", "guard", "move_weight", "max_on_board", "memory", "variance", "lag_min"]
parts = st.dictionaries(st.sampled_from(settings_of_parts) | st.text(max_size=3), values, max_size=3)
names = st.sampled_from(
    [*CONTROLLERS, "white-noise", "ideal", "dead-time", "limited", "usual", "hovorka-2004", "missing"]
)
named = st.tuples(names, parts).map(lambda of: {**of[1], "name": of[0]})


def keys_among(root):
    """Keys of a class of settings, and others, with values of any type, among them tables with the names of parts."""
    known = sorted(root.settings())
    return st.dictionaries(
        st.sampled_from(known) | st.text(max_size=5), values | parts | named | st.lists(named, max_size=2), max_size=4
    )


def read_again(read, command, keys):
    """What was read, and what is read from its file."""
    asked = read(keys)
    return asked, read(read_toml(toml_text(asked.tree(whole=True), command, asked.tree()), "a.toml").keys)


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


@given(keys_among(Run))
@example({"sample_time_min": 1e-310, "sensor": "dead-time, minutes=5"})
@example({"controller": {"output_weight": 10**400}})
@example({"controller": [{"name": "mpc", "guard": {"max_hour": 2}, "model": "memory=48"}]})
@example({"sensor": ["ideal", {"name": "lag", "lag_min": 8}, "white-noise, variance=1.45"], "guard": {"max_hour": 2}})
@example({"faults": ["missing, start_min=60", {"name": "calibration", "gain": 1.3}], "guard": "none"})
@example({"meals": ["1" * 50_000]})
@example({"seed": 2**400})
@settings(max_examples=200)
def test_run(refusal, keys):
    if refusal(read_run, keys) is None:
        run, again = read_again(read_run, "run", keys)
        assert again == run


@given(keys_among(Comparison), st.lists(parts | named, max_size=3))
@example({}, [{"label": "a\nb"}, {"label": "b"}])
@example({"guard": "max_hour=2"}, [{"label": "a"}, {"name": "imc", "guard": "none"}])
@settings(max_examples=100)
def test_comparison(refusal, keys, cases):
    keys = {**keys, "controller": [{"label": "one"}, *cases]}
    if refusal(read_comparison, keys) is None:
        comparison, again = read_again(read_comparison, "compare", keys)
        assert again == comparison


@given(keys_among(ModelRequest))
@example({"sample_time_min": 1e-320})
@settings(max_examples=150)
def test_identification(refusal, keys):
    if refusal(read_identification, keys) is None:
        identification, again = read_again(read_identification, "identify", keys)
        assert again == identification


@pytest.mark.long
@given(keys_among(Trial), st.lists(parts | named, max_size=2))
@example({"traces": "9" * 5000}, [])
@example({"sample_time_min": 1e-310}, [])
@example({"sensor": {"name": "dead-time", "minutes": 10**400}}, [])
@settings(max_examples=200)
def test_trial(refusal, keys, cases):
    keys = {**keys, **({"controller": cases} if cases else {})}
    if refusal(read_trial, keys) is None:
        trial, again = read_again(read_trial, "trial", keys)
        assert again == trial


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
strange = st.dictionaries(
    st.sampled_from(["parameter", "distribution", "spread_pct"]) | st.text(max_size=5), values, max_size=4
)


@given(st.lists(tables | strange, max_size=3), st.text(max_size=3))
@example([{"parameter": "weight_kg", "distribution": "uniform", "centre": 1e308, "spread": 1e308}], "people")
@settings(max_examples=200)
def test_population_can_only_make_finite_people(refusal, tables, name):
    keys = {"name": name, "vary": tables}
    if refusal(read_population, keys) is None:
        for distribution in read_population(keys).distributions().values():
            assert -1e308 < distribution.lower < distribution.upper < 1e308


@pytest.mark.parametrize("value", [float("inf"), float("-inf"), float("nan")])
def test_setting_that_is_not_finite_is_refused_by_its_own_name(refusal, value):
    told = refusal(read_run, {"controller": {"name": "mpc", "output_weight": value}})
    assert told == f"mpc: output_weight is {value:g}; give a finite number above 0"


def test_short_sample_time_is_refused_for_itself_and_not_for_what_follows_from_it(refusal):
    for read in (read_run, read_identification, read_trial):
        assert refusal(read, {"sample_time_min": 0.001}) == (
            "sample_time_min is 0.001 min; give a number from 0.1 to 120 min"
        )
        assert refusal(read, {"sample_time_min": 0.1, "allow_unusual": True}) is None
