"""The dose of oref0: the answers of the npm package to the same thousands of questions."""

import functools

import jax
import numpy as np
import pytest

from glucoloop.control.oref0.dose import determine_basal
from glucoloop.control.oref0.forecast import effects_now, predicted, shown_lines
from oref0_package import answers_of, as_written, needs_oref0
from oref0_questions import answered, arguments, call, drawn

COUNT = 10_000


@functools.cache
def asked_and_answered():
    of = drawn(COUNT, 20)
    return of, answers_of("dose", [call(of, i) for i in range(COUNT)])


@needs_oref0
@pytest.mark.long
def test_rate_duration_and_microbolus_are_those_of_the_package_for_any_question():
    of, answers = asked_and_answered()
    given, allowed = arguments(of)
    assert list(answered(as_written(determine_basal)(*given, micro_bolus_allowed=allowed), answers)) == []


@needs_oref0
@pytest.mark.long
def test_forecasts_are_those_of_the_package_for_any_question():
    """But for constant ends, and rising ends of that without insulin, which the package leaves out.

    A product and a sum that a processor takes in one go are rounded once, so that a number between two may go either
    way: 9 of a million points did.
    """
    of, answers = asked_and_answered()
    (glucose, _, iob, meal, profile), _ = arguments(of)
    lines = as_written(shown_lines)(glucose, iob, meal, profile)
    shown = {name.upper(): np.asarray(line).T for name, line in lines.items()}
    exact = as_written(lambda *of: predicted(of[0].glucose_mg_dl, *of[1:], effects_now(*of[:2], of[3])))(
        glucose, iob, meal, profile
    )
    drawn, ties = dict.fromkeys(("IOB", "COB", "UAM", "ZT"), 0), 0
    for i, answer in enumerate(answers):
        if answer.get("predBGs") is None:  # without a reading that can be used
            continue
        for name in drawn:
            theirs, ours = answer["predBGs"].get(name), shown[name][i]
            assert np.all(np.isnan(ours)) == (theirs is None), (i, name)
            if theirs is None:
                continue
            drawn[name] += 1
            assert name == "ZT" or np.all(ours[len(theirs) :] == ours[-1]), (i, name)
            other = np.flatnonzero(ours[: len(theirs)] != theirs)
            raw = np.asarray(getattr(exact, name.lower()))[other, i]
            np.testing.assert_allclose(np.abs(raw - np.asarray(theirs)[other]), 0.5, atol=1e-12)
            ties += other.size
    assert min(drawn.values()) > COUNT // 10
    assert ties <= 20
    ends = np.array([line[-1] for line in shown["EXPECTED"]])
    chosen = np.where(np.isnan(shown["COB"][:, 0]), shown["UAM"][:, -1], shown["COB"][:, -1])
    np.testing.assert_array_equal(ends, np.where(np.isnan(chosen), shown["IOB"][:, -1], chosen))


@needs_oref0
@pytest.mark.long
def test_the_questions_reach_every_answer():
    _, answers = asked_and_answered()
    reasons = [answer["reason"] for answer in answers]
    for words in (
        "CGM is calibrating",
        "BG data is too old",
        "CGM data is unchanged",
        "Replacing high temp basal",
        "Shortening",
        "doing nothing",
        "and minDelta",
        "naive_eventualBG < 40",
        "setting current basal",
        "is a lot less than needed",
        "~< req",
        "m zero temp",
        "in range: no temp required",
        "> max_iob",
        "max_iob",
        "Microbolusing",
        "to microbolus again",
        "low temp of",
        "adj. req. rate",
        "> 2 * insulinReq",
        "no temp, setting",
        ">~ req",
        "no temp required",
        "SMB disabled",
    ):
        assert any(words in reason for reason in reasons), words


@needs_oref0
@pytest.mark.long
def test_code_that_is_compiled_as_usual_breaks_few_ties_otherwise():
    """A quotient by a constant becomes a product, whose last digit may decide a number that lies between two steps."""
    of, answers = asked_and_answered()
    given, allowed = arguments(of)
    told = jax.jit(determine_basal)(*given, micro_bolus_allowed=allowed)
    steps = jax.tree.map(lambda a: np.round(np.asarray(a, float), 9), told)
    assert len(list(answered(steps, answers))) <= COUNT // 500
