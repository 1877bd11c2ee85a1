"""The page of a league: every family with a map, who takes no part with the reason, and no word of a script."""

from glucoloop.studies.league import League


def test_the_page_says_who_is_best_who_is_harmed_and_who_takes_no_part(league_page, reader):
    read = reader(league_page)
    assert league_page.startswith("<!doctype html>")
    assert read.text["h2"] == [
        "Best for whom",
        "Where each does harm",
        "Who takes no part, and what is slow",
        "hovorka-2004",
        "roy-parker-2007",
        "Situation",
    ]
    said = " ".join(read.text["li"])
    assert "takes no part on hovorka-2004 in 1 cell (dexcom-g6, plain-day), and is not ranked there" in said
    assert "its &lt;gain&gt; is 0" in league_page
    for name in League.partial({}).left_out:
        assert f"--controller {name} has it in the league" in said
    told = " ".join(read.text["p"])
    assert "All are the nominal patient, and differ in their days and readings alone." in told
    assert "hovorka-2004: best overall is " in told
    assert "<script" not in league_page
    assert league_page.count('<table class="heat"') == 2
    assert "glucoloop league --config league.toml --out again" in read.text["code"]
