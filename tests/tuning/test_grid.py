"""Ranges as people write them, and grids of tunings."""

from decimal import Decimal

import pytest
from hypothesis import given
from hypothesis import strategies as st

from glucoloop.control import MPCTuning, StateTuning
from glucoloop.control.catalogue import tunable
from glucoloop.tuning.grid import parse_integers, parse_numbers, tuning_grid
from glucoloop.tuning.search import default_filters


@given(first=st.integers(0, 50), length=st.integers(0, 50), step=st.integers(1, 9))
def test_whole_numbers_are_pythons_range(first, length, step):
    assert parse_integers(f"{first}:{first + length}:{step}") == tuple(range(first, first + length + 1, step))


@given(first=st.integers(-500, 500), count=st.integers(1, 200), step=st.integers(1, 99), past=st.integers(0, 98))
def test_decimal_steps_are_exact(first, count, step, past):
    last = first + (count - 1) * step + min(past, step - 1)
    text = ":".join(f"{Decimal(hundredths) / 100:f}" for hundredths in (first, last, step))
    assert parse_numbers(text) == tuple((first + number * step) / 100 for number in range(count))


@pytest.mark.parametrize("controller", tunable())
def test_usual_filters_of_a_controller_are_a_range(controller):
    text = default_filters(controller, {"reference_filter": 0.57})
    filters = parse_numbers(text)
    assert filters == tuple(sorted(filters))


@given(values=st.lists(st.integers(0, 999), min_size=1, max_size=20))
def test_lists_keep_their_order_and_lose_repeats(values):
    assert parse_integers("|".join(map(str, values))) == tuple(dict.fromkeys(values))


@given(text=st.text(max_size=12))
def test_any_other_text_is_refused_in_a_sentence(text):
    told, values = "", ()
    try:
        values = parse_numbers(text, "--move-weight")
    except ValueError as error:
        told = str(error)
    assert told.startswith("--move-weight ") or values


def test_ranges_and_lists_together():
    assert parse_integers("1:3| 8") == (1, 2, 3, 8)
    assert parse_numbers(".3:.5:.1|.57") == (0.3, 0.4, 0.5, 0.57)
    assert parse_numbers("1e-05|1E3:3e3:1e+3") == (1e-5, 1e3, 2e3, 3e3)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("", "write it like"),
        ("1:", "write it like"),
        ("4:1", "lower end first"),
        ("1:4:0", "step above 0"),
        ("1:2:3:4", "write it like"),
        ("1.5", "whole numbers"),
        ("1:99999", "more than 1000"),
        ("nan", "write it like"),
    ],
)
def test_bad_ranges(text, told):
    with pytest.raises(ValueError, match=told):
        parse_integers(text)


def test_range_of_numbers_needs_a_step():
    with pytest.raises(ValueError, match="without a step"):
        parse_numbers("0:3")


def test_grid_leaves_out_what_looks_less_far_than_it_plans():
    grid = tuning_grid([1, 3], [2, 4], move_weights=[0.0, 1.0])
    assert [(one.move_horizon, one.prediction_horizon) for one in grid[::2]] == [(1, 2), (1, 4), (3, 4)]
    assert all(type(one) is MPCTuning for one in grid)
    filtered = tuning_grid([2], [5], reference_filters=[0.3, 0.57], reference_start=0)
    assert filtered == [StateTuning(2, 5, 1.0, 0.0, phi, 0) for phi in (0.3, 0.57)]


def test_grid_of_the_paper_has_its_size():
    assert len(tuning_grid(range(1, 5), range(1, 15))) == 14 + 13 + 12 + 11


def test_empty_and_impossible_grids():
    with pytest.raises(ValueError, match="no reference filters"):
        tuning_grid([1], [2], reference_filters=[])
    with pytest.raises(ValueError, match="no move horizons"):
        tuning_grid([], [2])
    with pytest.raises(ValueError, match="look farther ahead"):
        tuning_grid([4], [2, 3])
    with pytest.raises(ValueError, match="move_weight is -1"):
        tuning_grid([1], [2], move_weights=[-1.0])
