"""Runs come back from their files, and refuse by name."""

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from glucoloop.meals import Meal
from glucoloop.situations.run import Run
from glucoloop.situations.situation import configured
from glucoloop.situations.toml import read_toml, toml_text

number = st.floats(0, 100)
keys = st.fixed_dictionaries(
    {},
    optional={
        "allow_unusual": st.booleans(),
        "setpoint_mg_dl": st.floats(40, 400),
        "meals": st.lists(st.tuples(st.floats(0.1, 200), st.floats(0, 500)).map(lambda m: f"{m[0]!r}g@{m[1]!r}min")),
        "announce_meals": st.booleans(),
        "duration_min": st.integers(101, 20000).map(lambda k: 5.0 * k),
        "sensor": st.tuples(number, st.integers(0, 10)).map(
            lambda of: [{"name": "white-noise", "variance": of[0]}, f"dead-time, minutes={5 * of[1]}"]
        ),
        "pump": st.fixed_dictionaries(
            {},
            optional={
                "name": st.sampled_from(["limited", "expiring"]),
                "resolution_mU_min": st.floats(0.01, 5),
                "max_bolus_U": st.floats(5, 30),
                "bolus_step_U": st.floats(0.01, 1),
            },
        ),
        "faults": st.just(["missing, start_min=60"]),
        "guard": st.sampled_from(["none", "usual", {"max_hour": 2.0}, "usual, low_mg_dl=70"]),
        "integrator": st.sampled_from(["fast", "adaptive"]),
        "seed": st.integers(0, 2**32 - 1),
    },
)
case = st.fixed_dictionaries(
    {"name": st.just("mpc")},
    optional={
        "prediction_horizon": st.integers(2, 100),
        "output_weight": st.floats(0, 10, exclude_min=True),
        "constraints": st.sampled_from(["clip", "qp"]),
        "known_dead_time": st.booleans(),
        "guard": st.sampled_from(["none", "usual", {"max_hour": 2.0}]),
        "model": st.sampled_from(["model.json", {"memory": 48}, "noise_variance=0"]),
    },
)


@pytest.mark.long
@given(keys, st.lists(case, max_size=3))
def test_a_run_comes_back_from_its_file_and_knows_what_was_given(keys, cases):
    labelled = [{**of, "label": f"case {number}"} for number, of in enumerate(cases)]
    run = configured(Run, keys, **({"controller": labelled} if labelled else {}))
    written = read_toml(toml_text(run.tree(whole=True), "run --config run.toml", run.tree()), "run.toml")
    assert written.version is not None
    again = configured(Run, written.keys)
    assert again == run
    assert again.tree() == run.tree()
    assert again.tree(whole=True) == run.tree(whole=True)
    assert again.cases == run.cases
    assert set(run.explicit) == {*keys, *(("controller",) if labelled else ())}


def test_a_run_without_keys_is_that_of_the_paper():
    run = configured(Run)
    assert run.eaten() == (Meal(50.0, 50.0),)
    assert run.case.tuning == {
        "move_horizon": 2, "prediction_horizon": 8, "output_weight": 1.0, "move_weight": 0.0, "constraints": "clip",
        "glucose_floor_mg_dl": 0.0, "floor_weight": 10.0,
    }  # fmt: skip
    assert configured(Run) == Run()


def test_a_controller_may_have_its_own_guard_and_model_or_none():
    run = configured(
        Run,
        guard="max_hour=3",
        model="memory=40",
        controller=[
            "mpc",
            "mpc, label=own, guard=(max_hour=2), model=(memory=48)",
            "mpc, label=bare, guard=none",
            "pid",
        ],
    )
    assert [case.guard and case.guard.max_hour for case in run.cases] == [3.0, 2.0, None, 3.0]
    assert [case.model and case.model.memory for case in run.cases] == [40, 48, 40, None]
    with pytest.raises(ValueError, match="a model is given, but none of these controllers uses one: pid"):
        configured(Run, controller="pid", model="memory=40")


@pytest.mark.parametrize("sample_time", [0, -5, "5", None, True, 1e6])
def test_wrong_sample_time_is_refused_by_name(sample_time):
    with pytest.raises(ValueError, match="sample_time_min is"):
        configured(Run, sample_time_min=sample_time)


@pytest.mark.parametrize(
    ("keys", "sentence"),
    [
        (
            {"controller": "mpc, prediction_horizon=1"},
            "a prediction horizon of 1 is not possible with a move horizon of 2",
        ),
        ({"controller": {"output_weight": 0.0}}, "output_weight is 0; give a finite number above 0"),
        ({"controller": "meal-mpc, meals_by_time=often"}, "'often' is no finite number; write values"),
        ({"controller": "meal-mpc, meals_by_time=0@22:00"}, "0 meals per hour from 22:00 on are not possible"),
        ({"guard": {"gap_min": -1.0}}, "gap_min is -1 min; give a number from 0 to 10000 min"),
        ({"guard": {"gap_min": 100.0}}, "long_gap_min of 90 is less than its gap_min of 100"),
        ({"controller": ["mpc", "mpc"]}, "two cases are called 'mpc'; give each a label of its own"),
        ({"controller": [f"mpc, label=a{k}" for k in range(21)]}, "21 controllers at once are too many"),
        ({"controller": ["pid", "mpc, label=far, prediction_horizon=1"]}, "case 'far': a prediction horizon of 1"),
        ({"sensor": ["lag", "ideal"]}, "an ideal sensor is the innermost of a chain"),
        ({"sensor": "ideal, site=nowhere"}, "cannot be read at the site 'nowhere'; give arterial or interstitial"),
        ({"sensor": {"lag_min": 3.0}}, "no sensor is named; begin with its name, like 'white-noise, variance=1.45'"),
        ({"patient": "operating_point=here"}, "unknown operating point 'here' of parker-1999"),
        ({"meals": [["50g@50min"]]}, "meals is ('50g@50min',); give a text"),
        ({"meal_model": 3}, "3 is no meal model; give a text like 'hovorka, time_to_maximum_min=55', or a table"),
        ({"carb_error_pct": 20.0}, "concerns announced meals only; announce the meals (--announce-meals)"),
        ({"faults": ["missing, start_min=11h"]}, "begins at 660 min, but the run ends at 600 min"),
    ],
)
def test_what_a_part_refuses_is_refused_before_anything_is_designed(keys, sentence):
    with pytest.raises(ValueError, match=re.escape(sentence)):
        _ = configured(Run, keys).cases
