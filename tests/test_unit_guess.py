"""Plausible ranges: what is asked about, and which unit is named."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from glucoloop import unit_guess
from glucoloop.unit_guess import CONFIRM_OPTION, Quantity, doubt_about, refuse_unusual
from glucoloop.units import mg_dl_from_mmol_l, mu_min_from_u_h

QUANTITIES = {name: value for name, value in vars(unit_guess).items() if isinstance(value, Quantity)}


@pytest.mark.parametrize("name", QUANTITIES)
@given(part=st.floats(0.0, 1.0))
def test_a_value_within_the_range_is_not_asked_about(name, part):
    quantity = QUANTITIES[name]
    value = min(quantity.most, quantity.least + part * (quantity.most - quantity.least))
    assert doubt_about(value, quantity, "it") is None


@pytest.mark.parametrize("name", QUANTITIES)
@given(value=st.floats(allow_nan=True, allow_infinity=True))
def test_a_value_outside_the_range_is_asked_about_and_named(name, value):
    quantity = QUANTITIES[name]
    if quantity.least <= value <= quantity.most or (quantity.zero and value == 0.0):
        return
    told = str(doubt_about(value, quantity, "--it", CONFIRM_OPTION))
    assert told is not None
    assert told.startswith(f"--it is {value:g} {quantity.unit}".rstrip())
    assert "--allow-unusual" in told


@pytest.mark.parametrize(
    ("quantity", "value", "unit", "own"),
    [
        (unit_guess.SETPOINT, 5.5, "mmol/l", mg_dl_from_mmol_l(5.5)),
        (unit_guess.GLUCOSE, 7.8, "mmol/l", mg_dl_from_mmol_l(7.8)),
        (unit_guess.INSULIN_RATE, 1.5, "U/h", mu_min_from_u_h(1.5)),
        (unit_guess.INSULIN_RATE, 1500.0, "mU/h", 25.0),
        (unit_guess.LARGEST_RATE, 4.0, "U/h", mu_min_from_u_h(4.0)),
        (unit_guess.RATE_CHANGE, 1.0, "U/h", mu_min_from_u_h(1.0)),
        (unit_guess.RATE_STEP, 0.05, "U/h", mu_min_from_u_h(0.05)),
        (unit_guess.MEAL, 50_000.0, "mg", 50.0),
        (unit_guess.MEAL, 0.05, "kg", 50.0),
        (unit_guess.SAMPLE_TIME, 300.0, "s", 5.0),
        (unit_guess.SAMPLE_TIME, 5.0 / 60.0, "h", 5.0),
        (unit_guess.DURATION, 10.0, "h", 600.0),
        (unit_guess.NOISE_BOUND, 0.3, "mmol/l", mg_dl_from_mmol_l(0.3)),
    ],
)
def test_a_number_in_another_unit_is_recognised(quantity, value, unit, own):
    told = str(doubt_about(value, quantity, "it"))
    assert told is not None
    assert f"looks like {unit}:" in told
    given_again = float(told.split(". Give ")[1].split(",")[0])
    assert math.isclose(given_again, own, rel_tol=5e-3)
    assert doubt_about(given_again, quantity, "it") is None


def test_a_value_that_no_unit_explains_is_told_the_range():
    assert str(doubt_about(810.0, unit_guess.SETPOINT, "--setpoint", CONFIRM_OPTION)) == (
        "--setpoint is 810 mg/dl; a setpoint is usually from 50 to 250 mg/dl. "
        "Give such a value, or add --allow-unusual if 810 mg/dl is meant"
    )


def test_a_narrower_range_tells_its_reason():
    needed = unit_guess.LARGEST_RATE.within(least=25.6, reason="25.6 mU/min hold the patient at steady state")
    assert str(doubt_about(20.0, needed, "--max-insulin")) == (
        "--max-insulin is 20 mU/min, but 25.6 mU/min hold the patient at steady state. "
        "Give another value, or pass allow_unusual=True if 20 mU/min is meant"
    )
    assert "looks like U/h: 4 U/h is 66.7 mU/min" in str(doubt_about(4.0, needed, "--max-insulin"))


def test_asking_is_an_error():
    refuse_unusual(99.0, unit_guess.SETPOINT, "setpoint_mg_dl")
    with pytest.raises(ValueError, match="looks like mmol/l"):
        refuse_unusual(5.5, unit_guess.SETPOINT, "setpoint_mg_dl")


def test_an_empty_range_is_refused():
    with pytest.raises(ValueError, match="is empty"):
        Quantity("nothing", "mg/dl", 2.0, 1.0)
