"""``glucoloop run``."""

import json
import tomllib
from typing import Any

import jax.numpy as jnp
import numpy as np
import polars as pl
import pytest

import glucoloop as gl
from glucoloop.models.step_response import StepResponseModel

SHORT = ("--duration", 100)
FILES = {
    "SHA256SUMS",
    "tables.tex",
    "figure.html",
    "figure.png",
    "figure.svg",
    "figure.pdf",
    "glucose_1min.parquet",
    "metrics.json",
    "model.json",
    "run.toml",
    "trace.csv",
    "trace.parquet",
}
METRICS = {
    "undershoot_mg_dl",
    "peak_mg_dl",
    "minimum_mg_dl",
    "settling_2pct_min",
    "settling_5pct_min",
    "sse",
    "time_below_60_pct",
    "insulin_total_mU",
}


def test_default_run_is_the_papers_noise_free_loop(glucoloop):
    answer = glucoloop("run", "--json")
    report = answer.json
    assert answer.code == 0
    assert report["version"] == gl.__version__
    assert METRICS <= report["metrics"].keys()
    assert report["metrics"]["undershoot_mg_dl"] == pytest.approx(10.2, abs=0.1)
    assert report["metrics"]["settling_2pct_min"] == pytest.approx(345, abs=2)
    tuning = ("move_horizon", "prediction_horizon", "output_weight", "move_weight")
    assert [report["config"]["controller"][key] for key in tuning] == [2, 8, 1.0, 0.0]
    assert report["files"] == {}
    assert "identified from a record of 72 samples free of noise" in answer.err


@pytest.mark.long
def test_run_says_what_the_library_says(glucoloop):
    """The command and the five lines of Python are one thing."""
    patient = gl.patient()
    trace = gl.simulate(patient, gl.design_linear_mpc(gl.identify(patient).model))
    assert glucoloop("run", "--json").json["metrics"] == gl.summarise(trace).as_dict()


@pytest.mark.long
def test_seed_is_that_of_the_library(glucoloop, tmp_path):
    """The readings of seed 3 are those of ``simulate(key=3)``; the model's record has noise of its own."""
    assert glucoloop("run", "--noise", 1.45, "--seed", 3, "--model", "noise_variance=0", "--out", "run").code == 0
    patient = gl.patient()
    tuning = gl.MPCTuning(2, 10, 3.0, 1.0)
    controller = gl.design_linear_mpc(gl.identify(patient).model, tuning)
    trace = gl.simulate(patient, controller, gl.white_noise(1.45), key=3)
    np.testing.assert_array_equal(
        pl.read_parquet(tmp_path / "run" / "trace.parquet")["reading_mg_dl"], trace.reading_mg_dl
    )


@pytest.mark.long
def test_noise_changes_tuning_and_record_unless_told(glucoloop):
    config = glucoloop("run", "--noise", 1.45, "--json", *SHORT).json["config"]["controller"]
    tuning = ("move_horizon", "prediction_horizon", "output_weight", "move_weight")
    assert [config[key] for key in tuning] == [2, 10, 3.0, 1.0]
    assert config["model"]["noise_variance"] == 1.45
    mine = ("--controller", "prediction_horizon=12", "--model", "noise_variance=0")
    own = glucoloop("run", "--noise", 1.45, *mine, "--json", *SHORT).json
    assert [own["config"]["controller"][key] for key in tuning] == [2, 12, 3.0, 1.0]
    assert own["config"]["controller"]["model"]["noise_variance"] == 0.0
    assert own["model"]["step_response"] == glucoloop("run", "--json", *SHORT).json["model"]["step_response"]


@pytest.mark.long
def test_folder_repeats_the_run_to_the_last_bit(glucoloop, tmp_path):
    first = glucoloop(
        "run", "--noise", 1.45, "--seed", 5, "--dead-time", 10, "--controller", "known_dead_time=true",
        "--meal", "40@1h", "--meal", "20g@300min", "--pump", "resolution_mU_min=0.5", "--setpoint", 85,
        "--out", "first",
    )  # fmt: skip
    assert first.code == 0
    assert {file.name for file in (tmp_path / "first").iterdir()} == FILES
    assert glucoloop("run", "--config", "first/run.toml", "--out", "deep/second").code == 0
    for name in FILES:
        assert (tmp_path / "first" / name).read_bytes() == (tmp_path / "deep" / "second" / name).read_bytes(), name
    assert json.loads((tmp_path / "first/metrics.json").read_text())["config"]["seed"] == 5
    assert tomllib.loads((tmp_path / "first/run.toml").read_text())["meals"] == ["40@1h", "20g@300min"]


