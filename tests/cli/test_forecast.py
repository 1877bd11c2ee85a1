"""``glucoloop forecast``: from records to errors, bands, differences and a page."""

import dataclasses
import json
import subprocess
import sys

import numpy as np
import polars as pl
import pytest

from forecast_records import device_record, drawn_record, gridded
from glucoloop.studies.forecast.study import _comparison

QUICK = ("--method", "mean", "--method", "persistence", "--method", "loop-like")


@pytest.fixture
def record(tmp_path):
    device_record(drawn_record(9, 1)).write_parquet(tmp_path / "Doe_Jane.parquet")
    return "Doe_Jane.parquet"


def test_a_forecast_needs_a_record_of_several_days(refused, tmp_path):
    assert "FILE... is missing" in refused("forecast")
    assert "absent.csv" in refused("forecast", "absent.csv")
    device_record(drawn_record(6, 1)).write_parquet(tmp_path / "short.parquet")
    assert "4 of its days before those held out have readings" in refused("forecast", "short.parquet", *QUICK)
    assert "5 or more" in refused("forecast", "short.parquet", *QUICK)
    assert "so nothing is left to fit" in refused("forecast", "short.parquet", "--held-out-days", "7")


def test_what_cannot_be_asked_for_is_refused(refused):
    assert "--horizon is 33 min; give a multiple of 5 min" in refused("forecast", "a.csv", "--horizon", "33")
    assert "--horizon is given twice" in refused("forecast", "a.csv", "--horizon", "30", "--horizon", "30")
    assert "unknown forecast method 'kalmann'" in refused("forecast", "a.csv", "--method", "kalmann")
    assert "--method is given twice" in refused("forecast", "a.csv", "--method", "mean", "--method", "mean")
    assert "there is no option --period" in refused("forecast", "a.csv", "--period", "last-7")


def test_a_simulation_is_no_record(refused, tmp_path):
    (tmp_path / "run").mkdir()
    (tmp_path / "run/glucose_1min.parquet").write_bytes(b"")
    assert "run is a simulation and no record" in refused("forecast", "run")


def test_the_numbers_are_those_of_the_forecasts_that_are_written(glucoloop, record, tmp_path):
    answer = glucoloop("forecast", record, *QUICK, "--horizon", "60", "--out", "out", "--json")
    assert answer.code == 0, answer.err
    plain = json.loads(answer.out)
    forecasts = pl.read_parquet(tmp_path / "out/forecasts.parquet")
    error = pl.col("forecast_mg_dl") - pl.col("reading_mg_dl")
    by = ["method", "future", "horizon"]
    numbers = forecasts.group_by(by).agg(
        rmse=(error**2).mean().sqrt(),
        mae=error.abs().mean(),
        covered=100.0 * pl.col("reading_mg_dl").is_between("low_mg_dl", "high_mg_dl").mean(),
    )
    by_cell = {tuple(row[name] for name in by): row for row in numbers.to_dicts()}
    assert len(plain["people"]) == len(by_cell) == 3 * 2 * 2
    for row in plain["people"]:
        expected = by_cell[row["method"], row["future"], row["horizon"]]
        assert row["rmse_mg_dl"] == pytest.approx(expected["rmse"])
        assert row["mae_mg_dl"] == pytest.approx(expected["mae"])
        assert row["covered_pct"] == pytest.approx(expected["covered"])
    of = {(row["method"], row["horizon"]): row["rmse_mg_dl"] for row in plain["people"] if row["future"] == "known"}
    difference = next(
        row
        for row in plain["differences"]
        if (row["method"], row["horizon"], row["future"]) == ("persistence", "day", "known")
    )
    assert difference["difference_mg_dl"] == pytest.approx(of["persistence", "day"] - of["mean", "day"])
    assert difference["low_mg_dl"] <= difference["difference_mg_dl"] <= difference["high_mg_dl"]
    assert plain["records"][0]["held_out_days"] == 3
    assert not plain["records"][0]["automated"]
    assert all("Doe" not in file.read_text(errors="ignore") for file in (tmp_path / "out").iterdir())
    page = (tmp_path / "out/page.html").read_text(encoding="utf-8")
    assert "forecast 60 min ahead" in page
    assert "reads glucose off them" in page


