"""What was given and changes nothing is told: each option of a situation changes numbers, or there is a note."""

import contextlib
import dataclasses
import importlib
import warnings

import jax.numpy as jnp
import numpy as np
import pytest

import glucoloop as gl
from glucoloop.cli.command import options_of
from glucoloop.cli.request import notes_without_effect
from glucoloop.component.effects import OF_CONTROLLERS, NoEffectWarning
from glucoloop.control import guarded
from glucoloop.control.catalogue import CONTROLLERS
from glucoloop.control.guard_settings import GUARDS
from glucoloop.control.protocol import uses_of
from glucoloop.estimation.unknown_meal.protocol import ESTIMATORS
from glucoloop.faults.fault import FAULTS
from glucoloop.meals.habits import HABITS
from glucoloop.meals.models import MEAL_MODELS
from glucoloop.meals.rescue import RESCUES
from glucoloop.physiology import RHYTHMS
from glucoloop.pumps import PUMPS
from glucoloop.refusal import Refusal
from glucoloop.sensors import SENSORS, DeadTime, Lag
from glucoloop.situations.run import Run
from glucoloop.situations.situation import configured
from glucoloop.situations.unused import without_effect
from glucoloop.studies.catalogue import STUDIES
from glucoloop.studies.closed_loop import close_the_loop
from glucoloop.tuning.samplers import SAMPLERS
from requests_read import asked