def test_tables_hold_the_run(glucoloop, tmp_path):
    report = glucoloop("run", "--json", "--out", "run").json
    assert set(report["files"]) == FILES - {"SHA256SUMS"}
    table = pl.read_parquet(tmp_path / "run/trace.parquet")
    assert table.columns == [
        "t_min", "glucose_mg_dl", "reading_mg_dl", "insulin_mU_min", "command_mU_min", "reported_mU_min", "status",
        "carbs_g", "carbs_on_board_g",
    ]  # fmt: skip
    assert table["t_min"].to_list() == [5.0 * k for k in range(120)]
    assert table.filter(pl.col("carbs_g") > 0).select("t_min", "carbs_g").rows() == [(50.0, 50.0)]
    assert set(table["status"]) == {"ok"}
    assert pl.read_csv(tmp_path / "run/trace.csv").equals(table)
    minutes = pl.read_parquet(tmp_path / "run/glucose_1min.parquet")
    assert minutes["t_min"].to_list() == list(range(601))
    assert minutes["glucose_mg_dl"].min() == report["metrics"]["minimum_mg_dl"]
    page = (tmp_path / "run/figure.html").read_text()
    assert "</html>" in page
    assert 'src="http' not in page


def test_forecasts_are_kept_and_drawn_where_they_are_asked_for(glucoloop, tmp_path):
    """The first of the planned rates is the dose, and the forecast of now is the reading."""
    glucoloop("run", *SHORT, "--forecasts", "--out", "why")
    table, trace = (pl.read_csv(tmp_path / f"why/{name}.csv") for name in ("forecasts", "trace"))
    assert table.columns == ["t_min", "ahead_min", "glucose_mg_dl", "insulin_mU_min"]
    assert table.height == 20 * 9
    now = table.filter(pl.col("ahead_min") == 0.0)
    assert now["t_min"].to_list() == trace["t_min"].to_list()
    np.testing.assert_allclose(now["glucose_mg_dl"], trace["reading_mg_dl"], rtol=1e-12)
    np.testing.assert_allclose(now["insulin_mU_min"], trace["command_mU_min"], rtol=1e-9)
    assert pl.read_parquet(tmp_path / "why/forecasts.parquet").equals(table)
    page = (tmp_path / "why/figure.html").read_text()
    assert page.count('"kind": "ahead"') + page.count('"kind":"ahead"') == 20
    assert "glucose as the controller expected it, every 5 min" in page
    assert "forecasts.csv" in page
    glucoloop("run", *SHORT, "--out", "plain")
    assert pl.read_csv(tmp_path / "plain/trace.csv").equals(trace)
    assert not (tmp_path / "plain/forecasts.csv").exists()


@pytest.mark.long
def test_a_comparison_keeps_the_forecasts_of_the_cases_that_make_any(glucoloop, tmp_path):
    short = (*SHORT, "--forecasts")
    both = glucoloop("compare", "--controller", "mpc", "--controller", "pid", *short, "--out", "both")
    assert "No forecast is made by: pid." in both.out
    table = pl.read_csv(tmp_path / "both/forecasts.csv")
    assert table["case"].unique().to_list() == ["mpc"]
    glucoloop("run", "--controller", "mpc", *short, "--out", "alone")
    assert table.drop("case").equals(pl.read_csv(tmp_path / "alone/forecasts.csv"))
    page = (tmp_path / "both/figure.html").read_text()
    assert page.count('"kind": "ahead"') + page.count('"kind":"ahead"') == 20
    answer = glucoloop("compare", "--controller", "pid", "--controller", "imc", *short)
    assert "--forecasts has no effect: the controllers pid and imc do not use forecasts of glucose" in answer.err


@pytest.mark.long
def test_known_dead_time_reaches_the_controller(glucoloop):
    unknown = glucoloop("run", "--dead-time", 10, "--json")
    known = glucoloop("run", "--dead-time", 10, "--controller", "known_dead_time=true", "--json")
    assert "known_dead_time=true among its settings tells it" in unknown.err
    assert "knows of the dead time" in known.err
    assert known.json["metrics"]["sse"] != unknown.json["metrics"]["sse"]


@pytest.mark.long
def test_model_that_holds_the_dead_time_is_not_delayed_again(glucoloop):
    """Its controller looks as much farther ahead as for a model that is delayed."""
    model = glucoloop("identify", "--dead-time", 10, "--out", "late", "--json").json["model"]
    held = ("run", "--model", "late/model.json", "--dead-time", 10, "--controller", "known_dead_time=true", "--json")
    late = StepResponseModel(step_response=jnp.asarray(model["step_response"]), sample_time_min=5.0)
    controller = gl.design_linear_mpc(late, gl.MPCTuning(2, 10, 1.0, 0.0))
    trace = gl.simulate(gl.patient(), controller, gl.dead_time(2))
    assert glucoloop(*held).json["metrics"] == gl.summarise(trace).as_dict()


