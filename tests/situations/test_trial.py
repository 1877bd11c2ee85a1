"""Trials come back from their files, and refuse by name."""

import tomllib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from glucoloop.situations.toml import toml_text
from glucoloop.config.trial import overlay_trial, read_trial, trial_keys
from glucoloop.meals import Meal
from glucoloop.patients.population import population

keys = st.fixed_dictionaries(
    {"allow_unusual": st.just(True)},  # so that any possible value comes back
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
        "noise_variance": st.floats(0, 100),
        "dead_time_min": st.integers(0, 10).map(lambda k: 5.0 * k),
        "pump_resolution_mU_min": st.floats(0.01, 5),
        "min_bolus_U": st.floats(0.0, 0.5),
        "precision": st.sampled_from(["float32", "float64"]),
        "arithmetic": st.sampled_from(["fused", "portable"]),
        "design": st.sampled_from(["nominal", "individual"]),
        "traces": st.sampled_from(["none", "all", 1, 50]),
        "shard_people": st.integers(1, 10**6),
        "prediction_horizon": st.integers(2, 100),
        "known_dead_time": st.booleans(),
        "memory": st.integers(2, 99),
        "controllers": st.lists(st.sampled_from(["mpc-se", "imc", "basal"]), unique=True).map(lambda of: ["mpc", *of]),
    },
)


@given(keys, st.lists(st.sampled_from([{"label": "a"}, {"label": "b, c", "move_weight": 3}]), unique_by=str))
def test_trial_comes_back_from_its_file(keys, cases):
    trial = read_trial(keys, cases)
    read = tomllib.loads(toml_text(trial_keys(trial), "trial --config trial.toml"))
    assert read.pop("glucoloop")
    assert read_trial(read, read.pop("case")) == trial


def test_trial_without_keys_is_a_day_of_linear_mpc():
    trial = read_trial({})
    assert trial.population == population("parker2000")
    assert trial.plan.meals == (Meal(45.0, 420.0), Meal(70.0, 720.0), Meal(60.0, 1080.0))
    assert trial.plan.horizon_min == 1440.0
    assert [(case.label, case.controller) for case in trial.cases] == [("mpc", "mpc")]
    assert (trial.people, trial.design, trial.precision, trial.traces) == (1000, "nominal", "float64", "none")
    assert trial.samples == 288


def test_shorter_run_has_the_usual_meals_that_begin_in_it():
    assert read_trial({"duration_min": 600.0}).plan.meals == (Meal(45.0, 420.0),)
    assert read_trial({"days": 3}).plan.meals == read_trial({}).plan.meals


def test_settings_beside_the_cases_hold_for_those_that_have_them():
    trial = read_trial({"move_weight": 2.0, "controllers": ["mpc", "imc"]}, [{"label": "own", "move_weight": 5.0}])
    weights = {case.label: case.tuning.get("move_weight") for case in trial.cases}
    assert weights == {"mpc": 2.0, "imc": None, "own": 5.0}


def test_noise_changes_the_usual_tuning_and_the_record():
    [case] = read_trial({"noise_variance": 1.45}).cases
    assert case.tuning["prediction_horizon"] == 10
    assert case.model_noise_variance == 1.45
    [case] = read_trial({"controllers": ["mpc-se"]}).cases
    assert case.memory is None


def test_population_of_a_file(tmp_path):
    (tmp_path / "people.toml").write_text(
        "[[vary]]\nparameter = 'weight_kg'\ndistribution = 'lognormal'\nspread_pct = 15\n"
    )
    trial = read_trial({"population": str(tmp_path / "people.toml")})
    assert [v.parameter for v in trial.population.variations] == ["weight_kg"]
    again = trial_keys(trial)
    assert read_trial(again, again.pop("case")) == trial


def test_upper_layer_takes_what_it_excludes_away():
    assert overlay_trial({"days": 3, "seed": 1}, {"duration_min": 600.0}) == {"seed": 1, "duration_min": 600.0}
    assert overlay_trial({"duration_min": 600.0}, {"days": 3}) == {"days": 3}
    assert overlay_trial({"shard_people": 64}, {"people": 10**6}) == {"shard_people": 64, "people": 10**6}


REFUSED = [
    ({"peple": 3}, "unknown key 'peple' of a trial; did you mean 'people'"),
    ({"integrator": "fast"}, "unknown key 'integrator' of a trial, though a run has it; leave it out"),
    ({"controller": "mpc"}, "unknown key 'controller' of a trial; did you mean 'controllers'"),
    ({"model": "m.json"}, "unknown key 'model'"),
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
    ({"dead_time_min": 7.0}, "7 min is not a whole number"),
    ({"controllers": ["mpc", "mpc"]}, "two cases are called 'mpc'"),
    ({"controllers": ["mpx"]}, "case 'mpx': unknown controller 'mpx'"),
    ({"controllers": "mpc"}, "controllers is 'mpc'; give a list of names"),
    ({"controllers": ["mpc"] * 21}, "a trial of 21 controllers"),
]


@pytest.mark.parametrize(("keys", "told"), REFUSED, ids=[str(keys)[:60] for keys, _ in REFUSED])
def test_refusals(keys, told):
    with pytest.raises(ValueError, match=r".") as refused:
        read_trial(keys)
    assert told in str(refused.value)


@pytest.mark.parametrize(
    ("case", "told"),
    [
        ({"controller": "mpc"}, "has no label"),
        ({"label": " "}, "has no label"),
        ({"label": "a", "noise_variance": 1.0}, "case 'a': noise_variance belongs to the trial"),
        ({"label": "a", "population": "nominal"}, "case 'a': population belongs to the trial"),
        ({"label": "a", "move_wait": 1.0}, "case 'a': unknown key 'move_wait'; did you mean 'move_weight'"),
        ({"label": "a", "model": "m.json"}, "case 'a': unknown key 'model'"),
        ({"label": "a", "move_weight": "high"}, "case 'a': move_weight is 'high'; give a finite number"),
    ],
)
def test_cases_are_refused_by_their_label(case, told):
    with pytest.raises(ValueError, match=r".") as refused:
        read_trial({}, [case])
    assert told in str(refused.value)


def test_options_are_called_as_they_were_given():
    with pytest.raises(ValueError, match=r"^--meal-size-spread is -1 %; give"):
        read_trial({"meal_size_spread_pct": -1.0}, names={"meal_size_spread_pct": "--meal-size-spread"})
    with pytest.raises(ValueError, match=r"^--traces is 'x'"):
        read_trial({"traces": "x"}, names={"traces": "--traces"})