NOTED = [
    (("run", "--announce-meals"), "--announce-meals has no effect: the controller mpc does not use announcements"),
    (("run", "--announce-meals", "--announce-before", "20"), "--announce-before has no effect: the controller mpc"),
    (
        ("run", "--announce-meals", "--announce-before", "20", "--controller", "meal-mpc"),
        "--announce-before has no effect: the controller meal-mpc does not use announcements before a meal is eaten",
    ),
    (("run", "--announce-meals", "--carb-error", "20"), "--carb-error has no effect: the controller mpc"),
    (("run", "--announce-meals", "--carb-bias", "20"), "--carb-bias has no effect: the controller mpc"),
    (("run", "--announce-meals", "--habit", "unannounced"), "The habit unannounced has no effect: the controller mpc"),
    (("run", "--announce-meals", "--meal", "none"), "--announce-meals has no effect: there is no meal."),
    (("run", "--meal-size-spread", "9", "--meal", "none"), "--meal-size-spread has no effect: there is no meal."),
    (("run", "--meal-time-spread", "9", "--meal", "none"), "--meal-time-spread has no effect: there is no meal."),
    (("run", "--meal-model", "hovorka", "--meal", "none"), "--meal-model has no effect: there is no meal."),
    (("run", "--exercise-spread", "9"), "--exercise-spread has no effect: there is no exercise."),
    (("run", "--exercise-time-spread", "9"), "--exercise-time-spread has no effect: there is no exercise."),
    (("run", "--start", "06:00"), "--start has no effect: the controller mpc does not use the time of day"),
    (("run", "--seed", "3"), "--seed has no effect: nothing is drawn at random."),
    (("run", "--controller", "pid", "--forecasts"), "--forecasts has no effect: the controller pid does not use fore"),
    (("run", "--pump", "max_bolus_U=5"), "max_bolus_U of the pump limited has no effect: the controller mpc does not"),
    (
        ("run", "--pump", "max_glucagon_ug=9"),
        "max_glucagon_ug of the pump limited has no effect: no glucagon",
    ),
    (
        ("run", "--pump", "glucagon_step_ug=1"),
        "glucagon_step_ug of the pump limited has no effect: no glucagon",
    ),
    (
        ("run", "--guard", "max_glucagon_hour_ug=9"),
        "max_glucagon_hour_ug of the guard usual has no effect: no glucagon",
    ),
    (
        ("run", "--guard", "max_glucagon_day_ug=9"),
        "max_glucagon_day_ug of the guard usual has no effect: no glucagon",
    ),
    (("run", "--controller", "known_dead_time=true"), "known_dead_time of the case has no effect: readings have no"),
    (
        ("run", "--patient", "hovorka-2004", "--controller", "mpc, move_horizon=20, known_dead_time=true"),
        "known_dead_time of the case has no effect: readings have no",
    ),
    (("run", "--controller", "basal", "--noise", "2"), "The sensor white-noise has no effect on insulin and glucose"),
    (("run", "--controller", "basal", "--fault", "missing"), "The fault missing has no effect on insulin and glucose"),
    (("run", "--noise", "0", "--sensor", "white-noise, bound_mg_dl=3"), "bound_mg_dl of the sensor white-noise has no"),
    (
        ("run", "--controller", "meal-mpc, meals_per_h=1, meals_by_time=0.6@06:30 0.02@22:00", "--start", "06:00"),
        "meals_per_h of the controller meal-mpc has no effect: meals_by_time takes its place.",
    ),
    (
        ("compare", "--controller", "mpc", "--controller", "pid", "--announce-meals"),
        "the controllers mpc and pid do not",
    ),
    (("run", "--profile-error", "ratio_pct=50"), "ratio_pct of the profile error wrong has no effect: the controller"),
    (("run", "--profile-error", "spread_pct=9"), "spread_pct of the profile error wrong has no effect: the controller"),
    (("trial", "--patient", "hovorka-2004", "--profile-by", "titration"), "--profile-by has no effect: the controller"),
    (("trial", "--margin", "time_70_180_pct=2"), "--margin has no effect: there is one controller alone."),
    (("trial", "--controller", "basal", "--design", "individual"), "--design has no effect: the controller basal does"),
    (("tune", "--announce-meals"), "--announce-meals has no effect: the controller mpc"),
    (("stress", "--announce-meals"), "--announce-meals has no effect: the controllers imc, mpc, mpc-se and nlqdmc-se"),
    (
        ("stress", "--guards", "without", "--guard", "max_hour=2"),
        "--guard has no effect: controllers are tried without",
    ),
    (("adversary", "--stuck-times", "0", "--stuck-for", "20"), "--stuck-for has no effect: no reading is stuck"),
    (("bound", "--undershoot-weight", "3"), "--undershoot-weight has no effect: squares are minimised for"),
    (("bound", "--patient", "hovorka-2004", "--profile-by", "titration"), "--profile-by has no effect: nothing doses"),
    (("identify", "--patient", "hovorka-2004", "--profile-by", "titration"), "--profile-by has no effect: nothing"),
    (
        ("run", "--patient", "hovorka-2004", "--controller", "basal-bolus, carb_ratio_g_U=9"),
        "carb_ratio_g_U of the controller basal-bolus has no effect: meals are not announced.",
    ),
    (
        ("run", "--patient", "hovorka-2004", "--controller", "pid-ifb, meal_bolus=0.5"),
        "meal_bolus of the controller pid-ifb has no effect: meals are not announced.",
    ),
    (("run", "--controller", "mpc, floor_weight=2"), "floor_weight of the controller mpc has no effect: glucose_floor"),
    (
        ("run", "--controller", "meal-mpc, caution_weight=0, caution_mg_dl=3"),
        "caution_mg_dl of the controller meal-mpc has no effect: caution_weight is 0.",
    ),
    (("run", "--controller", "oref0, enable_smb_with_cob=true"), "enable_smb_with_cob of the controller oref0 has no"),
    (("run", "--controller", "oref0, enable_smb_after_carbs=true"), "enable_smb_after_carbs of the controller oref0"),
    (
        ("run", "--controller", "oref0, enable_smb_high_bg=true"),
        "enable_smb_high_bg of the controller oref0 has no effect: enable_smb_always is on.",
    ),
    (
        ("run", "--controller", "oref0, enable_smb_always=false, enable_smb_high_bg_target_mg_dl=150"),
        "enable_smb_high_bg_target_mg_dl of the controller oref0 has no effect: enable_smb_high_bg is off.",
    ),
    *(
        (
            ("run", "--controller", f"oref0, enable_smb_always=false, {name}={value}"),
            f"{name} of the controller oref0 has no effect: no microboluses are enabled.",
        )
        for name, value in {
            "max_smb_basal_min": 60,
            "max_uam_smb_basal_min": 60,
            "smb_interval_min": 5,
            "bolus_increment_U": 0.05,
            "max_delta_bg_threshold": 0.3,
        }.items()
    ),
    *(
        (
            ("run", "--controller", f"oref0, {name}={value}"),
            f"{name} of the controller oref0 has no effect: no target is temporary.",
        )
        for name, value in {
            "allow_smb_with_high_temptarget": "true",
            "enable_smb_with_temptarget": "true",
            "high_temptarget_raises_sensitivity": "true",
            "exercise_mode": "true",
            "low_temptarget_lowers_sensitivity": "true",
            "half_basal_exercise_target_mg_dl": 140,
            "autosens_max": 1.3,
        }.items()
    ),
    (
        ("run", "--pump", "min_bolus_U=0.5"),
        "min_bolus_U of the pump limited has no effect: the controller mpc does not",
    ),
    (("run", "--pump", "bolus_step_U=0.5"), "bolus_step_U of the pump limited has no effect: the controller mpc does"),
    *(
        (("robust", "--noise", "0", option, "7"), f"{option} has no effect: nothing is drawn at random in a run of the")
        for option in ("--seeds", "--first-seed", "--check-seeds", "--check-first-seed")
    ),
    (("run", "--metric", "insulin-on-board"), "The metric insulin-on-board has no meaning: insulin is intravenous."),
    (("hil", "--baud", "9600"), "--baud has no effect: the chip is at no serial port."),
    (("hil", "--fallback", "suspend"), "--fallback has no effect: the chip always answers"),
    (("hil", "--announce-meals"), "--announce-meals has no effect: the controller mpc"),
]
EFFECTIVE = [
    ("run", "--profile-error", "basal_pct=50"),
    ("run", "--announce-meals", "--controller", "meal-mpc"),
    ("run", "--announce-meals", "--announce-before", "20", "--carb-error", "9", "--controller", "basal-bolus"),
    ("run", "--no-announce-meals", "--carb-error", "0", "--pump", "max_bolus_U=25"),
    ("run", "--glucagon", "threshold", "--guard", "max_glucagon_day_ug=50", "--pump", "glucagon_step_ug=5"),
    ("run", "--noise", "1.45", "--seed", "3"),
    ("run", "--forecasts"),
    ("compare", "--forecasts", "--controller", "mpc", "--controller", "pid"),
    ("run", "--patient", "hovorka-2004", "--metric", "insulin-on-board"),
    ("run", "--meal-size-spread", "20", "--seed", "3"),
    ("run", "--patient", "hovorka-2004", "--rhythm", "dawn", "--start", "06:00"),
    ("run", "--controller", "basal", "--guard", "--noise", "1.45"),
    ("run", "--controller", "basal", "--noise", "1.45", "--metric", "sensor-accuracy"),
    ("compare", "--controller", "mpc", "--controller", "basal-bolus", "--announce-meals"),
    ("trial", "--scenario", "week"),
    ("trial", "--patient", "hovorka-2004", "--guard", "--profile-by", "titration", "--seed", "2"),
    ("hil", "--seed", "3", "--outages", "2", "--fallback", "suspend"),
    ("stress", "--controller", "basal"),
    ("bound", "--noise", "1.45", "--dead-time", "5"),
    (*("run", "--patient", "hovorka-2004", "--announce-meals", "--controller", "basal-bolus, carb_ratio_g_U=9"),),
    (*("run", "--patient", "hovorka-2004", "--announce-meals", "--controller", "pid-ifb, meal_bolus=0.5"),),
    ("run", "--controller", "mpc, floor_weight=2, glucose_floor_mg_dl=70"),
    ("run", "--controller", "meal-mpc, caution_mg_dl=3"),
    (
        *("run", "--patient", "hovorka-2004", "--controller"),
        "oref0, enable_smb_always=false, enable_smb_high_bg=true, enable_smb_high_bg_target_mg_dl=150, "
        "bolus_increment_U=0.05, max_smb_basal_min=60",
    ),
    (
        *(
            "run",
            "--patient",
            "hovorka-2004",
            "--start",
            "06:00",
            "--override",
            "exercise, from=7h, to=9h",
            "--controller",
        ),
        "oref0, high_temptarget_raises_sensitivity=true, half_basal_exercise_target_mg_dl=140, "
        "allow_smb_with_high_temptarget=true",
    ),
    ("robust", "--seeds", "3", "--check-seeds", "3"),
]


