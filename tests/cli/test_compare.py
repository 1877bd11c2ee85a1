"""``glucoloop compare``."""

import polars as pl
import pytest
from glucoloop.config.case_text import parse_case

SHORT = ("--duration", 100)


@pytest.mark.long
def test_cases_stand_side_by_side(glucoloop):
    answer = glucoloop("compare", "--case", "mpc", "--case", "careful: mpc, move_weight=3", *SHORT)
    assert answer.code == 0
    header = next(line for line in answer.out.splitlines() if "Metric" in line)
    assert header.split() == ["Metric", "mpc", "careful", "Unit"]


@pytest.mark.long
def test_case_is_the_run_of_the_same_options(glucoloop):
    shared = ("--noise", 1.45, "--seed", 2, "--output-weight", 2, "--json", *SHORT)
    cases = glucoloop("compare", "--case", "a: move_weight=2", "--case", "b: output_weight=4", *shared).json
    alone = glucoloop("run", "--move-weight", 2, *shared).json
    assert cases["cases"]["a"] == {key: alone[key] for key in cases["cases"]["a"]}
    assert {"config", "model", "metrics", "summary", "validity"} <= set(cases["cases"]["a"])
    assert cases["cases"]["b"]["config"]["output_weight"] == 4.0


@pytest.mark.long
def test_folder_repeats_the_comparison(glucoloop, tmp_path):
    assert glucoloop("identify", "--noise", 1, "--out", "model").code == 0
    arguments = ("--case", "mpc", "--case", "given: model=model/model.json, known_dead_time=true", "--dead-time", 5)
    assert glucoloop("compare", *arguments, *SHORT, "--out", "first").code == 0
    assert glucoloop("compare", "--config", "first/compare.toml", "--out", "second").code == 0
    table = pl.read_parquet(tmp_path / "first/trace.parquet")
    assert table["case"].unique(maintain_order=True).to_list() == ["mpc", "given"]
    assert table.equals(pl.read_parquet(tmp_path / "second/trace.parquet"))
    assert {file.name for file in (tmp_path / "first").iterdir()} == {
        "SHA256SUMS", "compare.toml", "figure.html", "figure.pdf", "figure.png", "figure.svg", "glucose_1min.parquet",
        "metrics.json", "model-1-mpc.json", "model-2-given.json", "trace.csv", "trace.parquet",
    }  # fmt: skip


@pytest.mark.parametrize(
    ("content", "told"),
    [("[[case]]\n[[case]]\n", "has no label"), ("case = 3\n", "[[case]]"), ("[case]\na = 1\n", "[[case]]")],
)
def test_cases_of_a_file_are_checked(refused, tmp_path, content, told):
    (tmp_path / "c.toml").write_text(content)
    assert told in refused("compare", "--config", "c.toml")


@pytest.mark.parametrize(
    ("text", "keys"),
    [
        ("mpc", {"label": "mpc", "controller": "mpc"}),
        ("a: mpc", {"label": "a", "controller": "mpc"}),
        ("a: controller=mpc, move_weight=1", {"label": "a", "controller": "mpc", "move_weight": 1}),
        ("m=1", {"label": "m=1", "m": 1}),
        ("a: w=.5", {"label": "a", "w": 0.5}),
        ("a: w=0.5, on=true", {"label": "a", "w": 0.5, "on": True}),
        ("model=C:/m.json", {"label": "model=C:/m.json", "model": "C:/m.json"}),
    ],
)
def test_case_text(text, keys):
    assert parse_case(text) == keys
