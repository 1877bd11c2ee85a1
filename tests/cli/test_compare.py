"""``glucoloop compare``."""

import polars as pl
import pytest

SHORT = ("--duration", 100)


@pytest.mark.long
def test_cases_stand_side_by_side(glucoloop):
    answer = glucoloop("compare", "--controller", "mpc", "--controller", "mpc, move_weight=3, label=careful", *SHORT)
    assert answer.code == 0
    header = next(line for line in answer.out.splitlines() if "Metric" in line)
    assert header.split() == ["Metric", "mpc", "careful", "Unit"]


@pytest.mark.long
def test_case_is_the_run_of_the_same_options(glucoloop):
    shared = ("--noise", 1.45, "--seed", 2, "--json", *SHORT)
    first = "mpc, move_weight=2, label=a"
    cases = glucoloop("compare", "--controller", first, "--controller", "mpc, output_weight=4", *shared).json
    alone = glucoloop("run", "--controller", first, *shared).json
    assert cases["cases"]["a"] == {key: alone[key] for key in cases["cases"]["a"]}
    assert {"config", "model", "metrics", "summary", "validity"} <= set(cases["cases"]["a"])
    assert cases["cases"]["mpc, output_weight=4"]["config"]["controller"]["output_weight"] == 4.0


@pytest.mark.long
def test_folder_repeats_the_comparison(glucoloop, tmp_path):
    assert glucoloop("identify", "--noise", 1, "--out", "model").code == 0
    given = "mpc, label=given, model=(file, path=model/model.json), known_dead_time=true"
    arguments = ("--controller", "mpc", "--controller", given, "--dead-time", 5)
    assert glucoloop("compare", *arguments, *SHORT, "--out", "first").code == 0
    assert glucoloop("compare", "--config", "first/compare.toml", "--out", "second").code == 0
    table = pl.read_parquet(tmp_path / "first/trace.parquet")
    assert table["case"].unique(maintain_order=True).to_list() == ["mpc", "given"]
    assert table.equals(pl.read_parquet(tmp_path / "second/trace.parquet"))
    assert {file.name for file in (tmp_path / "first").iterdir()} == {
        "SHA256SUMS", "compare.toml", "figure.html", "figure.pdf", "figure.png", "figure.svg", "glucose_1min.parquet",
        "metrics.json", "model-1-mpc.json", "model-2-given.json", "tables.tex", "trace.csv", "trace.parquet",
    }  # fmt: skip


@pytest.mark.parametrize(
    ("content", "told"),
    [
        ("[[controller]]\n[[controller]]\n", "two cases are called 'mpc'; give each a label of its own"),
        ("controller = 3\n", "3 is no controller; give a text like 'mpc-se, move_horizon=2', or a table"),
        ("[[controller]]\na = 1\n", "the controller mpc has no setting 'a'"),
        ("[[case]]\nlabel = 'a'\n", "a comparison has no setting 'case'"),
    ],
)
def test_controllers_of_a_file_are_checked(refused, tmp_path, content, told):
    (tmp_path / "c.toml").write_text(content)
    assert told in refused("compare", "--config", "c.toml")
