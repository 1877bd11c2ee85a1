"""What the figure and the tables of a search show."""

import io

import numpy as np
import polars as pl
import pytest
from rich.console import Console

from glucoloop.situations.situation import configured
from glucoloop.storage.results import Results
from glucoloop.studies.robust import Search
from glucoloop.studies.robust.search import NO_SCORES, SearchEngine, _Bound, _judged
from glucoloop.studies.robust.study import _plot_robust, tables

ASKED = configured(Search, at_most=["peak-median=95"], batch=40, rounds=1)
SCORES = dict.fromkeys(NO_SCORES, 1.0)


def candidates():
    random = np.random.default_rng(0)
    for place in range(40):
        trade, worse = random.random(2)
        found = {"undershoot_p95_mg_dl": 2.0 + 8.0 * trade + worse, "peak_median_mg_dl": 98.0 - 10.0 * trade + worse}
        tuning = ASKED.initial if place == 0 else {of.name: of.at(random.random()) for of in ASKED.space}
        yield {"candidate": place, "round": 0, **tuning, **(NO_SCORES if place == 5 else {**SCORES, **found})}


class Engine(SearchEngine):
    """A search whose references and check are known."""

    def __init__(self):
        self.config, self.bounds = ASKED, [_Bound("peak-median", 95.0)]
        self.references = {"mpc-se": {**SCORES, "undershoot_p95_mg_dl": 13.0, "peak_median_mg_dl": 92.0}}
        self.subjects = type("Subjects", (), {"infeasible": 0})
        self._loops = {}

    def check(self, tuning):
        values = np.linspace(0.0, 12.0, 50)
        group = ["people"] * 20 + ["noise"] * 30
        labels = ("chosen", "mpc-se")
        table = pl.concat(
            pl.DataFrame({"controller": label, "group": group, "undershoot_mg_dl": values + k})
            for k, label in enumerate(labels)
        )
        return table, dict.fromkeys(labels, SCORES)


@pytest.fixture(scope="module")
def found():
    return Engine().results_of(list(candidates()))


def test_front_is_drawn_with_its_marks(found):
    figure = _plot_robust(ASKED, found)
    figure.savefig(io.BytesIO(), format="png", dpi=50)
    axes, *others = figure.axes
    assert axes.get_xlabel() == "Undershoot, 95th percentile (mg/dl)"
    front = next(line for line in axes.lines if line.get_drawstyle() == "steps-post")
    told = [of["scores"]["undershoot_p95_mg_dl"] for of in found.plain["front"]]
    np.testing.assert_array_equal(front.get_xdata(), told)
    assert told == sorted(told)
    assert all(y <= 95.0 for y in front.get_ydata())
    legend = [text.get_text() for text in figure.legends[0].get_texts()]
    assert legend == ["exceeds a bound", "tuning", "front", "chosen", "as it was", "mpc-se", "bound"]
    assert [of.get_title(loc="left") for of in others] == ["20 people not seen", "30 seeds not seen"]
    left, right = axes.get_xlim()
    assert left < 13.0 < right


def test_tables_hold_the_front_and_the_others(found):
    table = found.tables["candidates.csv"]
    assert not table["keeps_the_bounds"][5]
    assert table.equals(
        _judged(
            table.drop("chosen", "on_the_front", "keeps_the_bounds"), [_Bound("peak-median", 95.0)], ASKED.objectives
        )
    )
    console = Console(width=200, record=True)
    with console.capture() as captured:
        console.print(*tables(configured(Search, at_most=["peak-median=95"], top=3), Results(found.plain)))
    first, second = captured.get().split("Never seen before")
    rows = [line.split() for line in first.splitlines()]
    assert [row[0] for row in rows if row[:1] in (["chosen"], ["mpc-se"])] == ["chosen", "mpc-se"]
    assert "as it was" in first
    assert sum("1.0" in row for row in rows) <= 3 + 1 + 2
    assert "Candidate" not in second
