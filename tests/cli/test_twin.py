"""``glucoloop twin`` and ``glucoloop replay``: from a record to a person whom other commands take."""

import json

import numpy as np
import pytest

from glucoloop.patients.population import alone, draw
from glucoloop.situations.population import named_population, person_of
from lived_records import lived


def test_a_twin_needs_a_record(refused):
    assert "FILE... is missing" in refused("twin")
    assert "absent.parquet" in refused("twin", "absent.parquet")


def test_a_twin_is_of_a_family(refused):
    assert "unknown patient" in refused("twin", "a.csv", "--patient", "hovorka")
    assert "nothing is left" in refused("twin", "a.csv", "--days", "2", "--held-out-days", "2")


def test_a_replay_needs_a_twin(refused, tmp_path):
    assert "no twin is given" in refused("replay", "a.csv")
    assert "holds no twin.json" in refused("replay", "a.csv", "--twin", tmp_path)
    (tmp_path / "twin.json").write_text("{}")
    assert "holds no twin" in refused("replay", "a.csv", "--twin", tmp_path)


@pytest.mark.long
def test_from_a_record_to_another_therapy(glucoloop, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    record, truth = lived("hovorka-2004", "boiroux2017", 2002, days=4)
    record.write_parquet("Doe_Jane.parquet")
    weight = str(truth["weight_kg"])
    twin = glucoloop(
        "twin", "Doe_Jane.parquet", "--weight", weight, "--held-out-days", "1", "--out", "twin", "--json"
    ).json
    assert twin["held_out"]["rmse_mg_dl"] < twin["held_out"]["by_mean_rmse_mg_dl"]
    assert "weight_kg" not in [row["parameter"] for row in twin["parameters"]]
    assert all("Doe" not in file.read_text(errors="ignore") for file in (tmp_path / "twin").iterdir())

    assert alone(person_of("twin/person.toml:twin", "hovorka-2004", 0), 120.0)[1].total_daily_dose_U > 0.0
    drawn = draw(named_population("twin/posterior.toml", "hovorka-2004"), 0, np.arange(500)).values
    assert drawn["weight_kg"] == pytest.approx(truth["weight_kg"], rel=1e-6)
    for row in twin["parameters"]:
        assert np.median(drawn[row["parameter"]]) == pytest.approx(row["value"], rel=0.1)

    asked = ("replay", "Doe_Jane.parquet", "--twin", "twin", "--controller", "basal-bolus", "--draws", "10")
    left_out = glucoloop(*asked, "--out", "replay", "--json").json
    record_row, recorded, controller = left_out["rows"]
    assert recorded["mean_mg_dl"] == pytest.approx(record_row["mean_mg_dl"], abs=15.0)
    assert controller["change_daily_dose_U"] == pytest.approx(
        controller["daily_dose_U"] - recorded["daily_dose_U"], abs=1e-9
    )
    assert "is left out" in (tmp_path / "replay" / "page.html").read_text()

    carried = glucoloop(*asked, "--carry", "--json").json
    assert "carried along" in carried["notes"][-1]
    # with the residual, the recorded doses give the record again
    assert carried["rows"][1]["mean_mg_dl"] == pytest.approx(record_row["mean_mg_dl"], abs=2.0)
    assert np.isfinite(carried["rows"][2]["time_70_180_pct"])
    assert json.loads((tmp_path / "twin" / "twin.json").read_text())["patient"] == "hovorka-2004"