def notes_of(command, *arguments):
    return notes_without_effect(asked(command, *arguments, "--allow-unusual"))


@pytest.mark.parametrize(("typed", "told"), NOTED, ids=lambda of: " ".join(of) if isinstance(of, tuple) else "")
def test_what_changes_nothing_is_told(typed, told):
    notes = notes_of(*typed)
    assert any(told in note for note in notes), notes


@pytest.mark.parametrize("typed", EFFECTIVE, ids=" ".join)
def test_what_has_an_effect_is_not(typed):
    assert notes_of(*typed) == ()


# One run of each controller for each option, against the run without it. Hovorka's patient has a profile and boluses.
BASE = {"patient": "hovorka-2004", "meals": ["50g@10min"], "duration_min": 90.0, "allow_unusual": True}
TOLD = {**BASE, "announce_meals": True}
OPTIONS = [
    (BASE, {"announce_meals": True}),
    (TOLD, {"announce_before_min": 10.0}),
    (TOLD, {"carb_bias_pct": -60.0}),
    (TOLD, {"carb_error_pct": 60.0}),
    (TOLD, {"habits": ["unannounced, probability=1"]}),
    (BASE, {"start": "06:00"}),
    (TOLD, {"pump": "limited, max_bolus_U=0.5"}),
    (BASE, {"sensor": ["lag, lag_min=15"]}),
    (BASE, {"faults": ["missing, start_min=15, duration_min=60"]}),
    (TOLD, {"profile_by": "titration"}),
    (BASE, {"seed": 5}),
    (BASE, {"setpoint_mg_dl": 130.0}),
    (BASE, {"meal_model": "lehmann-deutsch"}),
    (BASE, {"exercise_spread_pct": 20.0}),
]


