"""A key is declared once: its option, help and check follow from the declaration."""

import math
from dataclasses import dataclass
from typing import Annotated, Literal

import pytest

from glucoloop.cli.options import options_of
from glucoloop.config.checked import checked
from glucoloop.config.key import Key, declared, own_keys, plain, text_of
from glucoloop.config.options.case import CaseKeys
from glucoloop.config.options.export import ChipKeys
from glucoloop.config.options.identification import IdentificationKeys
from glucoloop.config.options.situation import SituationKeys
from glucoloop.config.options.trial import TrialKeys
from glucoloop.papers.parker1999.options import ReproduceKeys
from glucoloop.studies.adversary.options import AdversaryKeys
from glucoloop.studies.bound import BoundSettings
from glucoloop.studies.detection.options import DetectionKeys
from glucoloop.studies.robust import HowFar, RobustSettings, Shown
from glucoloop.studies.stress import StressSettings
from glucoloop.studies.tuning import GridSettings, RangeSettings
from glucoloop.studies.verification import VerifySettings

RECORDS = (
    *(SituationKeys, CaseKeys, TrialKeys, BoundSettings, IdentificationKeys, ChipKeys, ReproduceKeys),
    *(
        AdversaryKeys,
        DetectionKeys,
        RobustSettings,
        HowFar,
        Shown,
        StressSettings,
        GridSettings,
        RangeSettings,
        VerifySettings,
    ),
)
BOUNDED = [
    (record, of, side, bound)
    for record in RECORDS
    for of in declared(record).values()
    if of.key is not None
    for side, bound in (("at_least", of.key.at_least), ("at_most", of.key.at_most), ("above", of.key.above))
    if math.isfinite(bound)
]


@dataclass(frozen=True, kw_only=True)
class Own:
    """Keys of a test."""

    dose_mU_min: Annotated[float, Key("Rate of the dose.", panel="Dose", above=0.0, at_most=50.0)] = 5.0
    shape: Annotated[Literal["round", "square"], Key("Shape of the pulse.", panel="Dose")] = "round"
    times: Annotated[tuple[int, ...], Key("Times.", panel="Dose", empty=("no_times", "No times."), at_least=1)] = (2, 3)
    hidden: float = 1.0


@pytest.mark.parametrize("record", RECORDS)
def test_every_key_has_an_option_with_a_sentence(record):
    options = {option.key: option for option in options_of(record)}
    for name, of in declared(record).items():
        assert (name in options) == (of.key is not None)
        if of.key is not None:
            assert options[name].help.endswith(".")
            assert options[name].name.startswith("--")
            assert options[name].panel


@pytest.mark.parametrize(
    ("record", "of", "side", "bound"), BOUNDED, ids=[f"{r.__name__}-{of.name}-{side}" for r, of, side, _ in BOUNDED]
)
def test_a_value_beyond_its_bound_is_refused_by_name_with_the_bound(record, of, side, bound):
    beyond = bound if side == "above" else bound + (1 if side == "at_most" else -1)
    value = of.kind(beyond)
    with pytest.raises(ValueError, match=r".") as refused:
        checked(record, {of.name: [value] if of.many else value}, {of.name: of.flag})
    assert str(refused.value).startswith(of.flag)
    within = of.kind(bound + (0.5 if side == "above" else 0))
    assert own_keys(plain(checked(record, {of.name: [within] if of.many else within})), record)


def test_option_follows_from_the_declaration():
    dose, shape, times, none = options_of(Own)
    assert (dose.flag, dose.metavar, dose.default, dose.kind) == ("--dose", "MU_MIN", "5", float)
    assert (shape.flag, shape.metavar, shape.default) == ("--shape", "round|square", "round")
    assert (times.flag, times.default, times.kind) == ("--times", "2, 3", list[int])
    assert (none.flag, none.stands_for) == ("--no-times", "times")
    assert times.read(["4", "5"]) == [4, 5]
    with pytest.raises(ValueError, match="--times is 'x'; give a whole number"):
        times.read(["x"])


def test_check_follows_from_the_declaration():
    assert plain(checked(Own, {"times": [7], "dose_mU_min": 50})) == {
        "dose_mU_min": 50.0,
        "shape": "round",
        "times": [7],
        "hidden": 1.0,
    }
    for keys, told in (
        ({"dose_mU_min": 0.0}, "dose_mU_min is 0 mU/min; give a number above 0 mU/min and up to 50 mU/min"),
        ({"dose_mU_min": "5"}, "dose_mU_min is '5'; give a number above 0 mU/min and up to 50 mU/min"),
        ({"shape": "flat"}, "shape is 'flat'; give round or square"),
        ({"colour": 1}, "colour is not a known key; leave it out"),
    ):
        with pytest.raises(ValueError, match=f"^{told}"):
            checked(Own, keys)


def test_defaults_in_words():
    assert [text_of(value) for value in (None, False, (), 2.0, "x", (1.5, 2), ["a", "b"])] == [
        *(None, None, None, "2", "x", "1.5, 2", "a, b")
    ]
