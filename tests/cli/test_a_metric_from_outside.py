"""A metric that another package brings is in the table and the JSON of a run, and a column of a trial."""

import jax.numpy as jnp
import numpy as np
import polars as pl
import pytest

from glucoloop.metrics import RunningMetrics
from glucoloop.metrics.metric import METRICS, Result, default_results, metrics_with

NAME = "your_own_metric:TightRange"
SHORT = ("--controller", "basal", "--duration", "60", "--meal", "50g@10min", "--metric")


@pytest.fixture
def outside(install, tmp_path):
    """A folder with the module, and an entry point that names it."""
    install("your_own_metric", "metrics", "tight-range", "TightRange")
    return tmp_path


def test_it_is_found_by_its_entry_point_and_by_its_place(outside):
    assert "tight-range" in METRICS.names()
    assert METRICS.find("tight-range") == METRICS.find(NAME)


@pytest.mark.long
@pytest.mark.parametrize("name", ["tight-range", NAME])
def test_it_is_in_the_table_and_in_json(outside, glucoloop, name):
    told = glucoloop("run", *SHORT, name, "--json")
    assert told.code == 0, told.err
    assert told.json["config"]["metrics"] == [{"name": name, "low_mg_dl": 70, "high_mg_dl": 140}]
    metrics = told.json["metrics"]
    assert list(metrics) == [*(result.name for result in default_results()), "time_70_140_pct"]
    # glucose begins at 81 mg/dl and rises after the meal, without falling below 70
    assert metrics["minimum_mg_dl"] > 70.0
    assert 0.0 < metrics["time_70_140_pct"] <= 100.0
    if metrics["peak_mg_dl"] <= 140.0:
        assert metrics["time_70_140_pct"] == 100.0
    table = glucoloop("run", *SHORT, name).out
    assert "Further metrics" in table
    assert "Time from 70 to 140 mg/dl" in table


@pytest.mark.long
def test_it_is_a_column_of_a_trial_and_agrees_with_the_run(outside, glucoloop, tmp_path):
    of_trial = ("--population", "nominal", "--people", "2", "--out", "people", "--json")
    told = glucoloop("trial", *SHORT, NAME, *of_trial)
    assert told.code == 0, told.err
    column = pl.read_parquet(tmp_path / "people/shards/*/people.parquet")["time_70_140_pct"]
    alone = glucoloop("run", *SHORT, NAME, "--json").json["metrics"]["time_70_140_pct"]
    np.testing.assert_allclose(column.to_numpy(), alone, rtol=1e-9)
    assert told.json["controllers"]["basal"]["metrics"]["time_70_140_pct"]["median"] == pytest.approx(alone)
    assert "another" in glucoloop("trial", *SHORT[:-1], *of_trial).err  # without it, it is another trial


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("no_such_module:X", "no_such_module cannot be imported"),
        ("your_own_metric:Result", "your_own_metric:Result is no metric: make it a class of Metric"),
        ("nothing", "unknown metric 'nothing'"),
        (f"{NAME}, lows=1", "the metric tight-range has no setting 'lows'; the known ones are: low_mg_dl, high_mg_dl"),
        (f"{NAME}, low_mg_dl=-1", "low_mg_dl is -1 mg/dl; give a whole number of 0 mg/dl or more"),
    ],
)
def test_what_is_wrong_is_told(outside, refused, name, told):
    assert told in refused("run", *SHORT, name)


def test_a_metric_that_is_asked_for_twice_is_refused(outside, refused):
    told = refused("run", *SHORT, NAME, "--metric", "tight-range")
    assert "the metric tight-range gives time_70_140_pct, which the metric tight-range gives already" in told


def test_two_ranges_are_two_metrics(outside):
    fold = RunningMetrics(setpoint_mg_dl=80.0, inside_min=(1.0,), further=(NAME, f"{NAME}, low_mg_dl=140"))
    assert [metric.results[0].title for metric in metrics_with(fold.further)][-2:] == [
        "Time from 70 to 140 mg/dl",
        "Time from 140 to 140 mg/dl",
    ]
    tally = fold.init(jnp.array([139.0, 140.0]), jnp.zeros(2))  # the first of two points
    found = fold.finish(tally, samples=1, sample_time_min=1.0, meal_t_min=0.0)
    np.testing.assert_array_equal(found.time_70_140_pct, [50.0, 50.0])
    np.testing.assert_array_equal(found.time_140_140_pct, [0.0, 50.0])


def test_it_is_computed_from_python_too(outside):
    fold = RunningMetrics(setpoint_mg_dl=80.0, inside_min=(1.0,), further=(NAME,))
    tally = fold.init(jnp.array([139.0, 141.0, jnp.nan]), jnp.zeros(3))
    found = fold.finish(tally, samples=1, sample_time_min=1.0, meal_t_min=0.0)
    np.testing.assert_array_equal(found.time_70_140_pct, [50.0, 0.0, np.nan])  # of the first of two points
    with pytest.raises(AttributeError, match="there is no metric 'time_70_141_pct'"):
        _ = found.time_70_141_pct


def test_results_that_the_entry_does_not_say_are_refused(outside, monkeypatch):
    module = __import__("your_own_metric")

    class Other(module.TightRange, name="other"):
        results = (Result("something_else", ""), Result("another", ""))

    monkeypatch.setattr(module, "Other", Other, raising=False)
    fold = RunningMetrics(setpoint_mg_dl=80.0, inside_min=(1.0,), further=("your_own_metric:Other",))
    tally = fold.init(jnp.asarray(100.0), jnp.asarray(0.0))
    with pytest.raises(ValueError, match="gives something_else, but its entry says another, something_else"):
        fold.finish(tally, samples=1, sample_time_min=1.0, meal_t_min=0.0)


def test_a_name_that_cannot_be_a_column_is_refused():
    with pytest.raises(ValueError, match="'time in range' cannot name the result of a metric"):
        Result("time in range", "")