def test_people_are_beside_one_another_and_one_who_cannot_be_is_named(glucoloop, tmp_path):
    folder = tmp_path / "people"
    folder.mkdir()
    for person in range(3):
        device_record(drawn_record(8, person)).write_parquet(folder / f"{person}.parquet")
    device_record(drawn_record(3, 7)).write_parquet(folder / "short.parquet")
    answer = glucoloop("forecast", "people", "--method", "time-of-day", "--method", "mean", "--out", "out", "--json")
    assert answer.code == 1
    plain = json.loads(answer.out)
    assert [row["person"] for row in plain["records"]] == ["Person 1", "Person 2", "Person 3"]
    assert plain["not_read"][0]["label"] == "Person 4"
    pooled = {(row["method"], row["horizon"], row["future"]): row for row in plain["pooled"]}
    own = [
        row["rmse_mg_dl"]
        for row in plain["people"]
        if (row["method"], row["horizon"], row["future"]) == ("mean", "day", "known")
    ]
    row = pooled["mean", "day", "known"]
    assert row["people"] == 3
    assert row["median_rmse_mg_dl"] == pytest.approx(np.median(own))
    assert (row["lowest_rmse_mg_dl"], row["highest_rmse_mg_dl"]) == (min(own), max(own))
    assert {difference["people"] for difference in plain["differences"]} == {3}


def test_a_method_without_what_it_needs_is_left_out_and_said(glucoloop, tmp_path):
    readings = drawn_record(8, 4).reading_mg_dl
    device_record(gridded(readings)).write_parquet(tmp_path / "a.parquet")
    answer = glucoloop("forecast", "a.parquet", *QUICK, "--json")
    assert answer.code == 0
    plain = json.loads(answer.out)
    assert {row["method"] for row in plain["people"]} == {"mean", "persistence"}
    assert any("loop-like" in note and "0.0 U of insulin a day" in note for note in plain["notes"])


def test_automation_is_said(glucoloop, tmp_path):
    drawn, random = drawn_record(8, 2), np.random.default_rng(0)
    hourly = np.repeat(random.uniform(0.2, 2.0, 8 * 24), 12) / 12.0
    device_record(dataclasses.replace(drawn, basal_U=hourly)).write_parquet(tmp_path / "a.parquet")
    answer = glucoloop("forecast", "a.parquet", "--method", "mean")
    assert answer.code == 0
    assert "Automation dosed" in answer.out
    assert "known to no forecast" in " ".join(answer.out.split())


@pytest.mark.long
def test_every_method_by_default_and_the_same_again(glucoloop, record):
    first, second = (glucoloop("forecast", record, "--json") for _ in range(2))
    assert first.code == 0
    assert first.out == second.out
    methods = {row["method"] for row in json.loads(first.out)["people"]}
    assert methods == {"kalman", "ridge", "loop-like", "twin", "time-of-day", "mean", "persistence"}


def test_help_imports_no_numerical_library():
    code = "import sys, glucoloop.studies.forecast; print({'numpy', 'polars', 'scipy', 'jax'} & {*sys.modules})"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"


def test_the_conclusion_says_who_errs_more_and_who_cannot_be_told_apart():
    def row(method, difference, low, high):
        about = {"method": method, "first": "kalman", "future": "known", "horizon": "60 min", "people": 1}
        return {**about, "difference_mg_dl": difference, "low_mg_dl": low, "high_mg_dl": high}

    pooled = {"method": "kalman", "future": "known", "horizon": "60 min", "median_rmse_mg_dl": 30.04}
    rows = [row("mean", 9.0, 7.0, 11.0), row("ridge", -1.0, -3.0, 0.5), row("own", -4.0, -6.0, -2.0)]
    plain = {"first": "kalman", "records": [{}], "pooled": [pooled], "differences": rows}
    [sentence] = _comparison(plain, "60 min")
    assert sentence == (
        "At 60 min kalman errs by 30.0 mg/dl. The others' errors less that one, with the interval of 95 % over days "
        "held out, are above 0 for mean 9.0 mg/dl (7.0 mg/dl to 11.0 mg/dl); below 0 for own -4.0 mg/dl (-6.0 mg/dl to "
        "-2.0 mg/dl); too near to 0 to tell for ridge -1.0 mg/dl (-3.0 mg/dl to 0.5 mg/dl)."
    )
    assert not list(_comparison({**plain, "differences": []}, "60 min"))
