"""Texts of cases, meals, faults and ranges are read or refused in a sentence, and as fast as they are long."""

import time

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from glucoloop.component.grammar import component_text, component_tree, plain
from glucoloop.faults import FAULTS
from glucoloop.situations.case import Case
from glucoloop.situations.meal_text import meal_text, parse_meal
from glucoloop.text import is_printable, printable
from glucoloop.tuning.grid import parse_integers, parse_numbers, tuning_grid

awkward = st.text(alphabet="0123456789.eE+-@ghmin:,= \t\n\0'\"[]{}#_²٣", max_size=20) | st.text(max_size=12)
settings_texts = st.lists(
    st.sampled_from(["start_min=", "value=", "move_weight=", "duration_min=", "key="]).flatmap(
        lambda key: (awkward | st.floats().map(repr) | st.integers().map(str)).map(lambda value: key + value)
    ),
    max_size=3,
).map(", ".join)


@given(awkward | st.tuples(st.floats().map(repr), st.floats().map(repr)).map("g@".join))
@example("1e400g@0")
@example("50@1e400h")
@settings(max_examples=300)
def test_meal_comes_back_from_its_text_or_is_refused(refusal, text):
    if refusal(parse_meal, text) is None:
        meal = parse_meal(text)
        assert parse_meal(meal_text(meal)) == meal


def _case(text):
    return Case.catalogue.read(Case.catalogue.tree(text, "--controller"))


@given(awkward | settings_texts.map("mpc, {}, label=a".format))
@example("mpc, x=" + "[" * 100_000)
@example("mpc, move_weight=" + "9" * 5000)
@example("mpc, move_weight=1\nlabel=2")
@example("mpc, guard=(usual, max_hour=2), model=(identified, memory=48)")
@example("mpc, model=" + "(model=" * 2000 + ")" * 2000)
@settings(max_examples=200)
def test_case_comes_back_from_its_text_or_is_refused(refusal, text):
    if refusal(_case, text) is None:
        told = component_text(_case(text).tree())
        assert component_text(_case(told).tree()) == told


@pytest.mark.long
@given(awkward | settings_texts.map("mpc, {}".format))
@example("mpc, x=(a=(b='1, 2'), c=\")\")")
@example("mpc, x=" + "(x=" * 5000 + ")" * 5000)
@settings(max_examples=200)
def test_tree_of_a_part_comes_back_from_its_text_or_is_refused(refusal, text):
    if refusal(component_tree, text, "--sensor") is None:
        told = component_text(tree := plain(component_tree(text, "--sensor")))
        assert plain(component_tree(told, "--sensor")) == tree


@given(awkward | st.tuples(st.sampled_from([*FAULTS]), settings_texts).map(", ".join))
@example("nonsense, value=nan")
@settings(max_examples=200)
def test_fault_comes_back_from_its_text_or_is_refused(refusal, text):
    if refusal(FAULTS.choose, text) is None:
        told = FAULTS.choose(text).text
        assert FAULTS.choose(told).text == told


@given(awkward)
@example("1:999999999:.000000001")
@example("1:" * 1000)
@settings(max_examples=200)
def test_range_has_few_values_or_is_refused(refusal, text):
    for parse in (parse_integers, parse_numbers):
        if refusal(parse, text) is None:
            assert 1 <= len(parse(text)) <= 1000


def test_grid_that_would_fill_the_memory_is_refused(refusal):
    many = range(1, 1001)
    told = refusal(lambda: tuning_grid(many, many, output_weights=many, move_weights=many))
    assert told is not None
    assert "a grid of 1000000000000 tunings is too large; give at most 100000" in told


@pytest.mark.parametrize("text", ["1" * 200_000, "50" + " " * 200_000 + "x", "50@50" + " " * 200_000 + "x"])
def test_long_text_that_is_no_meal_is_refused_at_once(refusal, text):
    """Backtracking would take minutes."""
    began = time.thread_time()
    assert refusal(parse_meal, text) is not None
    assert time.thread_time() - began < 1.0


@given(st.text())
@example("a\nb\x1b[31m\ud800\u2028\0")
def test_any_text_can_be_printed_in_a_line(text):
    told = printable(text)
    assert is_printable(told)
    assert len(told.splitlines()) <= 1
    told.encode()
    if is_printable(text):
        assert told == text
