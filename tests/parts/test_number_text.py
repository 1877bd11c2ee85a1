"""Numbers and times in texts."""

import pytest

from glucoloop.parts.keyed_values import keyed_values
from glucoloop.parts.number_text import is_time, minutes_of, number_of

TIMES = {"10h": 600.0, "90min": 90.0, "90m": 90.0, "2d": 2880.0, " 1.5 h ": 90.0, "1e1h": 600.0, "-3h": -180.0}


@pytest.mark.parametrize("text", TIMES)
def test_times_have_units(text):
    assert minutes_of(text) == TIMES[text]


@pytest.mark.parametrize("text", ["", "10", "h", "10s", "1h30min", "10 hours", "nanh", "1_0h", "١h", "1:3"])
def test_what_is_no_time_with_a_unit(text):
    assert minutes_of(text) is None


def test_which_keys_are_times():
    assert all(map(is_time, ("duration_min", "closed_loop_min", "on_board_tau_min", "meal_time_spread_min")))
    others = ("max_insulin_mU_min", "fastest_mg_dl_min", "largest_disturbance_mg_min", "carbs_g_min", "seed", "t_h")
    assert not any(map(is_time, others))


def test_settings_take_times():
    told = keyed_values(["lag_min=.5h", "start_min='2h'", "step_mU_min=3h", "share=1h"], "sensor", "lag_min=8")
    assert told == {"lag_min": 30.0, "start_min": 120.0, "step_mU_min": "3h", "share": "1h"}


@pytest.mark.parametrize("text", ["1_0", "١٠", "１", "1e1_0", "x", ""])
def test_what_is_no_number(text):
    for kind in (int, float):
        with pytest.raises(ValueError, match=r"."):
            number_of(text, kind)
