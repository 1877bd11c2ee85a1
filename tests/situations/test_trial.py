"""Trials come back from their files, and refuse by name."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from glucoloop.meals import Meal
from glucoloop.patients.population import population
from glucoloop.situations.situation import configured
from glucoloop.situations.toml import read_toml, toml_text
from glucoloop.trials.trial import Trial, fingerprint

keys = st.fixed_dictionaries(
    {},
    optional={
        "population": st.sampled_from(
            ["nominal", "lognormal", {"vary": [{"parameter": "F_LC", "distribution": "uniform", "spread_pct": 10.0}]}]
        ),
        "people": st.integers(50, 10**9),
        "first_person": st.integers(0, 10**6),
        "seed": st.integers(0, 2**32 - 1),
        "meals": st.lists(st.tuples(st.floats(0.1, 200), st.floats(60, 1300)).map(lambda m: f"{m[0]!r}g@{m[1]!r}min")),
        "days": st.integers(1, 30),
        "meal_size_spread_pct": st.floats(0, 99),
        "meal_time_spread_min": st.floats(0, 60),
        "announce_meals": st.booleans(),
        "setpoint_mg_dl": st.floats(40, 400),
        "sensor": st.floats(0, 100).map(lambda of: [{"name": "white-noise", "variance": of}, "dead-time, minutes=10"]),
        "pump": st.floats(0.01, 5).map(lambda of: {"resolution_mU_min": of}),
        "precision": st.sampled_from(["float32", "float64"]),
        "arithmetic": st.sampled_from(["fused", "portable"]),
        "design": st.sampled_from(["nominal", "individual"]),
        "traces": st.sampled_from(["none", "all", 1, 50]),
        "shard_people": st.integers(1, 10**6),
        "model": st.integers(2, 99).map(lambda of: {"memory": of}),
        "controller": st.lists(st.sampled_from(["mpc-se", "imc", "basal", "mpc, label='b, c', move_weight=3"]),
                               unique=True).map(lambda of: ["mpc", *of]),
    },
)  # fmt: skip


@pytest.mark.long
@given(keys)
def test_trial_comes_back_from_its_file(keys):
    trial = configured(Trial, keys)
    written = read_toml(toml_text(trial.tree(whole=True), "trial --config trial.toml", trial.tree()), "trial.toml")
    again = configured(Trial, written.keys)
    assert again == trial
    assert again.tree() == trial.tree()
    assert fingerprint(again) == fingerprint(trial)
    assert set(trial.explicit) == set(keys)


def test_trial_without_keys_is_a_day_of_linear_mpc():
    trial = configured(Trial)
    assert trial.population == population("parker2000")
    assert trial.plan.meals == (Meal(45.0, 420.0), Meal(70.0, 720.0), Meal(60.0, 1080.0))
    assert trial.plan.horizon_min == 1440.0
    assert [(case.label, case.controller.name) for case in trial.cases] == [("mpc", "mpc")]
    assert (trial.people, trial.design, trial.precision, trial.traces) == (1000, "nominal", "float64", "none")
    assert trial.samples == 288


def test_shorter_run_has_the_usual_meals_that_begin_in_it():
    assert configured(Trial, duration_min=600.0).plan.meals == (Meal(45.0, 420.0),)
    assert configured(Trial, days=3).plan.meals == configured(Trial).plan.meals


def test_noise_changes_the_usual_tuning_and_the_record():
    [case] = configured(Trial, sensor="white-noise, variance=1.45").cases
    assert case.tuning["prediction_horizon"] == 10
    assert case.model.noise_variance == 1.45
    [case] = configured(Trial, controller="mpc-se").cases
    assert case.model is None


def test_population_of_a_file(tmp_path):
    (tmp_path / "people.toml").write_text(
        "[[vary]]\nparameter = 'weight_kg'\ndistribution = 'lognormal'\nspread_pct = 15\n"
    )
    trial = configured(Trial, population=str(tmp_path / "people.toml"))
    assert [v.parameter for v in trial.population.variations] == ["weight_kg"]
    assert configured(Trial, trial.tree()) == trial


def test_confirmation_is_no_part_of_what_a_trial_is():
    assert fingerprint(configured(Trial)) == fingerprint(configured(Trial, allow_unusual=True))


REFUSED = [
    ({"peple": 3}, "a trial has no setting 'peple'; did you mean 'people'"),
    ({"integrator": "fast"}, "a trial has no setting 'integrator'"),
    ({"people": 0}, "people is 0; give a whole number from 1 to 1000000000"),
    ({"people": 2.5}, "people is 2.5; give a whole number"),
    ({"days": 0}, "days is 0; give a whole number from 1 to 366"),
    ({"days": 2, "duration_min": 600.0}, "days and duration_min both tell the length"),
    ({"duration_min": 601.0}, "601 min is not a whole number of samples"),
    ({"meals": ["50g@25h"]}, "the meal at 1500 min begins after the run ends"),
    ({"meal_size_spread_pct": 100.0}, "meal_size_spread_pct is 100 %; give a number of 0 % or more and below 100 %"),
    ({"meal_time_spread_min": 500.0}, "can begin at -80 min"),
    ({"meals": "50g@7h"}, "meals is '50g@7h'; give a list"),
    ({"population": "parker"}, "unknown population 'parker'"),
    ({"population": 3}, "population is 3; give nominal, parker2000, lognormal, or a file"),
    ({"population": {"vary": [{"parameter": "F_LC"}]}}, "[[vary]] number 1: distribution is missing"),
    ({"arithmetic": "exact"}, "arithmetic is 'exact'; give fused or portable"),
    ({"precision": "float16"}, "precision is 'float16'; give float32 or float64"),
    ({"design": "own"}, "design is 'own'"),
    ({"traces": "some"}, "traces is 'some'; give none, all, or the number"),
    ({"traces": 0}, "traces is 0"),
    ({"traces": True}, "traces is True"),
    ({"people": 10, "traces": 11}, "traces of 11 people"),
    ({"first_person": -1}, "first_person is -1"),
    ({"shard_people": 0}, "shard_people is 0"),
    ({"sensor": "dead-time, minutes=7"}, "7 min is not a whole number"),
    ({"controller": ["mpc", "mpc"]}, "two cases are called 'mpc'"),
    ({"controller": ["mpx"]}, "unknown controller 'mpx'; did you mean 'mpc'"),
    ({"controller": 3}, "3 is no controller; give a text like 'mpc-se, move_horizon=2', or a table"),
    ({"controller": {"name": "mpc", "label": "a", "people": 3}}, "the controller mpc has no setting 'people'"),
    ({"controller": [{"name": "mpc", "move_weight": "high"}]}, "mpc: move_weight is 'high'; give a finite number"),
]


@pytest.mark.parametrize(("keys", "told"), REFUSED, ids=[str(keys)[:60] for keys, _ in REFUSED])
def test_refusals(keys, told):
    with pytest.raises(ValueError, match=r".") as refused:
        configured(Trial, keys)
    assert told in str(refused.value)
