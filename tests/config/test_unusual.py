"""What is hardly meant is asked about by every reader of a configuration, and is taken where it is confirmed."""

import tomllib

import pytest

from glucoloop.config.bound import bound_keys, read_bound
from glucoloop.config.comparison import read_comparison
from glucoloop.config.identification import identification_keys, read_identification
from glucoloop.config.run import read_run
from glucoloop.situations.toml import toml_text
from glucoloop.config.trial import read_trial, trial_keys
from glucoloop.studies.detection.study import read as read_detect
from glucoloop.studies.robust.keys import read_robust
from glucoloop.studies.stress.cells import read as read_stress

CASES = [{"label": "a"}, {"label": "b", "move_weight": 3}]
READERS = {
    "run": (lambda keys, names=None: read_run(keys, names), lambda read: read.keys()),
    "compare": (lambda keys, names=None: read_comparison(keys, CASES, names), lambda read: read.keys()),
    "trial": (lambda keys, names=None: read_trial(keys, (), names), trial_keys),
    "stress": (lambda keys, names=None: read_stress(keys, (), names), lambda read: read.keys()),
    "detect": (lambda keys, names=None: read_detect(keys, (), names), lambda read: read.keys()),
    "bound": (read_bound, bound_keys),
    "robust": (read_robust, lambda read: read.keys()),
    "identify": (read_identification, identification_keys),
}
UNUSUAL = [
    ("setpoint_mg_dl", 5.5, "setpoint_mg_dl is 5.5 mg/dl; that looks like mmol/l: 5.5 mmol/l is 99.1 mg/dl. Give 99.1"),
    ("setpoint_mg_dl", 810.0, "a setpoint is usually from 50 to 250 mg/dl"),
    ("initial_glucose_mg_dl", 7.8, "looks like mmol/l: 7.8 mmol/l is 141 mg/dl"),
    (
        "max_insulin_mU_min",
        4.0,
        "but the patient needs 25.6 mU/min to rest at 81.1 mg/dl; that looks like U/h: 4 U/h is 66.7 mU/min",
    ),
    ("max_insulin_mU_min", 20.0, "20 mU/min, but the patient needs 25.6 mU/min to rest"),
    ("min_insulin_mU_min", 30.0, "the patient needs only 25.6 mU/min to rest"),
    ("max_change_mU_min", 1.0, "looks like U/h: 1 U/h is 16.7 mU/min"),
    ("pump_resolution_mU_min", 0.05, "looks like U/h: 0.05 U/h is 0.833 mU/min"),
    ("meals", ["0.05g@50min"], "the size of the meal at 50 min is 0.05 g; that looks like kg: 0.05 kg is 50 g"),
    ("meals", ["600g@50min"], "a meal is usually from 1 to 300 g"),
    ("duration_min", 10.0, "looks like h: 10 h is 600 min"),
    ("sample_time_min", 60.0, "looks like s: 60 s is 1 min"),
    ("dead_time_min", 300.0, "looks like s: 300 s is 5 min"),
    ("noise_bound_mg_dl", 0.3, "looks like mmol/l: 0.3 mmol/l is 5.4 mg/dl"),
    ("noise_variance", 5000.0, "the variance of noise on readings is usually from 0 to 900 (mg/dl)²"),
    ("faults", ["saturation, low_mg_dl=2.2"], "low_mg_dl of the fault saturation is 2.2 mg/dl; that looks like mmol/l"),
    ("amplitude_mU_min", 1.3, "looks like U/h: 1.3 U/h is 21.7 mU/min"),
    ("basal_insulin_mU_min", 1.5, "looks like U/h: 1.5 U/h is 25 mU/min"),
]
NOT_OF = {
    "setpoint_mg_dl": {"robust", "identify"},
    "initial_glucose_mg_dl": {"trial", "stress", "detect", "robust", "identify"},
    "max_insulin_mU_min": {"identify"},
    "min_insulin_mU_min": {"identify"},
    "max_change_mU_min": {"identify"},
    "pump_resolution_mU_min": {"bound", "identify"},
    "meals": {"identify"},
    "duration_min": {"detect", "identify"},
    "noise_bound_mg_dl": {"bound"},
    "faults": {"bound", "identify"},
    "amplitude_mU_min": READERS.keys() - {"identify"},
    "basal_insulin_mU_min": READERS.keys() - {"identify"},
}


def cases():
    for key, value, told in UNUSUAL:
        for command in READERS:
            if command not in NOT_OF.get(key, set()):
                yield pytest.param(command, key, value, told, id=f"{command}-{key}-{value}")


