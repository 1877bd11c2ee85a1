"""Exercise as a text: what a person may write, and the way back."""

import contextlib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from glucoloop.physiology.exercise import Exercise
from glucoloop.situations.meal_text import exercise_text, parse_exercise, same_exercise
from glucoloop.situations.run import Run
from glucoloop.situations.situation import configured


@given(st.builds(Exercise, st.floats(1e-3, 100.0), st.floats(0.0, 1e5), st.floats(1.0, 1440.0)))
def test_the_text_of_a_bout_is_read_as_the_same_bout(bout):
    assert parse_exercise(exercise_text(bout)) == bout


@pytest.mark.parametrize("text", ["50%@14h/30min", " 50 % @ 840 min / 0.5 h ", "5e1%@840m/30m", "50.%@.35e2d/30min"])
def test_what_a_person_may_write(text):
    assert parse_exercise(text).intensity_pct == 50.0
    assert parse_exercise(text).duration_min == 30.0


@pytest.mark.parametrize(
    "text", ["", "50@14h/30min", "50%@14/30min", "50%@14h", "50%@14h/30", "50 %14h/30min", "%@h/min"]
)
def test_what_lacks_a_part_or_a_unit_is_refused(text):
    with pytest.raises(ValueError, match=r"is not exercise; write its intensity .*, like 50%@14h/30min"):
        parse_exercise(text)


@given(st.text(st.sampled_from("0159.%@/hmind e-"), max_size=16))
def test_any_text_is_read_or_refused(text):
    with contextlib.suppress(ValueError):
        read = same_exercise([text])
        assert same_exercise(read) == read


def test_a_run_takes_exercise_of_a_patient_that_has_it():
    run = configured(Run, patient="mcgill-2020", exercise=["50%@2h/30min"], controller=["pid"])
    assert run.exercise == ("50%@120min/30min",)
    assert run.as_scenario().exercise == (Exercise(50.0, 120.0, 30.0),)
    with pytest.raises(ValueError, match=r"the equations of parker-1999 have no exercise, .* leave it out, or take a"):
        configured(Run, exercise=["50%@2h/30min"])
