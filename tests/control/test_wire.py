"""Whatever comes over a wire becomes an observation, and no controller is hurt by it."""

import datetime
import decimal
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from glucoloop.control import MPCTuning, Status, design_linear_mpc
from glucoloop.control.real_time import observation
from glucoloop.models.step_response import StepResponseModel
from glucoloop.pumps import PARKER_1999_LIMITS

NUMBERS = [104, 104.0, np.float64(104.0), np.float32(104.0), np.int16(104), np.asarray(104.0), jnp.asarray(104.0)]
NUMBERS += [jnp.asarray(104, jnp.int32), jnp.asarray(104.0, jnp.bfloat16)]
NONSENSE = ["104", b"104", "", None, True, False, np.True_, math.nan, math.inf, -math.inf, 10**400, 104j]
NONSENSE += [[104.0], (104.0,), np.asarray([104.0]), jnp.asarray([104.0]), np.asarray(["104"]), jnp.asarray(True)]
NONSENSE += [{}, object(), int, decimal.Decimal(104), datetime.date(2020, 1, 1), np.datetime64("2020-01-01")]


class Hostile(float):
    """Raises at whatever is asked of it."""

    def __float__(self):
        raise RuntimeError

    def __bool__(self):
        raise RuntimeError

    @property
    def __class__(self):
        raise RuntimeError


def seen(glucose=104.0, **others):
    return observation(glucose, **{"setpoint_mg_dl": 100.0, "delivered_mU_min": 22.0, **others})


@pytest.mark.parametrize("number", NUMBERS, ids=lambda number: f"{type(number).__name__}-{number!r}")
def test_number_is_taken_as_it_is(number):
    told = seen(number, delivered_mU_min=number, setpoint_mg_dl=number, announced_carbs_g=number)
    assert bool(told.valid)
    assert {float(leaf) for leaf in jax.tree.leaves(told)} == {1.0, 104.0}


def test_a_time_of_day_is_passed_on_where_it_is_given():
    assert seen().time_of_day_min is None
    assert float(seen(time_of_day_min=420).time_of_day_min) == 420.0
    assert math.isnan(seen(time_of_day_min="07:00").time_of_day_min)


@pytest.mark.parametrize("number", [-5.0, 0, 2000, 1e300, 5e-324])
def test_what_is_plausible_is_not_for_the_reader_to_say(number):
    told = seen(number)
    assert bool(told.valid)
    assert float(told.glucose_mg_dl) == number


@pytest.mark.parametrize("nonsense", NONSENSE, ids=lambda value: type(value).__name__)
def test_what_is_no_number_is_no_reading(nonsense):
    told = seen(nonsense, delivered_mU_min=nonsense, setpoint_mg_dl=nonsense, announced_carbs_g=nonsense)
    assert not bool(told.valid)
    assert math.isnan(told.glucose_mg_dl)
    assert math.isnan(told.delivered_mU_min)
    assert math.isnan(told.setpoint_mg_dl)
    assert float(told.announced_carbs_g) == 0.0


def test_object_that_raises_at_whatever_is_asked_of_it_is_no_number():
    told = seen(Hostile(104.0), delivered_mU_min=Hostile(22.0), valid=Hostile(1.0))
    assert not bool(told.valid)
    assert math.isnan(told.glucose_mg_dl)
    assert math.isnan(told.delivered_mU_min)


def test_controller_goes_on_through_nonsense_and_answers_the_next_reading():
    model = StepResponseModel(step_response=-jnp.arange(1.0, 13.0), sample_time_min=5.0)
    controller = design_linear_mpc(model, MPCTuning(2, 8, 1.0, 1.0))
    step = jax.jit(lambda state, told: controller.step(state, told))
    state = controller.init(seen())
    for nonsense in NONSENSE:
        state, decision = step(state, seen(nonsense, delivered_mU_min=nonsense))
        assert Status(int(decision.status)) is Status.READING_MISSING
        assert PARKER_1999_LIMITS.min_mU_min <= float(decision.insulin_mU_min) <= PARKER_1999_LIMITS.max_mU_min
    _, decision = step(state, seen(160.0))
    assert Status(int(decision.status)) in (Status.OK, Status.SATURATED)
    assert float(decision.insulin_mU_min) > 22.0


@pytest.mark.parametrize("valid", [True, np.True_, np.asarray(True), jnp.asarray(True)])
def test_sensor_may_stand_by_its_reading_in_any_kind_of_truth(valid):
    assert bool(seen(valid=valid).valid)


@pytest.mark.parametrize("valid", [False, np.False_, jnp.asarray(False), None, 1, "true", [True], np.asarray([True])])
def test_reading_that_nobody_stands_by_is_not_valid_but_kept(valid):
    told = seen(valid=valid)
    assert not bool(told.valid)
    assert float(told.glucose_mg_dl) == 104.0


def test_number_beyond_the_arithmetic_in_use_is_none():
    with jax.enable_x64(False):
        told = seen(1e300)
        assert told.glucose_mg_dl.dtype == jnp.float32
        assert not bool(told.valid)


anything = st.one_of(
    st.none(), st.booleans(), st.integers(), st.floats(), st.complex_numbers(), st.text(), st.binary(),
    st.decimals(), st.dates(), st.lists(st.floats(), max_size=2), st.dictionaries(st.text(), st.floats(), max_size=2),
    st.builds(object), st.sampled_from([int, ValueError(), NotImplemented, ...]),
)  # fmt: skip


@given(anything, anything, anything, anything, anything)
def test_any_object_gives_scalars_and_a_reading_that_is_valid_only_if_finite(
    glucose, setpoint, delivered, carbs, valid
):
    told = observation(
        glucose, setpoint_mg_dl=setpoint, delivered_mU_min=delivered, announced_carbs_g=carbs, valid=valid
    )
    assert {leaf.shape for leaf in jax.tree.leaves(told)} == {()}
    assert told.valid.dtype == jnp.bool_
    number = type(glucose) in (int, float) and math.isfinite(_as_float(glucose))
    assert bool(told.valid) == (number and valid is True)
    assert number == math.isfinite(told.glucose_mg_dl)
    assert 0.0 <= float(told.announced_carbs_g) < math.inf


def _as_float(number):
    try:
        return float(number)
    except OverflowError:
        return math.inf
