"""``glucoloop identify``."""

import json
import re

import numpy as np
import polars as pl
import pytest

import glucoloop as gl
from device_files import clarity
from naming import naming


@pytest.mark.long
def test_model_of_the_patient(glucoloop, tmp_path):
    report = glucoloop("identify", "--out", "model", "--json").json
    identified = gl.identify(gl.patient())
    assert report["model"]["step_response"] == np.asarray(identified.model.step_response).tolist()
    assert set(report["files"]) == {
        "fit.json", "identify.toml", "model.json", "record.csv", "response.pdf", "response.png", "response.svg",
        "tables.tex", "validation.pdf", "validation.png",
        "validation.svg",
    }  # fmt: skip
    assert report["validation"]["on"] == "random binary sequence"
    assert json.loads((tmp_path / "model/model.json").read_text()) == report["model"]


@pytest.mark.long
def test_record_gives_the_model_it_was_written_with(glucoloop, tmp_path):
    first = glucoloop("identify", "--noise", 1.45, "--seed", 4, "--out", "first", "--json").json
    assert pl.read_csv(tmp_path / "first/record.csv").height == 73
    answer = glucoloop("identify", "--data", "first/record.csv", "--out", "second", "--json")
    assert "cross-correlation, since" in answer.err
    np.testing.assert_allclose(answer.json["model"]["step_response"], first["model"]["step_response"], rtol=1e-12)
    again = glucoloop("identify", "--config", "second/identify.toml", "--json").json
    assert again["model"]["step_response"] == answer.json["model"]["step_response"]


@pytest.mark.long
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


def written(path, insulin, glucose):
    rows = [f"{5 * k},{u!r},{y!r}" for k, (u, y) in enumerate(zip(insulin.tolist(), glucose.tolist(), strict=True))]
    path.write_text("t_min,insulin_mU_min,glucose_mg_dl\n" + "\n".join(rows))


@pytest.fixture
def moved():
    """Rates that move every sample, and what a person answers to them."""
    patient = gl.patient()
    insulin = float(patient.basal_insulin_mU_min) + np.random.default_rng(0).uniform(-5, 5, 300)
    return insulin, np.asarray(gl.excite(patient, insulin).glucose_mg_dl)[:300]


@pytest.mark.long
def test_a_record_in_which_insulin_raises_glucose_gives_no_model_to_use(glucoloop, refused, tmp_path, moved):
    insulin, glucose = moved
    written(tmp_path / "r.csv", insulin, 162.0 - glucose)
    out = glucoloop("identify", "--data", "r.csv", "--out", "m").out
    assert "DO NOT USE THIS MODEL" in out
    assert "more insulin would raise glucose" in out
    assert "Use it" not in out
    assert "more insulin would raise glucose" in refused("run", "--model", "m/model.json")


@pytest.mark.long
def test_a_record_that_says_nothing_of_insulin_gives_no_model_to_use(glucoloop, refused, tmp_path, moved):
    insulin, _ = moved
    written(tmp_path / "r.csv", insulin, 120.0 + np.cumsum(np.random.default_rng(1).normal(0, 2, 300)))
    answer = glucoloop("identify", "--data", "r.csv", "--out", "m", "--json")
    assert answer.json["doubts"]
    assert "DO NOT USE THIS MODEL" in answer.err
    told = refused("run", "--model", "m/model.json")
    assert answer.json["doubts"][0] in told
    out = glucoloop("run", "--model", "m/model.json", "--allow-unusual", "--duration", 60).out
    assert f"Doubtful model: {answer.json['doubts'][0]}" in out


@pytest.mark.long
def test_meals_of_a_record_are_fitted_and_kept(glucoloop, tmp_path):
    patient, begins = gl.patient(), (80, 250, 420)
    insulin = float(patient.basal_insulin_mU_min) + np.repeat(np.random.default_rng(0).uniform(-10, 10, 100), 6)
    since = np.maximum(5.0 * (np.arange(600)[:, None] - begins), 0.0)
    raised = (60.0 * since / 80.0 * np.exp(1.0 - since / 80.0)).sum(axis=1)
    written(tmp_path / "r.csv", insulin, np.asarray(gl.excite(patient, insulin).glucose_mg_dl)[:600] + raised)
    rows = (tmp_path / "r.csv").read_text().splitlines()
    (tmp_path / "r.csv").write_text(
        "\n".join([f"{rows[0]},carbs_g", *(f"{row},{50 if k in begins else ''}" for k, row in enumerate(rows[1:]))])
    )
    options = ("--basal-insulin", float(patient.basal_insulin_mU_min))
    answer = glucoloop("identify", "--data", "r.csv", "--out", "m", "--json", *options)
    assert "Meals: 3 with 150 g in all" in answer.err
    assert answer.json["doubts"] == []
    assert answer.json["fit"]["gain_mg_dl_per_mU_min"] == pytest.approx(-2.7, abs=0.4)
    again = glucoloop("identify", "--data", "m/record.csv", "--json", *options)
    assert again.json["model"]["step_response"] == answer.json["model"]["step_response"]


