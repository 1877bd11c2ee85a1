"""``glucoloop identify``."""

import json

import numpy as np
import polars as pl
import pytest

import glucoloop as gl


def test_model_of_the_patient(glucoloop, tmp_path):
    report = glucoloop("identify", "--out", "model", "--json").json
    identified = gl.identify(gl.patient())
    assert report["model"]["step_response"] == np.asarray(identified.model.step_response).tolist()
    assert set(report["files"]) == {
        "fit.json", "identify.toml", "model.json", "record.csv", "response.png", "response.svg", "validation.png",
        "validation.svg",
    }  # fmt: skip
    assert report["validation"]["on"] == "random binary sequence"
    assert json.loads((tmp_path / "model/model.json").read_text()) == report["model"]


def test_record_gives_the_model_it_was_written_with(glucoloop, tmp_path):
    first = glucoloop("identify", "--noise", 1.45, "--seed", 4, "--out", "first", "--json").json
    assert pl.read_csv(tmp_path / "first/record.csv").height == 73
    answer = glucoloop("identify", "--data", "first/record.csv", "--out", "second", "--json")
    assert "cross-correlation, since" in answer.err
    np.testing.assert_allclose(answer.json["model"]["step_response"], first["model"]["step_response"], rtol=1e-12)
    again = glucoloop("identify", "--config", "second/identify.toml", "--json").json
    assert again["model"]["step_response"] == answer.json["model"]["step_response"]


def test_record_of_a_lively_input_is_fitted_by_least_squares(glucoloop, tmp_path):
    patient = gl.patient()
    insulin = float(patient.basal_insulin_mU_min) + np.random.default_rng(0).uniform(-5, 5, 300)
    record = gl.excite(patient, insulin)
    rows = [f"{5 * k},{u!r},{float(record.glucose_mg_dl[k])!r}" for k, u in enumerate(insulin.tolist())]
    rows[50] = rows[50].rpartition(",")[0] + ","
    (tmp_path / "r.csv").write_text("t_min,insulin_mU_min,glucose_mg_dl\n" + "\n".join(rows))
    answer = glucoloop("identify", "--data", "r.csv", "--not-from-rest", "--json")
    assert "least squares, since" in answer.err
    assert "1 of 300 samples were missing" in answer.err
    assert answer.json["fit"]["gain_mg_dl_per_mU_min"] == pytest.approx(-2.8, abs=0.4)


def test_best_pole_dead_time_and_sample_time(glucoloop):
    report = glucoloop(
        "identify", "--best-pole", "--dead-time", 20, "--sample-time", 10, "--samples", 60, "--json"
    ).json
    assert 0.5 < report["fit"]["laguerre_pole"] < 0.9
    assert report["model"]["provenance"]["dead_time_min"] == 20.0
    assert len(report["model"]["step_response"]) == 18


def test_unsmoothed_model(glucoloop):
    report = glucoloop("identify", "--laguerre-functions", 0, "--noise", 1, "--json").json
    assert report["fit"]["laguerre_coefficients"] == []


def test_where_to_use_it(glucoloop):
    out = glucoloop("identify", "--sample-time", 10, "--dead-time", 10, "--out", "m").out
    line = next(line for line in out.splitlines() if line.startswith("Use it: glucoloop "))
    assert glucoloop(*line.removeprefix("Use it: glucoloop ").split(), "--duration", 100).code == 0
