"""What is hardly meant is asked about by every reader, and is taken where it is confirmed."""

import pytest

from glucoloop.component.grammar import as_tree
from glucoloop.component.request import configuration_from
from glucoloop.situations.run import Run
from glucoloop.trials.trial import Trial

ROOTS = {"run": Run, "trial": Trial}
UNUSUAL = [
    (
        {"setpoint_mg_dl": 5.5},
        "a.toml: setpoint_mg_dl is 5.5 mg/dl; that looks like mmol/l: 5.5 mmol/l is 99.1 mg/dl. Give 99.1",
    ),
    ({"setpoint_mg_dl": 810.0}, "a setpoint is usually from 50 to 250 mg/dl"),
    ({"initial_glucose_mg_dl": 7.8}, "looks like mmol/l: 7.8 mmol/l is 141 mg/dl"),
    (
        {"pump": {"max_insulin_mU_min": 4.0}},
        "but the patient needs 25.6 mU/min to rest at 81.1 mg/dl; that looks like U/h: 4 U/h is 66.7 mU/min",
    ),
    ({"pump": {"max_insulin_mU_min": 20.0}}, "20 mU/min, but the patient needs 25.6 mU/min to rest"),
    ({"pump": {"min_insulin_mU_min": 30.0}}, "the patient needs only 25.6 mU/min to rest"),
    ({"pump": {"max_change_mU_min": 1.0}}, "looks like U/h: 1 U/h is 16.7 mU/min"),
    (
        {"pump": {"resolution_mU_min": 0.05}},
        "a.toml: resolution_mU_min is 0.05 mU/min; that looks like U/h: 0.05 U/h is 0.833 mU/min",
    ),
    ({"meals": ["0.05g@50min"]}, "the size of the meal at 50 min is 0.05 g; that looks like kg: 0.05 kg is 50 g"),
    ({"meals": ["600g@50min"]}, "a meal is usually from 1 to 300 g"),
    ({"meals": ["50@50"]}, "the meal '50@50' names no unit; write 50g@50min"),
    ({"duration_min": 10.0, "meals": []}, "looks like h: 10 h is 600 min"),
    ({"sample_time_min": 60.0}, "looks like s: 60 s is 1 min"),
    ({"sensor": {"name": "dead-time", "minutes": 300.0}}, "looks like s: 300 s is 5 min"),
    (
        {"sensor": ["white-noise, bound_mg_dl=0.3"]},
        "a.toml: white-noise: bound_mg_dl is 0.3 mg/dl; that looks like mmol/l: 0.3 mmol/l is 5.4 mg/dl",
    ),
    (
        {"sensor": ["white-noise, variance=5000"]},
        "the variance of noise on readings is usually from 0 to 900 (mg/dl)²",
    ),
    (
        {"faults": ["saturation, low_mg_dl=2.2"]},
        "a.toml: saturation: low_mg_dl is 2.2 mg/dl; that looks like mmol/l",
    ),
    ({"guard": {"low_mg_dl": 3.6}}, "low_mg_dl is 3.6 mg/dl; that looks like mmol/l: 3.6 mmol/l is 64.9"),
    ({"controller": {"name": "pid", "gain": 1e9}}, "gain is 1e+09 mU/min per mg/dl"),
]


def cases():
    for keys, told in UNUSUAL:
        for command in ROOTS:
            if command == "run" or "initial_glucose_mg_dl" not in keys:
                yield pytest.param(command, keys, told, id=f"{command}-{keys}")


@pytest.mark.parametrize(("command", "keys", "told"), list(cases()))
def test_unusual_value_is_asked_about_and_taken_where_it_is_confirmed(command, keys, told):
    with pytest.raises(ValueError, match=r".") as refused:
        configuration_from(ROOTS[command], as_tree(keys, "a.toml"))
    assert told in str(refused.value)
    assert "add --allow-unusual if" in str(refused.value)
    confirmed = configuration_from(ROOTS[command], as_tree({**keys, "allow_unusual": True}, "a.toml"))
    again = configuration_from(ROOTS[command], as_tree(confirmed.tree(), "a.toml"))
    assert again == confirmed
    assert again.allow_unusual


def asked(root, **keys):
    return configuration_from(root, as_tree(keys, "a.toml"))


def test_a_higher_target_needs_a_smaller_pump():
    assert asked(Run, setpoint_mg_dl=150.0, pump="max_insulin_mU_min=20").limits.max_mU_min == 20.0
    with pytest.raises(ValueError, match="looks like U/h"):
        asked(Run, setpoint_mg_dl=150.0, pump="max_insulin_mU_min=4")


def test_what_is_not_possible_is_refused_even_so():
    with pytest.raises(ValueError, match=r"setpoint_mg_dl is 5000 mg/dl; give .* up to 2000 mg/dl"):
        asked(Run, setpoint_mg_dl=5000.0, allow_unusual=True)
    with pytest.raises(ValueError, match="a meal of 50000 g is not possible; that looks like mg: 50000 mg is 50 g"):
        asked(Run, meals=["50000g@50min"], allow_unusual=True)
    with pytest.raises(
        ValueError, match=r"sample_time_min is 300 min; .* to 120 min, .*; that looks like s: 300 s is 5"
    ):
        asked(Run, sample_time_min=300.0)


@pytest.mark.parametrize("root", ROOTS.values())
def test_clock_time_without_a_unit_is_asked_about(root):
    day = {"duration_min": 1440.0}
    with pytest.raises(ValueError, match=r"^the meal '45g@7' begins 7 min after the start; that looks like hours. Wr"):
        asked(root, **day, meals=["45g@7"])
    with pytest.raises(ValueError, match=r"Write 45g@7h/20min, or 45g@7min/20min if minutes are meant"):
        asked(root, **day, meals=["45g@7/20"])
    for text, minutes in (("45g@7h", 420), ("45g@7min", 7), ("45g@420", 420)):
        assert asked(root, **day, meals=[text]).meals == (f"45g@{minutes}min",)
