"""Glucagon on the command line: runs, trials and leagues have it, other commands and patients refuse it."""

import polars as pl
import pytest

DAY = ("--patient", "wilinska-2010-glucagon", "--controller", "basal-bolus", "--announce-meals", "--carb-bias", 60)
MEALS = ("--meal", "60g@1h", "--duration", "8h")


@pytest.mark.long
def test_a_run_has_its_columns_metric_and_figure(glucoloop):
    answer = glucoloop("run", *DAY, *MEALS, "--glucagon", "threshold", "--out", "a", "--json")
    assert answer.code == 0
    trace = pl.read_csv("a/trace.csv")
    total = trace["glucagon_ug"].sum()
    assert total > 10.0
    assert answer.json["metrics"]["glucagon_total_ug"] == pytest.approx(total)
    assert answer.json["metrics"]["glucagon_doses"] == (trace["glucagon_ug"] > 0.0).sum()
    with open("a/figure.html", encoding="utf-8") as page:
        assert "Glucagon delivered:" in page.read()
    again = glucoloop("run", "--config", "a/run.toml", "--out", "b")
    assert again.code == 0
    assert pl.read_csv("b/trace.csv").equals(trace)
    capped = glucoloop("run", *DAY, *MEALS, "--glucagon", "threshold", "--guard", "max_glucagon_day_ug=3", "--out", "c")
    assert capped.code == 0
    assert 0.0 < pl.read_csv("c/trace.csv")["glucagon_ug"].sum() <= 3.0
    steps = glucoloop("run", *DAY, *MEALS, "--glucagon", "mini-dose", "--pump", "glucagon_step_ug=40", "--out", "d")
    assert steps.code == 0
    assert set(pl.read_csv("d/trace.csv")["glucagon_ug"]) == {0.0, 120.0}


@pytest.mark.long
def test_a_trial_and_a_league_have_its_amounts(glucoloop):
    answer = glucoloop("trial", *DAY, *MEALS, "--glucagon", "threshold", "--people", 4, "--out", "t", "--json")
    assert answer.code == 0
    [controller] = answer.json["controllers"].values()
    people = pl.read_parquet("t/shards/00000/people.parquet")["glucagon_total_ug"]
    assert controller["engine"] == "native"
    assert controller["metrics"]["glucagon_total_ug"]["mean"] == pytest.approx(people.mean())
    families = ("--patient", "wilinska-2010-glucagon", "--patient", "hovorka-2004")
    small = ("--people", 2, "--scenario", "plain-day", "--sensor", "dexcom-g6", "--controller", "basal-bolus")
    answer = glucoloop("league", *families, *small, "--glucagon", "threshold", "--out", "l")
    assert answer.code == 0
    rows = pl.read_csv("l/league.csv").filter(pl.col("family") == "wilinska-2010-glucagon")
    people = pl.read_parquet("l/people.parquet")
    assert rows["glucagon_ug_day"].is_not_null().all()
    assert "basal-bolus takes no part on hovorka-2004" in " ".join(answer.out.split())
    assert "glucagon_total_ug" in people.columns


@pytest.mark.parametrize("command", ["adversary", "hil", "bound", "tune", "robust", "detect", "replay"])
def test_a_command_without_it_has_no_such_option(glucoloop, command):
    answer = glucoloop(command, "--glucagon", "threshold")
    assert answer.code == 2
    assert "there is no option --glucagon" in answer.err


def test_what_is_not_possible_is_refused(glucoloop):
    for arguments, sentence in (
        (("run", "--patient", "hovorka-2004", "--glucagon", "threshold"), "have no infusion of glucagon"),
        (("run", "--glucagon", "treshold"), "threshold"),
        (("run", "--glucagon", "threshold, gain_ug_per_mg_dl=-1"), "gain_ug_per_mg_dl"),
        (("run", "--glucagon", "mini-dose", "--pump", "max_glucagon_ug=0"), "max_glucagon_ug"),
        (("league", "--bound", 2, "--glucagon", "threshold", "--out", "x"), "searched without glucagon"),
    ):
        answer = glucoloop(*arguments)
        assert answer.code == 2, arguments
        assert sentence in answer.err, arguments
