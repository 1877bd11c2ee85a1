"""What was given and changes nothing is told: each option of a situation changes numbers, or there is a note."""

import contextlib
import importlib
import warnings

import jax.numpy as jnp
import numpy as np
import pytest

import glucoloop as gl
from glucoloop.cli.request import notes_without_effect
from glucoloop.component.effects import OF_CONTROLLERS, NoEffectWarning
from glucoloop.control import guarded
from glucoloop.control.catalogue import CONTROLLERS
from glucoloop.control.protocol import uses_of
from glucoloop.refusal import Refusal
from glucoloop.situations.run import Run
from glucoloop.situations.situation import configured
from glucoloop.situations.unused import without_effect
from glucoloop.studies.catalogue import STUDIES
from glucoloop.studies.closed_loop import close_the_loop
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
    (("run", "--pump", "max_bolus_U=5"), "max_bolus_U of the pump limited has no effect: the controller mpc does not"),
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
    (("trial", "--patient", "hovorka-2004", "--profile-by", "titration"), "--profile-by has no effect: the controller"),
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
    (("hil", "--baud", "9600"), "--baud has no effect: the chip is at no serial port."),
    (("hil", "--fallback", "suspend"), "--fallback has no effect: the chip always answers"),
    (("hil", "--announce-meals"), "--announce-meals has no effect: the controller mpc"),
]
EFFECTIVE = [
    ("run", "--announce-meals", "--controller", "meal-mpc"),
    ("run", "--announce-meals", "--announce-before", "20", "--carb-error", "9", "--controller", "basal-bolus"),
    ("run", "--no-announce-meals", "--carb-error", "0", "--pump", "max_bolus_U=25"),
    ("run", "--noise", "1.45", "--seed", "3"),
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
