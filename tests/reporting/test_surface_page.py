"""The page of a search over tunings."""

import dataclasses
import re
from types import SimpleNamespace

import numpy as np

from glucoloop.control import MPCTuning
from glucoloop.studies.tuning.study import MAX_ROWS, _Searched, _surface_page, sentences
from glucoloop.tuning.grid import tuning_grid


def cells(page):
    """Class and title of each cell of the surface, from the top row down."""
    tables = re.findall(r'<table class="surface">.*?</table>', page, re.DOTALL)
    return [re.findall(r'<td class="([^"]*)"[^>]*title="([^"]*)"', table) for table in tables]


def page_of(surface, printed, grid=None, **common):
    searched = _Searched(surface, surface.rank_of(printed))
    return _surface_page(
        searched, "A <title>", grid or [*surface.tunings, *(tuning for tuning, _ in surface.refused)], **common
    )


def test_every_place_of_the_grid_is_a_cell_that_says_what_it_is(surface_of):
    tunings = tuning_grid([1, 2], [1, 2, 8])
    surface = surface_of(tunings[:4], [3.0, np.nan, 20.0, 40.0])
    surface = dataclasses.replace(surface, refused=((tunings[4], "the move is too <fast>"),))
    (found,) = cells(page_of(surface, tunings[0]))
    assert [kind for kind, _ in found] == ["impossible", "kept", "refused", "kept", "refused", "kept"]
    assert found[0][1] == "p &lt; m, no such tuning"
    assert found[2][1] == "no controller can be designed: the move is too &lt;fast&gt;"
    assert found[4][1] == "(1, 2, 1, 0): glucose left the finite numbers"
    assert found[3][1].startswith("(1, 1, 1, 0): SSE 3 (mg/dl)²")


def test_best_and_printed_are_marked_and_listed(surface_of):
    tunings = tuning_grid([1, 2], [2, 8])
    page = page_of(surface_of(tunings, [30.0, 10.0, 20.0, 40.0]), tunings[3], sentences=["A & B."])
    assert re.search(r'title="\(1, 8, 1, 0\)[^"]*">10<b>★</b></td>', page)
    assert re.search(r'title="\(2, 8, 1, 0\)[^"]*">40<b>◆</b></td>', page)
    assert page.count('<tr class="printed">') == 1
    assert '<th scope="col">Remarks</th>' in page  # on the left, as the remarks are
    assert "<p>A &amp; B.</p>" in page
    assert "A &lt;title&gt;" in page
    assert not re.search(r"<script|src=|href=", page)


def test_a_tuning_beside_the_grid_makes_no_row_of_its_own(surface_of):
    grid = tuning_grid([1, 2], [2, 8])
    printed = MPCTuning(3, 5)
    page = page_of(surface_of([*grid, printed], [30.0, 10.0, 20.0, 40.0, 5.0]), printed, grid=grid)
    (found,) = cells(page)
    assert len(found) == 4
    assert "The printed tuning (3, 5, 1, 0) is not on it." in page
    assert "10<b>★</b>" in page
    assert page.count('<tr class="printed">') == 1


def test_a_long_list_is_cut_but_shows_the_printed_tuning(surface_of):
    tunings = tuning_grid(range(1, 16), range(15, 31))
    page = page_of(surface_of(tunings, 1.0 + np.arange(len(tunings))), tunings[-1])
    assert f"The first {MAX_ROWS} of 240 tunings" in page
    assert page.count('<td class="value">30</td>') >= 1
    assert '<tr class="printed">' in page


def test_tunings_that_share_the_minimum_are_said_to(surface_of):
    def sentence(*sse):
        surface = surface_of(tuning_grid([1], [2, 4, 8]), list(sse))
        return next(sentences(None, SimpleNamespace(extra=_Searched(surface, surface.rank_of(surface.tunings[0])))))

    subject = "The printed tuning (1, 2, 1, 0)"
    assert (
        sentence(0.0, 0.0, 0.0)
        == f"{subject} shares the minimum sum of squared errors with all others of 3 acceptable ones."
    )
    assert sentence(1.0, 1.0, 2.0) == (
        f"{subject} shares the minimum sum of squared errors with 1 other of 3 acceptable ones."
    )
    assert sentence(1.0, 2.0, 2.0) == f"{subject} is the best of 3 acceptable ones."