@pytest.mark.long
def test_model_file_gives_the_run_that_identified_it(glucoloop):
    first = glucoloop("run", "--out", "first", "--json").json
    again = glucoloop("run", "--model", "first/model.json", "--out", "again", "--json").json
    assert again["metrics"] == first["metrics"]
    # The copy of the model goes along, so the folder repeats the run wherever it is.
    assert glucoloop("run", "--config", "again/run.toml", "--json").json["metrics"] == first["metrics"]


def test_command_line_overrides_the_file(glucoloop, tmp_path):
    (tmp_path / "a.toml").write_text(
        'duration_min = 200\nmodel = "absent.json"\n[controller]\nprediction_horizon = 12\nmove_weight = 1\n'
    )
    given = ("--duration", 100, "--model", "identified, laguerre_pole=0.8", "--controller", "move_weight=2")
    config = glucoloop("run", "--config", "a.toml", *given, "--json").json["config"]
    assert config["duration_min"] == 100.0
    assert [config["controller"][key] for key in ("prediction_horizon", "move_weight")] == [12, 2.0]
    assert config["controller"]["model"]["laguerre_pole"] == 0.8


@pytest.mark.long
def test_fasting_and_a_start_off_the_setpoint(glucoloop):
    report = glucoloop(
        "run", "--meal", "none", "--initial-glucose", 120, "--controller", "constraints=qp", "--json"
    ).json
    assert report["metrics"]["peak_mg_dl"] == pytest.approx(120.0)
    assert report["config"]["meals"] == []


@pytest.mark.long
def test_sample_time_reaches_everything(glucoloop):
    report = glucoloop("run", "--sample-time", 10, "--json").json
    assert report["model"]["sample_time_min"] == 10.0
    model = report["config"]["controller"]["model"]
    assert model["memory"] == 18
    assert model["laguerre_pole"] == pytest.approx(0.84**2)


@pytest.mark.long
def test_integrators_agree(glucoloop):
    fast, adaptive = (
        glucoloop("run", "--integrator", name, "--json", *SHORT).json["metrics"] for name in ("fast", "adaptive")
    )
    assert fast["peak_mg_dl"] == pytest.approx(adaptive["peak_mg_dl"], abs=1e-3)


def test_a_run_is_told_in_the_units_that_are_asked_for(glucoloop, tmp_path):
    plain = glucoloop("run", *SHORT, "--out", "plain")
    answer = glucoloop("run", *SHORT, "--out", "other", "--units", "mmol/l, U/h")
    assert (answer.code, answer.err) == (0, "")
    assert "Minimum glucose" in answer.out
    for unit in ("mg/dl", "mU/min"):
        assert unit in plain.out
        assert unit not in answer.out.replace("(mg/dl)²", "").replace("gain -2.621 mg/dl per mU/min", "")
    for name in ("trace.csv", "metrics.json", "run.toml", "glucose_1min.parquet"):
        assert (tmp_path / "plain" / name).read_bytes() == (tmp_path / "other" / name).read_bytes()
    assert glucoloop("run", *SHORT, "--units", "mg/dl,mmol/l").err.startswith("glucoloop: 'mg/dl,mmol/l' names two")
    assert "cannot be shown in 'U'; give one or two of mg/dl, mmol/l" in glucoloop("run", "--units", "U").err


@pytest.mark.long
def test_what_was_given_in_another_unit_is_kept_as_it_was_given(glucoloop, tmp_path):
    assert glucoloop("run", "--setpoint", "5.5 mmol/l", "--duration", "2h", "--out", "a").code == 0
    written = (tmp_path / "a/run.toml").read_text()
    assert 'setpoint_mg_dl = "5.5 mmol/l"' in written
    assert 'duration_min = "2h"' in written
    assert "duration_min = 120.0" in written.partition("[used]")[2]
    (tmp_path / "b.toml").write_text(written.replace("setpoint_mg_dl =", "setpoint =", 1))
    again = glucoloop("run", "--config", "b.toml", "--duration", 120, "--json").json
    assert again["metrics"] == glucoloop("run", "--config", "a/run.toml", "--json").json["metrics"]


