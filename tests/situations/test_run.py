"""Configurations come back as they were written, and refuse by name."""

import re
import tomllib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from glucoloop.config.comparison import read_comparison
from glucoloop.config.identification import identification_keys, overlay_identification, read_identification
from glucoloop.config.run import overlay, read_run
from glucoloop.situations.toml import read_toml, toml_text
from glucoloop.meals import Meal

keys = st.fixed_dictionaries(
    {"allow_unusual": st.just(True)},  # so that any possible value comes back
    optional={
        "setpoint_mg_dl": st.floats(40, 400),
        "meals": st.lists(st.tuples(st.floats(0.1, 200), st.floats(0, 500)).map(lambda m: f"{m[0]!r}g@{m[1]!r}min")),
        "announce_meals": st.booleans(),
        "duration_min": st.integers(1, 20000).map(lambda k: 5.0 * k),
        "noise_variance": st.floats(0, 100),
        "dead_time_min": st.integers(0, 10).map(lambda k: 5.0 * k),
        "pump_resolution_mU_min": st.floats(0.01, 5),
        "max_bolus_U": st.floats(5, 30),
        "bolus_step_U": st.floats(0.01, 1),
        "integrator": st.sampled_from(["fast", "adaptive"]),
        "seed": st.integers(0, 2**32 - 1),
        "prediction_horizon": st.integers(2, 100),
        "output_weight": st.floats(0, 10, exclude_min=True),
        "constraints": st.sampled_from(["clip", "qp"]),
        "known_dead_time": st.booleans(),
    },
)
model = st.one_of(st.just({}), st.just({"model": "model.json"}), st.fixed_dictionaries({"memory": st.integers(2, 99)}))


@given(keys, model)
def test_run_comes_back_from_its_file(keys, model):
    run = read_run({**keys, **model})
    read, version, _ = read_toml(toml_text(run.keys(), "run --config run.toml"), "run.toml")
    assert version is not None
    assert read_run(read) == run


@given(keys)
def test_comparison_comes_back_from_its_file(keys):
    comparison = read_comparison(keys, [{"label": "a"}, {"label": "b, c", "move_weight": 3}])
    read = tomllib.loads(toml_text(comparison.keys(), ""))
    read.pop("glucoloop")
    assert read_comparison(read, read.pop("case")) == comparison


@pytest.mark.parametrize(
    "keys", [{}, {"best_pole": True}, {"data": "r.csv", "method": "csrs"}, {"sample_time_min": 10, "samples": 100}]
)
def test_identification_comes_back_from_its_file(keys):
    config = read_identification(keys)
    read, *_ = read_toml(toml_text(identification_keys(config), ""), "identify.toml")
    again = read_identification(read)
    assert identification_keys(again) == identification_keys(config)


def test_complete_configuration_is_told_whole():
    run = read_run({})
    assert run.situation.eaten() == (Meal(50.0, 50.0),)
    assert run.case.tuning == {
        "move_horizon": 2, "prediction_horizon": 8, "output_weight": 1.0, "move_weight": 0.0, "constraints": "clip",
        "glucose_floor_mg_dl": 0.0, "floor_weight": 10.0,
    }  # fmt: skip


def test_upper_layer_takes_what_it_excludes_away():
    lower = {"memory": 30, "laguerre_pole": 0.8, "seed": 1}
    assert overlay(lower, {"model": "m.json"}) == {"seed": 1, "model": "m.json"}
    assert overlay({"model": "m.json"}, {"memory": 30}) == {"memory": 30}
    assert overlay_identification({"noise_variance": 1.0}, {"data": "r.csv"}) == {"data": "r.csv"}
    assert overlay_identification({"data": "r.csv", "method": "csrs"}, {"samples": 80}) == {"samples": 80}
    assert overlay_identification({"laguerre_pole": 0.8}, {"best_pole": True}) == {"best_pole": True}


def test_layer_that_contradicts_itself_is_refused():
    with pytest.raises(ValueError, match="memory tells how a model is identified, but the model comes from"):
        overlay({"model": "m.json", "memory": 30}, {})


@pytest.mark.parametrize("sample_time", [0, -5, "5", None, True, 1e6])
def test_wrong_sample_time_is_refused_by_name(sample_time):
    for read in (read_run, read_identification):
        with pytest.raises(ValueError, match="sample_time_min is"):
            read({"sample_time_min": sample_time})


@pytest.mark.parametrize(
    ("keys", "sentence"),
    [
        ({"prediction_horizon": 1}, "a prediction horizon of 1 is not possible with a move horizon of 2"),
        ({"output_weight": 0.0}, "output_weight is 0; give a finite number above 0"),
        ({"controller": "meal-mpc", "meals_by_time": "often"}, "'often' is no finite number; write values"),
        ({"controller": "meal-mpc", "meals_by_time": "0@22:00"}, "0 meals per hour from 22:00 on are not possible"),
        ({"guard": True, "guard_gap_min": -1.0}, "guard_gap_min is -1 min; give a number from 0 to 10000 min"),
        ({"guard": True, "guard_gap_min": 100.0}, "long_gap_min of 90 is less than its gap_min of 100"),
    ],
)
def test_what_a_part_refuses_is_refused_before_anything_is_designed(keys, sentence):
    with pytest.raises(ValueError, match=re.escape(sentence)):
        read_run(keys)
