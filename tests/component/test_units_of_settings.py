"""A number in any unit in use is the same number in every setting that has a unit, and stays as it was given."""

import contextlib
import math
import pickle

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from glucoloop.component.catalogue import catalogues
from glucoloop.component.grammar import as_tree, component_text, component_tree
from glucoloop.component.request import completed, read
from glucoloop.component.setting import WithUnit
from glucoloop.control import BasalBolus
from glucoloop.pumps import dose_limits
from glucoloop.refusal import Refusal
from glucoloop.situations.run import Run
from glucoloop.therapy import Profile
from glucoloop.units import OTHER_UNITS, factor_to

PARTS = [Run, *(part for parts in catalogues().values() for part in parts.values())]
WITH_UNITS = {
    setting.name: (part, setting)  # settings of one name are declared once
    for part in PARTS
    for setting in part.settings().values()
    if setting.kind is float and setting.unit in OTHER_UNITS and setting.name not in part.refused
}


def possible_values(setting):
    about, quantity = setting.about, setting.about.quantity
    low, high = (quantity.least, quantity.most) if quantity else (max(about.at_least, about.above, 1e-3), 1e3)
    low, high = max(low, about.at_least, 1e-3), min(high, about.at_most)
    return st.floats(low, high).filter(about.allows)


@pytest.mark.parametrize("name", WITH_UNITS)
@settings(max_examples=10)
@given(data=st.data())
def test_a_number_is_the_same_in_each_unit_in_texts_and_in_files(name, data):
    part, setting = WITH_UNITS[name]
    value = data.draw(possible_values(setting))
    unit = data.draw(st.sampled_from([setting.unit, *OTHER_UNITS[setting.unit]]))
    text = f"{value / factor_to(setting.unit, unit)!r}{data.draw(st.sampled_from(['', ' ']))}{unit}"
    typed = component_tree(component_text({setting.name: text}), "--part")
    short = component_tree(component_text({setting.name_without_unit: text}), "--part")
    of_file = as_tree({setting.name: text}, "a.toml")
    for tree in (typed, short, of_file):
        made = read(part, tree)
        [(found, number)] = made.explicit.items()
        assert found == name
        assert math.isclose(number, value, rel_tol=1e-14)
        with contextlib.suppress(Refusal):  # where it is at odds with the defaults of others
            assert type(getattr(completed(made), name)) is float
            assert getattr(completed(made), name) == number
        assert read(part, as_tree(made.tree(), "a.toml")) == made
        assert read(part, component_tree(component_text(made.tree()), "--part")) == made
        if unit not in (setting.unit, "m"):
            assert isinstance(number, WithUnit)
            assert made.tree()[name] == text
            assert pickle.loads(pickle.dumps(number)).text == text


@pytest.mark.parametrize(
    ("unit", "same"),
    [("mg/dl", "mmol/L"), ("mg/dl per U", "mmol/l/U"), ("g per U", "g/U"), ("(mg/dl)²", "(mmol/L)^2")],
)
def test_a_unit_has_several_spellings(unit, same):
    assert factor_to(unit, same) == {"g per U": 1.0}.get(unit) or factor_to(unit, same) > 1.0
    assert factor_to(unit, "furlong") is None


@pytest.mark.parametrize(
    ("tree", "told"),
    [
        (
            {"setpoint": "5.5U"},
            "a.toml: setpoint_mg_dl is '5.5U'; give a number above 0 mg/dl and up to 2000 mg/dl, or",
        ),
        ({"setpoint": "5.5"}, "setpoint_mg_dl is '5.5'; give"),
        ({"setpoint": "300 mmol/l"}, "setpoint_mg_dl is 300 mmol/l, which is 5404.68 mg/dl; give"),
        (
            {"setpoint": "0.3 mmol/l"},
            "setpoint_mg_dl is 5.40468 mg/dl; a setpoint is usually from 50 to 250 mg/dl. Give",
        ),
        ({"setpoint": 100.0, "setpoint_mg_dl": 90.0}, "setpoint_mg_dl is given twice, once without its unit"),
        ({"seed": "3 h"}, "seed is '3 h'; give a whole number"),
        ({"controller": "basal-bolus, correction=2.5"}, "that looks like mmol/l per U: 2.5 mmol/l per U is 45 mg/dl"),
        ({"controller": "basal-bolus, carb_ratio=0.1"}, "a carbohydrate ratio is usually from 1 to 150 g per U"),
        ({"guard": {"fastest": 0.17}}, "that looks like mmol/l per min: 0.17 mmol/l per min is 3.06 mg/dl per min"),
        ({"guard": {"fall": 3.3}}, "that looks like mmol/l: 3.3 mmol/l is 59.5 mg/dl"),
        ({"guard": {"on_board_tau": 2.0}}, "that looks like h: 2 h is 120 min"),
        ({"pump": {"max_bolus": 800.0}}, "that looks like mU: 800 mU is 0.8 U"),
        ({"sensor": "lag, lag=0.2"}, "that looks like h: 0.2 h is 12 min"),
    ],
)
def test_a_wrong_unit_is_refused_and_a_likely_one_is_asked_about(tree, told):
    with pytest.raises(Refusal) as refused:
        read(Run, as_tree(tree, "a.toml"), allow_unusual=False)
    assert told in str(refused.value)


def test_what_is_laid_over_has_another_spelling_of_the_same_name():
    of_file = as_tree({"setpoint": "5.5 mmol/l"}, "a.toml")
    typed = as_tree({"setpoint_mg_dl": 100.0}, "--setpoint")
    assert read(Run, {**of_file, **typed}).value("setpoint_mg_dl") == 100.0


def test_python_takes_a_unit_too_and_asks():
    assert Run(setpoint_mg_dl="5.5 mmol/l").setpoint_mg_dl == pytest.approx(99.0858)
    with pytest.raises(Refusal, match="looks like mmol/l"):
        Run(setpoint_mg_dl=5.5).as_scenario()
    with pytest.raises(
        Refusal, match=r"max_mU_min is 4 mU/min; that looks like U/h: 4 U/h is 66\.7 mU/min.*allow_unusual"
    ):
        dose_limits(max_mU_min=4.0)
    assert dose_limits(max_mU_min=4.0, allow_unusual=True).max_mU_min == 4.0
    assert dose_limits(max_mU_min=1e6, max_change_mU_min=1e6).max_mU_min == 1e6
    for basal_mU_min, factors in ((1.2, {}), (6.7, {"correction_mg_dl_U": 2.5})):
        controller, profile = BasalBolus(**factors), Profile(basal_mU_min=basal_mU_min, setpoint_mg_dl=110.0)
        with pytest.raises(Refusal, match=r"looks like (U/h|mmol/l per U)"):
            controller.of_person(profile)
        controller.of_person(profile, allow_unusual=True)