def test_glucose_below_the_validity_of_the_model_is_told(glucoloop):
    answer = glucoloop("run", "--controller", "pid", "--meal", "150g@50min", "--dead-time", 30, "--json")
    assert answer.code == 0
    [[first, last]] = answer.json["validity"]["periods_below_min"]
    limit = answer.json["validity"]["lowest_valid_mg_dl"]
    assert limit == pytest.approx(44.53, abs=0.01)
    assert answer.json["metrics"]["minimum_mg_dl"] < limit
    assert answer.json["metrics"]["time_below_validity_pct"] == pytest.approx(100.0 * (last - first + 1) / 601)
    told = f"Glucose was below 44.5 mg/dl from {first:g} to {last:g} min: the patient's model is not valid there."
    assert told in answer.err


def test_samples_without_a_finite_dose_are_told():
    from types import SimpleNamespace

    from glucoloop.studies.closed_loop import _notes_on_trace

    grid = np.arange(11.0)
    trace: Any = SimpleNamespace(
        t_min=grid[:-1:5], fine_t_min=grid, fine_glucose_mg_dl=80.0 + grid, lowest_valid_mg_dl=44.5
    )
    metrics: Any = SimpleNamespace(samples_non_finite=1)
    [note] = _notes_on_trace(trace, metrics)
    assert note.startswith("At 1 of 2 samples the controller computed no finite dose; the last one was kept, or")
    metrics.samples_non_finite = 0
    assert list(_notes_on_trace(trace, metrics)) == []


@pytest.mark.long
def test_a_run_says_how_its_therapy_is_changed_and_repeats_it(glucoloop, tmp_path):
    person = ("--patient", "hovorka-2004", "--controller", "basal-bolus", "--start", "06:00", "--duration", 60)
    changes = ("--change", "basal, +20%, 6h-6:30", "--change", "target, 120")
    answer = glucoloop("run", *person, *changes, "--out", "first")
    assert "The therapy is changed: basal, +20%, 6h-6:30; target, 120." in answer.out
    assert glucoloop("run", "--config", "first/run.toml", "--out", "second").code == 0
    first, second = (pl.read_parquet(tmp_path / name / "trace.parquet") for name in ("first", "second"))
    assert first.equals(second)
    assert first["insulin_mU_min"][0] == pytest.approx(1.2 * first["insulin_mU_min"][-1])


def test_a_wrong_change_is_refused(refused):
    assert "--change: 'basl' in 'basl, +10%' is no number" in refused("run", "--change", "basl, +10%")
    assert "the controller mpc does not use the profile of a person" in refused("run", "--change", "basal, +10%")


@pytest.mark.long
def test_a_therapy_by_the_clock_is_written_as_a_profile_from_which_the_same_run_comes(glucoloop, tmp_path):
    """In the folder as Nightscout has profiles; an override is a treatment there, and stands in run.toml alone."""
    (tmp_path / "own.toml").write_text(
        'basal_U_h = { "00:00" = 0.35, "06:30" = 0.5, "12:00" = 0.4 }\n'
        'carb_ratio_g_U = { "00:00" = 22, "08:00" = 18.5 }\n'
        "correction_mg_dl_U = 77\n"
    )
    day = ("--patient", "hovorka-2004", "--controller", "basal-bolus", "--announce-meals", "--start", "06:00")
    day = (*day, "--duration", 480, "--meal", "50g@3h")
    own = ("--profile", "own.toml", "--target-at", "130@9h-11h")
    glucoloop("run", *day, *own, "--out", "first")
    glucoloop("run", *day, "--profile", "first/profile.json", "--out", "again")
    first, again = (pl.read_csv(tmp_path / name / "trace.csv") for name in ("first", "again"))
    for column in ("command_mU_min", "command_bolus_mU", "glucose_mg_dl"):
        np.testing.assert_allclose(first[column], again[column], rtol=1e-8, err_msg=column)
    [document] = json.loads((tmp_path / "first/profile.json").read_text())
    schedule = document["store"]["Default"]
    basal = {step["time"]: step["value"] for step in schedule["basal"]}
    assert {time: basal[time] for time in ("00:00", "06:30", "12:00")} == {"00:00": 0.35, "06:30": 0.5, "12:00": 0.4}
    assert {step["value"] for step in schedule["target_low"]} == {120.0, 130.0}
    again_document = json.loads((tmp_path / "again/profile.json").read_text())
    assert again_document == [document]

    glucoloop("run", *day, *own, "--override", "exercise, from=10h, to=12h, insulin=70%", "--out", "sport")
    assert (tmp_path / "sport/profile.json").read_bytes() == (tmp_path / "first/profile.json").read_bytes()
    assert "exercise" in (tmp_path / "sport/run.toml").read_text()
    glucoloop("compare", *day, *own, "--change", "basal, +10%", "--out", "changed")
    assert (tmp_path / "changed/profile.json").read_bytes() == (tmp_path / "first/profile.json").read_bytes()
    glucoloop("run", *day, "--out", "constant")
    assert not (tmp_path / "constant/profile.json").exists()
