"""``glucoloop days``: from a record to a scenario that other commands live, and virtual people beside the record."""

import json
import tomllib

import numpy as np
import polars as pl
import pytest

from forecast_records import device_record, drawn_record, gridded


@pytest.fixture
def record(tmp_path):
    """A record in which every second entered meal has no bolus."""
    days = drawn_record(7, 1)
    bolus_U = days.user_bolus_U.copy()
    bolus_U[np.flatnonzero(bolus_U)[::2]] = 0.0
    record = gridded(days.reading_mg_dl, basal_U=days.basal_U, bolus_U=bolus_U, carbs_g=days.carbs_g)
    device_record(record).write_parquet(tmp_path / "Doe_Jane.parquet")
    return "Doe_Jane.parquet"


def test_days_need_a_record_that_tells_habits(refused, tmp_path):
    assert "FILE... is missing" in refused("days")
    short = drawn_record(4, 1)
    device_record(short).write_parquet(tmp_path / "short.parquet")
    assert "short.parquet: it has 4 days with readings for half of the time" in refused("days", "short.parquet")
    device_record(gridded(short.reading_mg_dl)).write_parquet(tmp_path / "plain.parquet")
    assert "give the rate with --basal" in refused("days", "plain.parquet")
    longer = drawn_record(7, 1)
    device_record(gridded(longer.reading_mg_dl, basal_U=longer.basal_U)).write_parquet(tmp_path / "no-meals.parquet")
    assert "it has no meals" in refused("days", "no-meals.parquet")


def test_what_the_record_tells_is_not_asked_for(refused):
    for option in ("--meal", "--scenario", "--habit", "--announce-meals", "--start", "--profile"):
        assert f"there is no option {option}" in refused("days", "a.csv", option, "week")


@pytest.mark.long
def test_virtual_people_stand_beside_the_record(glucoloop, record, tmp_path):
    answer = glucoloop("days", record, "--people", "3", "--out", "out", "--json")
    assert answer.code == 0, answer.err
    plain = json.loads(answer.out)
    [own, *others] = plain["rows"]
    days = drawn_record(7, 1)
    readings = np.clip(days.reading_mg_dl, 40.0, 400.0)
    readings = readings[np.isfinite(readings)]
    assert own["mean_mg_dl"] == pytest.approx(readings.mean())
    assert own["time_70_180_pct"] == pytest.approx(100.0 * np.mean((readings >= 70.0) & (readings <= 180.0)))
    assert own["carbs_g_day"] == pytest.approx(days.carbs_g.sum() / 7)
    assert [(row["who"], row["over_people"]) for row in others] == [
        ("basal-bolus", of) for of in ("median", "low", "high")
    ]
    median, low, high = others
    for name in ("mean_mg_dl", "carbs_g_day", "rises_day"):
        assert low[name] <= median[name] <= high[name]
    assert plain["habits"]["without_bolus"] == pytest.approx(0.5, abs=0.03)
    for name in ("carbs_g_day", "meals_day"):
        assert median[name] == pytest.approx(own[name], rel=0.3), name
    assert pl.read_csv(tmp_path / "out/numbers.csv")["who"].to_list() == ["Record", *["basal-bolus"] * 3]
    page = (tmp_path / "out/page.html").read_text()
    assert "Nights, 0 to 6 h" in page
    assert "Not learnt" in page
    assert all("Doe" not in file.read_text(errors="ignore") for file in (tmp_path / "out").iterdir())

    scenario = tomllib.loads((tmp_path / "out/scenario.toml").read_text())
    assert len(scenario["meals"]) >= 3
    run = ("run", "--patient", "hovorka-2004", "--controller", "basal-bolus", "--scenario", "out/scenario.toml")
    assert glucoloop(*run, "--days", "1", "--json").code == 0
    again = glucoloop("trial", "--config", "out/trial.toml", "--people", "2", "--out", "again", "--json")
    assert again.code == 0, again.err
