"""A part: what is declared once is read, checked, written and told everywhere in the same way."""

import math
import subprocess
import sys
from typing import Annotated, ClassVar, Literal

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from glucoloop.component.base import Component
from glucoloop.component.catalogue import Catalogue, catalogues
from glucoloop.component.grammar import component_text, component_tree, plain
from glucoloop.component.request import completed, requested
from glucoloop.component.setting import About, Default, Setting, default_by_noise, known_names
from glucoloop.refusal import Refusal
from glucoloop.unit_guess import SETPOINT


class _Lamp(Component):
    kind: ClassVar = "lamp"


class _Desk(_Lamp, name="desk"):
    """A lamp on a desk."""

    lit_min: Annotated[float, About("Time.", above=0.0, at_most=2880.0)] = 10.0
    rate_mU_min: Annotated[float, About("Rate.", at_least=0.0)] = default_by_noise(default=1.0, noisy=2.0)
    bulbs: Annotated[int, About("Number of bulbs.", at_least=1, at_most=8)] = 1
    spare: Annotated[int, About("Number of spare bulbs.", at_least=0, at_most=8)] = 0
    colour: Annotated[Literal["red", "blue"], About("Colour.")] = "red"
    dimmed: Annotated[bool, About("Whether it is dimmed.")] = False
    note: Annotated[str, About("Words on it.")] = ""
    target_mg_dl: Annotated[float | None, About("Target.", above=0.0, quantity=SETPOINT)] = None

    def __post_init__(self) -> None:
        if self.spare > self.bulbs:
            raise Refusal(f"{self.spare} spare bulbs are more than the {self.bulbs} in use")


LAMPS = Catalogue(_Lamp, {"desk": f"{__name__}:_Desk"}, example="desk, bulbs=2")


def test_a_part_is_read_from_its_text_with_its_units():
    part = LAMPS.parse("desk, lit_min=1.5h, rate_mU_min=0.6 U/h, dimmed=true, note='a, b = c'")
    assert part.explicit == {"lit_min": 90.0, "rate_mU_min": pytest.approx(10.0), "dimmed": True, "note": "a, b = c"}
    assert part.tree()["name"] == "desk"
    assert completed(part) == _Desk(90.0, part.explicit["rate_mU_min"], dimmed=True, note="a, b = c")


VALUES = st.fixed_dictionaries(
    {},
    optional={
        "lit_min": st.floats(1e-6, 2880.0),
        "rate_mU_min": st.floats(0.0, 1e30),
        "bulbs": st.integers(1, 8),
        "colour": st.sampled_from(["red", "blue"]),
        "dimmed": st.booleans(),
        "note": st.text(st.characters(exclude_characters="'\"\\", exclude_categories=["C", "Z"])),
        "target_mg_dl": st.floats(1e-3, 1e4),
    },
)


@given(VALUES)
def test_a_part_is_read_again_from_its_text_and_from_its_tree(values):
    values = {key: value for key, value in values.items() if value != ""}
    part = requested(_Desk, values, alias="desk")
    again = LAMPS.parse(component_text(part.tree()))
    assert again.explicit == part.explicit
    assert LAMPS.read(part.tree()).explicit == part.explicit
    assert plain(component_tree(component_text(part.tree()), "here")).keys() == part.tree().keys()
    whole = completed(part)
    assert whole == _Desk(**values)
    assert whole.explicit == part.explicit


@given(st.text(max_size=60))
def test_any_text_is_a_part_or_refused_in_a_sentence(text):
    try:
        LAMPS.parse(text, "--lamp")
    except Refusal as refused:
        assert str(refused)  # noqa: PT017 (any text may be a part, too)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("dsk", "--lamp: unknown lamp 'dsk'; did you mean 'desk'? the known ones are: desk"),
        ("bulbs=2", "--lamp: no lamp is named; begin with its name, like 'desk, bulbs=2'"),
        ("desk, bulb=2", "--lamp: the lamp desk has no setting 'bulb'; did you mean 'bulbs'?"),
        ("desk, bulbs=9", "--lamp: desk: bulbs is 9; give a whole number from 1 to 8"),
        ("desk, bulbs=2.0", "--lamp: desk: bulbs is '2.0'; give a whole number from 1 to 8"),
        ("desk, bulbs=1_0", "bulbs is '1_0'; give a whole number"),
        ("desk, bulbs=٣", "bulbs is '٣'; give a whole number"),
        ("desk, lit_min=0", "lit_min is 0 min; give a number above 0 min and up to 2880 min"),
        ("desk, lit_min=-1h", "lit_min is -1h, which is -60 min; give"),
        ("desk, lit_min=3kg", "lit_min is '3kg'; give a number above 0 min and up to 2880 min, or one in h, s or d"),
        ("desk, rate_mU_min=-1", "rate_mU_min is -1 mU/min; give a finite number of 0 mU/min or more"),
        ("desk, rate_mU_min=1e300", "rate_mU_min is 1e+300 mU/min; give a number of a size up to 1e+30"),
        ("desk, rate_mU_min=nan", "rate_mU_min is nan mU/min; give"),
        ("desk, target_mg_dl=-5", "target_mg_dl is -5 mg/dl; give a finite number above 0 mg/dl"),
        ("desk, colour=green", "colour is 'green'; give red or blue"),
        ("desk, dimmed=yes", "dimmed is 'yes'; give true or false"),
        ("desk, bulbs=2, bulbs=3", "bulbs is given twice in 'desk, bulbs=2, bulbs=3'; leave one out"),
        ("desk, bulbs", "'bulbs' in 'desk, bulbs' is no setting with a value; write it like 'desk, bulbs=2'"),
        ("desk, note='a", "has a quotation mark without its pair; add it"),
    ],
)
def test_what_is_wrong_is_told_with_the_value_the_bound_and_the_mend(text, sentence):
    with pytest.raises(Refusal) as refused:
        LAMPS.parse(text, "--lamp")
    assert sentence in str(refused.value)


