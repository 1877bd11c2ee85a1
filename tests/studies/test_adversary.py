"""The search for the worst sensor errors: its space, and that it finds what is known to be the worst."""

import dataclasses

import numpy as np
import pytest

from glucoloop.situations.situation import configured
from glucoloop.studies.adversary import Adversary
from glucoloop.studies.adversary.attack import ErrorSpace, _Harm, generations

SPACE = ErrorSpace(samples=24, error=0.2, hold_samples=5, stretches=2, stretch_samples=3)


def effort_of(**settings):
    return configured(Adversary, settings)


def toy(errors, stuck_from):
    """A harm whose worst errors are known: each at its bound, with the sign of its weight, stuck from sample 17 on."""
    weight = np.where(np.arange(24) < 10, -1.0, 2.0)
    return weight @ errors - 0.1 * np.abs(stuck_from - 17.0).sum(axis=0)


MOST = 0.2 * (10 * 1.0 + 14 * 2.0)


def test_errors_hold_and_keep_their_bound():
    assert (SPACE.pieces, SPACE.dimension) == (5, 7)
    points = np.linspace(-3.0, 3.0, 7)[None]
    errors = SPACE.errors(points)
    assert errors.shape == (24, 1)
    assert np.abs(errors).max() == 0.2
    assert len(np.unique(errors[5:10])) == 1
    stuck = SPACE.stuck_from(np.array([[0.0] * 5 + [-1.0, 5.0]]))
    assert stuck[:, 0].tolist() == [0.0, 23.0]


def test_the_search_finds_the_known_worst_errors():
    *_, last = generations(toy, SPACE, effort_of(generations=60, starts=2, sequences=16, search_seed=3))
    assert last.best_score == pytest.approx(MOST, rel=1e-3)
    np.testing.assert_allclose(SPACE.stuck_from(last.best[None])[:, 0], 17.0)


def test_it_finds_more_than_chance_does_with_as_many_tries():
    effort = effort_of(generations=40, starts=2, sequences=16, search_seed=4)
    *_, last = generations(toy, SPACE, effort)
    points = SPACE.random_points(4, np.arange(40 * effort.lanes))
    assert last.best_score > toy(SPACE.errors(points), SPACE.stuck_from(points)).max()


def test_a_search_that_was_cut_short_goes_on_to_the_same_bits():
    effort = effort_of(generations=30, starts=2, sequences=8, search_seed=5)
    whole = list(generations(toy, SPACE, effort))
    asked = []

    def counted(errors, stuck_from):
        asked.append(errors.shape[1])
        return toy(errors, stuck_from)

    again = list(generations(counted, SPACE, effort, [one.score for one in whole[:13]]))
    assert asked == [16] * 17
    for one, other in zip(whole, again, strict=True):
        np.testing.assert_array_equal(one.score, other.score)
        np.testing.assert_array_equal(one.best, other.best)


def test_larger_errors_are_never_found_to_do_less():
    """The worst of smaller errors is the first sequence that is tried of larger ones, and where a start goes on."""
    effort = effort_of(generations=20, starts=2, sequences=8, search_seed=6)
    *_, small = generations(toy, SPACE, effort)
    large = dataclasses.replace(SPACE, error=0.3)
    known = large.points_of(SPACE, small.best)
    np.testing.assert_allclose(large.errors(known[None]), SPACE.errors(small.best[None]), rtol=1e-14)
    np.testing.assert_array_equal(large.stuck_from(known[None]), SPACE.stuck_from(small.best[None]))
    first, *_ = searched = list(generations(toy, large, effort, start_point=known))
    assert first.score[0] == pytest.approx(small.best_score)
    assert searched[-1].best_score >= small.best_score
    again = list(generations(toy, large, effort, [one.score for one in searched[:7]], known))
    np.testing.assert_array_equal(again[-1].best, searched[-1].best)
    with pytest.raises(ValueError, match="give a space of smaller errors"):
        SPACE.points_of(large, small.best)


def test_another_seed_asks_for_other_sequences():
    first, second = (next(generations(toy, SPACE, effort_of(search_seed=seed))).score for seed in (1, 2))
    assert not np.array_equal(first, second)


def test_what_is_not_a_number_is_no_harm():
    def broken(errors, stuck_from):
        return _Harm(
            below_54_min=np.zeros(errors.shape[1]),
            lowest_mg_dl=np.where(errors[0] > 0.0, np.nan, 60.0 - 10.0 * errors[0]),
            peak_mg_dl=np.zeros(errors.shape[1]),
        ).score

    *_, last = generations(broken, SPACE, effort_of(generations=20, starts=1, sequences=8))
    assert np.isfinite(last.best_score)
    assert SPACE.errors(last.best[None])[0, 0] <= 0.0


def test_minutes_count_before_lowest_glucose():
    harm = _Harm(
        below_54_min=np.array([0.0, 0.0, 5.0]), lowest_mg_dl=np.array([80.0, 60.0, 50.0]), peak_mg_dl=np.ones(3)
    )
    assert (np.diff(harm.score) > 0.0).all()
