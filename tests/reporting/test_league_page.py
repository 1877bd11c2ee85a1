"""Page and figure of a league: every family, who takes no part with the reason, and no word of a script."""

import pytest

from glucoloop.studies.league import League
from glucoloop.studies.league.report import _plot_league, files_of


def test_the_page_says_who_is_best_who_is_harmed_and_who_takes_no_part(league_page, reader):
    read = reader(league_page)
    assert league_page.startswith("<!doctype html>")
    assert read.text["h2"] == [
        "Best for whom",
        "Distance to what could be reached",
        "Where each does harm",
        "Who takes no part, and what is slow",
        "hovorka-2004",
        "roy-parker-2007",
        "Situation",
    ]
    said = " ".join(read.text["li"])
    assert "takes no part on hovorka-2004 in 1 cell (dexcom-g6, plain-day), and is not ranked there" in said
    assert "its &lt;gain&gt; is 0" in league_page
    for name in League().left_out:
        assert f"--controller {name} has it in the league" in said
    told = " ".join(read.text["p"])
    assert "All are the nominal patient, and differ in their days and readings alone." in told
    assert "hovorka-2004: best overall is " in told
    assert "On the first 3 people of each family" in told
    assert told.count("for meals known from their start, on 3 people: ") == 2
    assert "<script" not in league_page
    assert league_page.count('<table class="heat"') == 2
    assert "glucoloop league --config league.toml --out again" in read.text["code"]


def test_the_figure_has_the_index_of_each_family_under_each_controller(league):
    asked, found = league
    over_all = {(row["family"], row["controller"]): row for row in found.rows if row["sensor"] == ""}
    figure = _plot_league(asked, found)
    [axes] = figure.axes
    families, controllers = (
        [text.get_text() for text in labels] for labels in (axes.get_yticklabels(), axes.get_xticklabels())
    )
    assert set(over_all) == {(family, controller) for family in families for controller in controllers}
    texts = {(round(text.xy[1]), round(text.xy[0])): text.get_text().split() for text in axes.texts}
    for (family, controller), row in over_all.items():
        told = texts[families.index(family), controllers.index(controller)]
        assert told[0] == ("n/a" if row["gri_mean"] is None else f"{row['gri_mean']:.1f}")
        assert told[1:] == ([f"▲{row['harmed_below_54']}"] if row["harmed_below_54"] else [])
    assert any(row["gri_mean"] is None for row in over_all.values())


@pytest.mark.long
def test_the_figure_is_written_for_print(league):
    files = files_of(*league)
    assert files["figure.pdf"].startswith(b"%PDF")
    assert {"figure.png", "figure.svg", "league.html"} <= files.keys()