def test_a_value_in_another_unit_is_asked_about():
    part = LAMPS.parse("desk, target_mg_dl=5.5")
    with pytest.raises(Refusal, match=r"--setpoint is 5\.5 mg/dl; that looks like mmol/l: 5\.5 mmol/l is 99\.1 mg/dl"):
        _Desk.setting("target_mg_dl").refuse_unusual(part.value("target_mg_dl"), "--setpoint")
    in_mmol = LAMPS.parse("desk, target_mg_dl=5.5 mmol/l")
    _Desk.setting("target_mg_dl").refuse_unusual(completed(in_mmol).target_mg_dl, "--setpoint")


def test_settings_are_compared_once_the_part_is_whole():
    part = LAMPS.parse("desk, spare=3", "--lamp")  # 3 of the usual 4, and of no default
    with pytest.raises(Refusal, match=r"^--lamp: 3 spare bulbs are more than the 1 in use"):
        completed(part)
    for four in (4, Default(4)):
        assert completed(part, {"bulbs": four}).bulbs == 4


def test_what_is_usual_follows_noise_and_what_was_given_stays():
    assert completed(LAMPS.parse("desk"), noisy=True).rate_mU_min == 2.0
    assert completed(LAMPS.parse("desk, rate_mU_min=1"), noisy=True).rate_mU_min == 1.0
    assert completed(LAMPS.parse("desk, rate_mU_min=1"), noisy=True).explicit == {"rate_mU_min": 1.0}


def test_a_part_made_in_python_takes_numbers_of_numpy_and_refuses_other_types():
    assert _Desk(np.float32(3.0), bulbs=np.int64(2)) == _Desk(3, bulbs=2)
    for wrong in ({"bulbs": 2.5}, {"lit_min": "long"}, {"dimmed": 1}):
        with pytest.raises(TypeError):
            _Desk(**wrong)
    with pytest.raises(TypeError, match="unexpected keyword"):
        _Desk(bulb=1)
    with pytest.raises(Refusal, match="bulbs is 0; give a whole number from 1 to 8"):
        _Desk(bulbs=0)


EVERY = [(kind, name) for kind, catalogue in catalogues().items() for name in catalogue]


@pytest.mark.parametrize(("kind", "name"), EVERY, ids=" ".join)
def test_every_part_of_this_package_is_declared_in_full(kind, name):
    part = catalogues()[kind][name]
    assert part.kind == kind
    assert part.summary
    assert not part.summary.endswith(".")
    whole = part()
    assert catalogues()[kind].choose(whole.text) == whole or any(
        isinstance(value, float) and math.isnan(value) for value in whole.values().values()
    )
    for setting in part.settings().values():
        assert setting.summary.endswith("."), setting.name
        for noisy in (False, True):
            setting.check(setting.default.value(noisy=noisy))


def test_parts_are_read_and_refused_without_jax():
    program = (
        "import sys\n"
        "from glucoloop.component.catalogue import catalogues\n"
        "try:\n    catalogues()['controller'].choose('mpc-se, move_horizon=0')\n"
        "except ValueError as refused:\n    print(refused)\n"
        "assert 'jax' not in sys.modules\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout == "mpc-se: move_horizon is 0; give a whole number from 1 to 50\n"


def test_a_default_follows_noise():
    default = Default(1, noisy=2)
    assert [default.value(noisy=noisy) for noisy in (False, True)] == [1, 2]
    assert Default(1).value(noisy=True) == 1


@pytest.mark.parametrize(
    ("kind", "value", "told"),
    [(int, 1.5, "a whole number"), (int, True, "a whole number"), (float, "1", "a finite number"), (str, 1, "a text")],
)
def test_setting_of_another_type_is_refused(kind, value, told):
    with pytest.raises(ValueError, match=f"x is {value!r}; give {told}"):
        Setting("x", kind, (), False, False, Default(kind()), About("")).check(value)


def test_whole_number_will_do_for_a_number():
    checked = Setting("x", float, (), False, False, Default(0.0), About("")).check(1)
    assert isinstance(checked, float)


def test_known_names_are_those_that_are_like_it():
    assert known_names("a", []) == "there are none"
    assert known_names("name7", [f"name{k}" for k in range(20)]) == "did you mean 'name7'?"
    many = [*(f"name{k}" for k in range(20)), "noise_variance", "noise_bound_mg_dl"]
    assert (
        known_names("largest_noise_mg", many, where="see there")
        == "those like it are: noise_variance, noise_bound_mg_dl"
    )
    assert known_names("zzz_mg", many, where="see there") == "none of the 22 known ones is like it; see there"