def with_others(command, key, value):
    """What must stand beside a key so that nothing else is wrong."""
    keys = {key: value}
    if key == "basal_insulin_mU_min":
        keys["data"] = "record.csv"
    if key == "duration_min":
        keys["meals"] = []
    if key == "duration_min" and command == "stress":
        keys["faults"] = ["missing"]
    if key == "meals" and command == "detect":
        keys |= {"meal_time_spread_min": 0.0, "meal_size_spread_pct": 0.0}
    return keys


@pytest.mark.parametrize(("command", "key", "value", "told"), list(cases()))
def test_unusual_value_is_asked_about(command, key, value, told):
    read, _ = READERS[command]
    with pytest.raises(ValueError, match=r".") as refused:
        read(with_others(command, key, value))
    assert told in str(refused.value)
    assert "add --allow-unusual if" in str(refused.value)


@pytest.mark.parametrize(("command", "key", "value", "told"), list(cases()))
def test_confirmed_value_is_taken_and_its_file_repeats_it(command, key, value, told):
    del told
    read, keys_of = READERS[command]
    confirmed = read(with_others(command, key, value) | {"allow_unusual": True})
    written = tomllib.loads(toml_text(keys_of(confirmed), command))
    assert written["allow_unusual"] is True
    assert written[key] == pytest.approx(value) if isinstance(value, float) else written[key]


@pytest.mark.parametrize("command", READERS)
def test_option_is_confirmed_by_an_option(command):
    read, _ = READERS[command]
    with pytest.raises(ValueError, match=r"^--noise is 5000 .* or add --allow-unusual if 5000 \(mg/dl\)² is meant$"):
        read({"noise_variance": 5000.0}, {"noise_variance": "--noise"})


@pytest.mark.parametrize("command", ["run", "compare", "trial", "stress"])
def test_limit_of_the_guard_in_another_unit_is_asked_about(command):
    read, _ = READERS[command]
    keys = {"guard_low_mg_dl": 3.6} | ({} if command == "stress" else {"guard": True})
    with pytest.raises(ValueError, match=r"guard_low_mg_dl is 3.6 mg/dl; that looks like mmol/l: 3.6 mmol/l is 64.9"):
        read(keys)


def test_a_higher_target_needs_a_smaller_pump():
    assert read_run({"setpoint_mg_dl": 150.0, "max_insulin_mU_min": 20.0}).situation.max_insulin_mU_min == 20.0
    with pytest.raises(ValueError, match="looks like U/h"):
        read_run({"setpoint_mg_dl": 150.0, "max_insulin_mU_min": 4.0})


def test_what_is_not_possible_is_refused_even_so():
    with pytest.raises(ValueError, match=r"setpoint_mg_dl is 5000 mg/dl; give .* up to 2000 mg/dl"):
        read_run({"setpoint_mg_dl": 5000.0, "allow_unusual": True})
    with pytest.raises(ValueError, match="a meal of 50000 g is not possible; that looks like mg: 50000 mg is 50 g"):
        read_run({"meals": ["50000g@50min"], "allow_unusual": True})
    with pytest.raises(ValueError, match=r"sample_time_min is 300 min; .* to 120 min; that looks like s: 300 s is 5"):
        read_run({"sample_time_min": 300.0})


@pytest.mark.parametrize("command", ["run", "trial", "stress", "detect"])
def test_clock_time_without_a_unit_is_asked_about(command):
    read, keys_of = READERS[command]
    day = {"run": {"duration_min": 1440.0}, "trial": {}, "stress": {"duration_min": 1440.0}, "detect": {}}[command]
    with pytest.raises(ValueError, match=r"^the meal '45g@7' begins 7 min after the start; that looks like hours. Wr"):
        read(
            {**day, "meals": ["45g@7"], "meal_time_spread_min": 0.0}
            if command != "run"
            else {**day, "meals": ["45g@7"]}
        )
    with pytest.raises(ValueError, match=r"Write 45g@7h/20min, or 45g@7min/20min if minutes are meant"):
        read({**day, "meals": ["45g@7/20"], **({} if command == "run" else {"meal_time_spread_min": 0.0})})
    for text, minutes in (("45g@7h", 420), ("45g@7min", 7), ("45g@420", 420)):
        more = {} if command == "run" else {"meal_time_spread_min": 0.0}
        assert keys_of(read({**day, **more, "meals": [text]}))["meals"] == [f"45g@{minutes}min"]


def test_confirmation_is_no_part_of_what_a_trial_is():
    from glucoloop.cohorts.trial import fingerprint

    assert fingerprint(read_trial({})) == fingerprint(read_trial({"allow_unusual": True}))
