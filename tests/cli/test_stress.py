"""``glucoloop stress``."""

import json

import polars as pl
import pytest
from matplotlib.figure import Figure

from glucoloop.studies.stress import STANDARD_FAULTS

FAULTS = ("--fault", "calibration, gain=1.3", "--fault", "missing, start_min=60, duration_min=60")
SMALL = ("--people", 3, "--controller", "imc", "--duration", 200, *FAULTS, "--seed", 5)
FILES = {
    "SHA256SUMS",
    "tables.tex",
    "figure.png",
    "figure.svg",
    "figure.pdf",
    "shards",
    "stress.csv",
    "stress.html",
    "stress.parquet",
    "stress.toml",
    "summary.json",
    "trial.json",
}


@pytest.fixture
def _plain(monkeypatch):
    monkeypatch.setattr("glucoloop.studies.stress.study.page", lambda asked, found: "")
    monkeypatch.setattr("glucoloop.studies.stress.study._plot_stress", lambda found: Figure())


def test_folder_holds_every_cell_and_repeats_itself(glucoloop, tmp_path):
    first = glucoloop("stress", *SMALL, "--out", "a")
    assert first.code == 0, first.err
    assert {entry.name for entry in (tmp_path / "a").iterdir()} == FILES
    for part in ("no fault", "calibration", "missing", "With the guard, ", "Wrote stress.csv", "1 shard to a."):
        assert part in first.out
    table = pl.read_parquet(tmp_path / "a/stress.parquet")
    assert table.height == 2 * 3
    assert table["people"].to_list() == [3] * 6
    assert table.filter(fault="")["worst_more_pct"].to_list() == [0.0, 0.0]
    wrong = "calibration, gain=1.3, offset_mg_dl=0"
    lowest = dict(table.filter(guarded=False).select("fault", "lowest_mg_dl").rows())
    assert lowest[wrong] < lowest[""] - 5.0  # who reads too much glucose gives too much insulin
    assert table.filter(guarded=True, fault=wrong)["lowest_mg_dl"].item() > lowest[wrong]
    assert pl.read_csv(tmp_path / "a/stress.csv").height == table.height
    page = (tmp_path / "a/stress.html").read_text()
    assert "calibration" in page
    assert "not a medical device" in page

    again = glucoloop("stress", *SMALL, "--out", "a", "--json")
    assert "nothing is computed again" in again.err
    summary = {key: value for key, value in again.json.items() if key != "files"}
    assert summary == json.loads((tmp_path / "a/summary.json").read_text())
    assert glucoloop("stress", "--config", "a/stress.toml", "--out", "b").code == 0
    assert (tmp_path / "a/SHA256SUMS").read_text() == (tmp_path / "b/SHA256SUMS").read_text()


@pytest.mark.usefixtures("_plain")
def test_all_usual_faults_are_tried_and_the_folder_goes_on(glucoloop, tmp_path):
    asked = ("stress", "--people", 2, "--controller", "imc", "--duration", 300, "--guards", "without", "--out", "a")
    first = glucoloop(*asked)
    assert first.code == 0, first.err
    assert pl.read_parquet(tmp_path / "a/stress.parquet").height == 1 + len(STANDARD_FAULTS)
    assert any("value=nan" in fault for fault in STANDARD_FAULTS)  # what is no number is a setting, too
    assert "nothing is computed again" in glucoloop("stress", "--config", "a/stress.toml", "--out", "a").err


@pytest.mark.usefixtures("_plain")
def test_limits_of_the_guard_are_heeded(glucoloop, tmp_path):
    asked = ("stress", *SMALL, "--guards", "with", "--guard", "lowest_reading_mg_dl=300", "--out", "a")
    assert glucoloop(*asked).code == 0
    table = pl.read_parquet(tmp_path / "a/stress.parquet")
    assert table["guarded"].all()
    assert (table["fallback_pct"] > 50.0).all()  # nothing that is read is accepted


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ((), "--out is missing"),
        (("--out", "a", "--guards", "maybe"), "--guards is 'maybe'"),
        (("--out", "a", "--fault", "stuk"), "unknown fault 'stuk'; did you mean 'stuck'?"),
        (
            ("--out", "a", "--fault", "late, delay_min=0"),
            "delay_min is 0 min; give a finite number above 0 min",
        ),
        (
            ("--out", "a", "--guard", "gap_min=-1"),
            "--guard: gap_min is -1 min; give a number from 0 to 10000 min, or one in h, s or d.",
        ),
        (("--out", "a", "--guard", "none"), "--guard is none; let --guards say whether there is one"),
        (("--out", "a", "--workers", 0), "--workers is 0; give a whole number from 1"),
        (("--out", "a", "--people", 0), "--people is 0"),
    ],
)
def test_mistakes(refused, tmp_path, arguments, sentence):
    assert sentence in refused("stress", *arguments)
    assert not (tmp_path / "a").exists()


@pytest.mark.long
def test_pages_of_subcutaneous_insulin_begin_in_the_unit_of_pumps(glucoloop, tmp_path):
    short = ("--controller", "basal-bolus", "--duration", 60)
    small = (*short, "--people", 2, "--fault", "stuck")
    for patient, unit in (("hovorka-2004", "uh"), ("parker-1999", "mu")):
        assert glucoloop("stress", *small, "--patient", patient, "--out", f"s-{patient}").code == 0
        assert glucoloop("run", *short, "--patient", patient, "--out", f"r-{patient}").code == 0
        for page in (f"s-{patient}/stress.html", f"r-{patient}/figure.html"):
            assert f'id="unit-{unit}" checked' in (tmp_path / page).read_text(encoding="utf-8"), page