def numbers(settings):
    run = configured(Run, settings)
    trace = close_the_loop(run, run.case).trace
    return run, np.concatenate([np.ravel(trace.glucose_mg_dl), np.ravel(trace.insulin_mU_min), [trace.setpoint_mg_dl]])


@pytest.mark.long
@pytest.mark.parametrize("controller", CONTROLLERS)
def test_every_option_changes_numbers_or_is_told_to_change_none(controller):
    without = {}
    for base, option in OPTIONS:
        announced = base is TOLD
        if announced not in without:
            without[announced] = numbers({**base, "controller": controller})[1]
        run, values = numbers({**base, **option, "controller": controller})
        [name] = option
        changed = not np.array_equal(values, without[announced])
        told = any(name in note or "The " in note for note in without_effect(run) if "announce_meals" not in note)
        if name == "announce_meals":
            told = any(note.startswith("announce_meals") for note in without_effect(run))
        assert changed or told, (name, without_effect(run))
        assert not (changed and told), (name, without_effect(run))


def test_functions_warn_where_their_scenario_has_what_the_controller_does_not_use(patient_81):
    scenario = gl.Scenario([gl.Meal(50.0, 10.0)], 30.0, announced=True)
    controller = gl.design_open_loop()
    for of in (controller, guarded(controller)):
        with pytest.warns(NoEffectWarning, match="announced has no effect: the controller") as told:
            gl.simulate(patient_81, of, scenario=scenario)
        assert [warning.filename for warning in told] == [__file__]


def test_a_controller_that_does_not_say_what_it_uses_is_not_doubted(patient_81, script):
    own = script([20.0, 25.0])
    assert uses_of(own) == OF_CONTROLLERS
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        gl.simulate(patient_81, own, scenario=gl.Scenario([gl.Meal(50.0, 10.0)], 30.0, announced=True))
    assert jnp.isfinite(own.rates_mU_min).all()