def test_rates_in_another_unit_are_asked_about(refused, tmp_path, moved):
    insulin, glucose = moved
    written(tmp_path / "r.csv", insulin * 0.06, glucose)
    told = refused("identify", "--data", "r.csv")
    assert "looks like U/h" in told
    assert "or add --allow-unusual" in told


@pytest.mark.long
def test_an_experiment_that_drowns_in_noise_gives_no_model_to_use(glucoloop):
    out = glucoloop("identify", "--sensor", "white-noise, variance=100, bound_mg_dl=50", "--seed", 1).out
    assert "DO NOT USE THIS MODEL" in out
    assert "--samples" in out


@pytest.mark.long
def test_best_pole_dead_time_and_sample_time(glucoloop):
    report = glucoloop(
        "identify", "--best-pole", "--dead-time", 20, "--sample-time", 10, "--samples", 60, "--json"
    ).json
    assert 0.5 < report["fit"]["laguerre_pole"] < 0.9
    assert report["model"]["provenance"]["dead_time_min"] == 20.0
    assert len(report["model"]["step_response"]) == 18


@pytest.mark.long
def test_unsmoothed_model(glucoloop):
    report = glucoloop("identify", "--laguerre-functions", 0, "--noise", 1, "--json").json
    assert report["fit"]["laguerre_coefficients"] == []


@pytest.mark.long
def test_where_to_use_it(glucoloop):
    out = glucoloop("identify", "--sample-time", 10, "--dead-time", 10, "--out", "m").out
    line = next(line for line in out.splitlines() if line.startswith("Use it: glucoloop "))
    assert glucoloop(*line.removeprefix("Use it: glucoloop ").split(), "--duration", 100).code == 0


def test_a_cell_that_cannot_be_meant_is_named_with_its_row_and_what_its_column_takes(refused, tmp_path):
    head = "t_min,insulin_mU_min,glucose_mg_dl,carbs_g\n0,10,100,\n\n,,,\n"
    for row, message in {
        "08:15,10,100,": "The time in row 4 of r.csv, below its first line, is '08:15': it must be a number; give the",
        ",10,100,": "The time in row 4 of r.csv, below its first line, is missing: it must be a finite",
        "5,stop,100,": "insulin in row 4 of r.csv, below its first line, is 'stop': it must be a number; give the rate",
        "5,,100,": "The insulin rate in row 4 of r.csv, below its first line, is missing: it must be a finite number",
        "5,10,LOW,": "'LOW': it must be a number; give the reading in mg/dl, or mark it as missing, with NaN",
        "5,10,100,50g": "'50g': it must be a number; give the grams alone, or leave the cell empty",
    }.items():
        (tmp_path / "r.csv").write_text(f"{head}{row}\n10,10,100,\n")
        with naming(row):
            assert message in refused("identify", "--data", "r.csv")


def test_lines_that_end_as_on_an_old_computer_are_lines(refused, tmp_path):
    (tmp_path / "r.csv").write_bytes(b"t_min,insulin_mU_min,glucose_mg_dl\r0,10,100\r5,10,x\r")
    assert "The glucose in row 2 of r.csv, below its first line, is 'x'" in refused("identify", "--data", "r.csv")


def test_a_table_with_many_columns_is_refused_in_a_sentence(refused, tmp_path):
    (tmp_path / "r.csv").write_text(",".join(f"c{k}" for k in range(1000)) + "\n")
    message = refused("identify", "--data", "r.csv")
    assert "only c0, c1, c2, c3, c4, c5, c6, c7 and 992 more; its first line must name t_min" in message


@pytest.mark.long
def test_a_gain_outside_of_its_interval_is_explained(glucoloop):
    answer = glucoloop("identify", "--patient", "roy-parker-2007", "--json")
    fit = answer.json["fit"]
    assert fit["gain_mg_dl_per_mU_min"] < fit["gain_from_mg_dl_per_mU_min"] < fit["gain_to_mg_dl_per_mU_min"]
    assert "The model's gain lies outside the interval: the model is a sum of 2 Laguerre functions" in answer.err
    assert re.search(
        r"a lasting change of insulin moves glucose \d\.\d % less in the end than by the model", answer.err
    )
    assert "outside the interval" not in glucoloop("identify", "--json").err


def test_an_export_of_a_device_is_told_where_it_belongs(refused, tmp_path):
    (tmp_path / "export.csv").write_text(clarity(20), encoding="utf-8")
    told = refused("identify", "--data", "export.csv")
    assert told.startswith("export.csv is a file of dexcom-clarity, of ordinary days; a model is identified here from")
    assert "glucoloop report" in told
    assert "glucoloop twin" in told
