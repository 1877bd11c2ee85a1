import io

import numpy as np
import pytest

from glucoloop.studies.robust.figure import plot_robust
from glucoloop.studies.robust.front import Bound
from glucoloop.studies.robust.keys import read_robust
from glucoloop.studies.robust.objectives import OBJECTIVES
from glucoloop.studies.robust.search import Candidate, Checked, judge
from glucoloop.studies.robust.table import check_table, robust_table

SEARCH = read_robust({"at_most": ["peak-median=95"]}).search
BOUNDS = [Bound("peak-median", 95.0)]
REFERENCES = {"mpc-se": {**dict.fromkeys(OBJECTIVES, 1.0), "undershoot-p95": 13.0, "peak-median": 92.0}}


def candidates(number=40):
    random = np.random.default_rng(0)
    for place in range(number):
        trade, worse = random.random(2)
        scores = dict.fromkeys(OBJECTIVES, 1.0)
        scores |= {"undershoot-p95": 2.0 + 8.0 * trade + worse, "peak-median": 98.0 - 10.0 * trade + worse}
        tuning = SEARCH.start if place == 0 else {of.name: of.at(random.random()) for of in SEARCH.space}
        yield Candidate(place, tuning, scores if place != 5 else dict.fromkeys(OBJECTIVES, float("nan")))


@pytest.fixture(scope="module")
def found():
    return list(candidates())


@pytest.fixture(scope="module")
def checked():
    values = np.linspace(0.0, 12.0, 50)
    scores = dict.fromkeys(OBJECTIVES, 2.0)
    return [Checked(label, scores, values + k, values, values, 20) for k, label in enumerate(("chosen", "mpc-se"))]


@pytest.mark.parametrize("width", ["single", "double"])
def test_front_is_drawn_with_its_marks(found, checked, width):
    verdict = judge(SEARCH, BOUNDS, found)
    figure = plot_robust(SEARCH, found, verdict, BOUNDS, REFERENCES, checked, width=width)
    figure.savefig(io.BytesIO(), format="png", dpi=50)
    axes, *others = figure.axes
    assert axes.get_xlabel() == "Undershoot, 95 % (mg/dl)"
    drawn = {line.get_label(): line for line in axes.lines}
    front = next(line for line in drawn.values() if line.get_drawstyle() == "steps-post")
    np.testing.assert_array_equal(
        front.get_xdata(),
        sorted(of.scores["undershoot-p95"] for of, on in zip(found, verdict.front, strict=True) if on),
    )
    assert all(y <= 95.0 for y in front.get_ydata())
    legend = [text.get_text() for text in figure.legends[0].get_texts()]
    assert legend == ["exceeds a bound", "tuning", "front", "chosen", "as it was", "mpc-se", "bound"]
    assert [of.get_title(loc="left") for of in others] == ["20 people not seen", "30 seeds not seen"]
    left, right = axes.get_xlim()
    assert left < 13.0 < right


def test_nothing_to_draw_is_refused():
    none = [Candidate(0, SEARCH.start, dict.fromkeys(OBJECTIVES, float("nan")))]
    with pytest.raises(ValueError, match="no tuning of the search has a controller"):
        judge(SEARCH, BOUNDS, none)
    verdict = judge(SEARCH, BOUNDS, list(candidates(3)))
    with pytest.raises(ValueError, match="nothing to draw"):
        plot_robust(SEARCH, none, verdict, BOUNDS, REFERENCES, [])


def test_tables_hold_the_front_and_the_others(found, checked):
    verdict = judge(SEARCH, BOUNDS, found)
    assert not verdict.keeps[5]
    table = robust_table(SEARCH, found, verdict, REFERENCES, top=3)
    marks = list(table.columns[0].cells)
    assert marks.count("chosen") == 1
    assert marks[-1] == "mpc-se"
    assert "as it was" in marks
    assert table.row_count <= 3 + 1 + 2
    assert check_table(checked).row_count == 2