GIVEN_IN_A_SCENARIO = [
    ({"announced": True, "meals": ()}, "announced has no effect: there is no meal"),
    ({"announced_before_min": 10.0}, "announced_before_min has no effect: meals are not announced"),
    ({"meal_model": "hovorka", "meals": ()}, "meal_model has no effect: there is no meal"),
    ({"start_min": 0.0}, "start_min has no effect: the controller OpenLoop does not use the time of day"),
    ({"rhythm_seed": 3}, "rhythm_seed has no effect: the patient has no rhythms"),
    ({"rhythm_person": 3}, "rhythm_person has no effect: the patient has no rhythms"),
]
ALWAYS_IN_A_SCENARIO = {
    *("meals", "horizon_min", "setpoint_mg_dl", "initial_glucose_mg_dl", "allow_unusual"),
    *("exercise", "rhythms", "warm_up_min", "rescue"),
}
"""Settings of a scenario that have an effect in any run, or are refused."""


def test_every_setting_of_a_scenario_has_an_effect_or_is_told_to_have_none(patient_81):
    told = {next(iter(settings)) for settings, _ in GIVEN_IN_A_SCENARIO}
    assert told | ALWAYS_IN_A_SCENARIO == {field.name for field in dataclasses.fields(gl.Scenario)}
    for settings, note in GIVEN_IN_A_SCENARIO:
        with pytest.warns(NoEffectWarning, match=note) as warned:
            gl.simulate(patient_81, gl.design_open_loop(), scenario=gl.Scenario(**settings))
        assert [warning.filename for warning in warned] == [__file__], settings


def test_a_key_where_nothing_is_drawn_is_noted(patient_81):
    scenario = gl.Scenario([gl.Meal(50.0, 10.0)], 30.0)
    for sensor in (None, Lag(inner=DeadTime(minutes=5.0))):
        with pytest.warns(NoEffectWarning, match="key has no effect: nothing is drawn at random") as warned:
            gl.simulate(patient_81, gl.design_open_loop(), sensor, scenario=scenario, key=1)
        assert [warning.filename for warning in warned] == [__file__]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        gl.simulate(patient_81, gl.design_open_loop(), scenario=scenario)
        gl.simulate(patient_81, gl.design_open_loop(), gl.white_noise(1.45), scenario=scenario, key=1)


def test_what_a_patient_a_rhythm_or_a_controller_uses_is_not_noted(patient_81, script):
    rhythm = gl.rhythm("dawn")
    hovorka = gl.patient("hovorka-2004")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        scenario = gl.Scenario(
            horizon_min=30.0,
            rhythms=[rhythm],
            rhythm_seed=3,
            rhythm_person=2,
            start_min=60.0,
            meal_model="hovorka",
            meals=[gl.Meal(50.0, 5.0)],
        )
        gl.simulate(hovorka, gl.design_open_loop(hovorka.basal_insulin_mU_min), scenario=scenario)
        told = gl.Scenario([gl.Meal(50.0, 20.0)], 30.0, announced=True, announced_before_min=10.0, start_min=60.0)
        gl.simulate(patient_81, script([20.0, 25.0]), scenario=told)
        gl.Stepper(hovorka, rhythms=[rhythm], rhythm_seed=3)
    with pytest.warns(NoEffectWarning, match="rhythm_seed has no effect: the patient has no rhythms") as warned:
        gl.Stepper(hovorka, rhythm_seed=3)
    assert [warning.filename for warning in warned] == [__file__]


