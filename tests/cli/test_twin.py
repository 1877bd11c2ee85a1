"""``glucoloop twin`` and ``glucoloop replay``: from a record to a person whom other commands take."""

import dataclasses
import json
import tomllib

import numpy as np
import polars as pl
import pytest
import tomli_w

import glucoloop as gl
from glucoloop.forecasts.grid import gridded_record
from glucoloop.patients.population import alone, draw
from glucoloop.situations.population import named_population, person_of
from glucoloop.twins import StoredTwin, explained_people, replay_people, under_doses
from lived_records import lived


def test_a_twin_needs_a_record(refused):
    assert "FILE... is missing" in refused("twin")
    assert "absent.parquet" in refused("twin", "absent.parquet")


def test_a_twin_is_of_a_family(refused):
    assert "unknown patient" in refused("twin", "a.csv", "--patient", "hovorka")
    assert "nothing is left" in refused("twin", "a.csv", "--days", "2", "--held-out-days", "2")


def test_a_replay_needs_a_twin(refused, tmp_path):
    assert refused("replay", "a.csv").startswith("no twin is given; give the folder of `glucoloop twin`")
    assert "holds no twin.json" in refused("replay", "a.csv", "--twin", tmp_path)
    (tmp_path / "twin.json").write_text("{}")
    assert "holds no twin" in refused("replay", "a.csv", "--twin", tmp_path)


@pytest.mark.long
def test_from_a_record_to_another_therapy(glucoloop, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    record, truth = lived("hovorka-2004", "boiroux2017", 900, days=6)  # within the range of the sensor
    record.write_parquet("Doe_Jane.parquet")
    weight = str(truth["weight_kg"])
    twin = glucoloop(
        "twin", "Doe_Jane.parquet", "--weight", weight, "--held-out-days", "1", "--out", "twin", "--json"
    ).json
    assert twin["predicts"]
    assert twin["checks"][-1]["rmse_mg_dl"] < twin["checks"][-1]["by_mean_rmse_mg_dl"]
    assert "weight_kg" not in [row["parameter"] for row in twin["parameters"]]
    assert all("Doe" not in file.read_text(errors="ignore") for file in (tmp_path / "twin").iterdir())

    assert alone(person_of("twin/person.toml:twin", "hovorka-2004", 0), 120.0)[1].total_daily_dose_U > 0.0
    drawn = draw(named_population("twin/posterior.toml", "hovorka-2004"), 0, np.arange(500)).values
    assert drawn["weight_kg"] == pytest.approx(truth["weight_kg"], rel=1e-6)
    for row in twin["parameters"]:
        assert np.median(drawn[row["parameter"]]) == pytest.approx(row["value"], rel=0.1)

    asked = ("replay", "Doe_Jane.parquet", "--twin", "twin", "--controller", "basal-bolus", "--draws", "2")
    replay = glucoloop(*asked, "--out", "replay", "--json").json
    record_row, recorded, controller = replay["rows"]
    # with what is unexplained, the recorded doses give the record again, at both ends of the sensitivity too
    for end in ("", "_at_0.5", "_at_1.5"):
        assert recorded[f"mean_mg_dl{end}"] == pytest.approx(record_row["mean_mg_dl"], abs=4.0)
    assert controller["change_daily_dose_U"] == pytest.approx(
        controller["daily_dose_U"] - recorded["daily_dose_U"], abs=1e-9
    )
    assert controller["mean_mg_dl_low"] <= controller["mean_mg_dl_at_0.5"] <= controller["mean_mg_dl_high"]
    page = (tmp_path / "replay" / "page.html").read_text()
    assert page.index("The twin predicts") < page.index("basal-bolus instead of the recorded doses")

    # the recorded doses under a change, without a controller
    kept, more = "basal, 100%", "basal, +10%, 0h-6h"
    changes = ("--change", kept, "--change", more, "--draws", "0")
    changed = glucoloop("replay", "Doe_Jane.parquet", "--twin", "twin", *changes, "--out", "changed", "--json").json
    assert [row["therapy"] for row in changed["rows"][2:]] == [kept, more]
    for name in ("mean_mg_dl", "time_70_180_pct", "daily_dose_U"):
        assert changed["rows"][2][name] == pytest.approx(recorded[name], rel=1e-6)
    assert changed["rows"][3]["change_mean_mg_dl"] < 0.0
    again = glucoloop("replay", "Doe_Jane.parquet", "--config", "changed/replay.toml", "--json").json
    assert again["rows"] == changed["rows"]

    # glucose under the doses of the controller is that of the equations with its doses as recorded ones
    courses = pl.read_parquet("replay/courses.parquet")
    of_loop = courses.filter(pl.col("therapy") == "basal-bolus")
    stored = StoredTwin.of(twin)
    record = gridded_record(gl.read_record("Doe_Jane.parquet"))
    [person] = explained_people(list(replay_people(stored, 0, 0))[:1], record, stored.mean_mg_dl)
    none, dosed_U = np.zeros(record.reading_mg_dl.size), of_loop["insulin_mU_min"].to_numpy()[:-1] * 5.0 / 1000.0
    doses = dataclasses.replace(record, basal_U=dosed_U, user_bolus_U=none, automatic_bolus_U=none)
    again = under_doses(person.patient, person.p, person.explained, doses)
    np.testing.assert_allclose(of_loop["glucose_mg_dl"].to_numpy()[1:], again, atol=0.5)

    # the profile of the folder is the one that doses
    person = tmp_path / "twin" / "person.toml"
    keys = tomllib.loads(person.read_text())
    keys["person"][0]["carb_ratio_g_U"] *= 3.0
    person.write_text(tomli_w.dumps(keys))
    low = glucoloop(
        "replay", "Doe_Jane.parquet", "--twin", "twin", "--change", "carbs, 20% too low", "--draws", "0"
    ).out
    assert f"a calculator with {keys['person'][0]['carb_ratio_g_U']:.3g} g/U" in low
    assert glucoloop(*asked, "--json").json["rows"][2]["daily_dose_U"] < controller["daily_dose_U"]

    # no benefit is claimed for a twin that failed
    plain = json.loads((tmp_path / "twin" / "twin.json").read_text())
    failed = {"predicts": False, "verdict": "The twin does not predict this person. Do not rely on it."}
    (tmp_path / "twin" / "twin.json").write_text(json.dumps({**plain, **failed}))
    text = glucoloop(*asked).out
    assert "Do not rely on it" in text
    assert "instead of the recorded doses" not in text