ALWAYS_OF_STUDIES = {
    "situation": """patient setpoint_mg_dl profile_error targets overrides rescue glucagon rhythm actions events sensor
        pump faults warm_up_min metrics sample_time_min
        allow_unusual controller guard model days duration_min meals habits exercise scenario
        initial_glucose_mg_dl integrator changes""",
    "people": "people population first_person traces precision arithmetic shard_people",
    "compare, bound": "bound known_after_min in_advance objective",
    "league": "families scenarios sensors controllers reference worse_by_pct bound_people seed",
    "searches": """ranges seeds top guards loops person nonsense sample_times_min precisions errors_pct hold_min
        stuck_times generations sequences search_seed starts estimators threshold estimates_by""",
    "hil": "form chip real_time power_cuts hangs damaged lost doubled late outages",
    "records and twins": """files most_days basal_U_h weight_kg held_out_days twin draws periods labels
        file_names reader dates glucose_unit time_zone columns file_units device person_column scans goals""",
    "identify": """amplitude_mU_min samples data method max_gap_min basal_insulin_mU_min not_from_rest memory
        laguerre_pole best_pole laguerre_functions""",
    "forecast": "methods horizons_min",
    "robust": "people_seed check_people check_people_seed objectives at_most beside sampler batch rounds prefer",
    "reproduce": "paper operating_point table figure quick",
}
"""Settings that have an effect in every study that has them, are refused where they have none, or answer a question of
a file, of which its reader says what it used.
"""


def studies():
    for entry in STUDIES.values():
        module, _, attribute = entry.place.partition(":")
        yield getattr(importlib.import_module(module), attribute)


def catalogues():
    return (PUMPS, SENSORS, FAULTS, HABITS, CONTROLLERS, GUARDS, MEAL_MODELS, RESCUES, RHYTHMS, ESTIMATORS, SAMPLERS)


def test_every_option_of_a_study_needs_something_or_always_has_an_effect():
    always = {name for names in ALWAYS_OF_STUDIES.values() for name in names.split()}
    found = set()
    for study in studies():
        for name, setting in study.request.settings().items():
            if name not in study.request.refused:
                found.add(name)
                assert setting.about.needs or name in always, (study.name, name)
    assert always <= found


def test_every_setting_with_a_need_is_noted_where_it_is_not_met():
    told = " ".join(told for _, told in NOTED) + " --unannounced"  # of a twin, below
    for study in studies():
        flags = {option.key: option.flag for option in options_of(study.request)}
        for name, setting in study.request.settings().items():
            if setting.about.needs and name not in study.request.refused:
                assert flags[name] in told, (study.name, name)
    for catalogue in catalogues():
        for component in catalogue.values():
            for name, setting in component.settings().items():
                assert not setting.about.needs or f"{name} of the " in told, (component.name, name)


def test_meals_of_a_record_that_no_controller_would_hear_of(tmp_path):
    (tmp_path / "twin.json").write_text('{"patient": "hovorka-2004"}')
    (tmp_path / "person.toml").write_text('[[person]]\nname = "twin"\nS_IT = 50e-4\n')
    replay = ("replay", "record.csv", "--twin", str(tmp_path), "--unannounced", "--controller")
    [note] = notes_of(*replay, "pid")
    assert note.startswith("--unannounced has no effect: the controller pid does not use announcements")
    assert notes_of(*replay, "basal-bolus, insulin_on_board_min=200") == ()
    [note] = notes_of(*replay, "basal-bolus, carb_ratio_g_U=9")
    assert note.startswith("carb_ratio_g_U of the controller basal-bolus has no effect: meals are not announced")


SENSED = {"sensor": ["dexcom-g6"], "sensors": ["dexcom-g6"]}
MODELLED = {"controller": ["mpc, known_dead_time=true"], "controllers": ["mpc, known_dead_time=true"]}


@pytest.mark.parametrize("name", sorted(STUDIES))
def test_no_study_says_of_what_it_uses_that_it_has_no_effect(name):
    """A study that has sensors or controllers says what it uses of them."""
    module, _, attribute = STUDIES[name].place.partition(":")
    root = getattr(importlib.import_module(module), attribute).request
    for key, value in (SENSED | MODELLED).items():
        late = {"sensor": ["dead-time, minutes=10"]} if key in MODELLED and "sensor" in root.settings() else {}
        if key in root.settings() and key not in root.refused:
            with contextlib.suppress(Refusal):  # of a study that takes no such controller
                assert without_effect(configured(root, {**late, key: value})) == ()
