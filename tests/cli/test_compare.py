"""``glucoloop compare``."""

import json

import polars as pl
import pytest
from scipy import stats

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


@pytest.mark.long
def test_a_change_stands_beside_the_therapy_as_it_is(glucoloop, tmp_path):
    person = ("--patient", "hovorka-2004", "--controller", "basal-bolus", "--announce-meals", "--meal", "60g@10min")
    more, low = "basal, +20%", "carbs, 20% too low"
    answer = glucoloop("compare", *person, "--change", more, "--change", low, *SHORT, "--out", "first")
    assert answer.code == 0
    assert answer.out.index("Difference from the therapy as it is") < answer.out.index("Metric")
    results = json.loads((tmp_path / "first/metrics.json").read_text())
    cases, changes = results["cases"], results["changes"]
    assert list(cases) == ["basal-bolus", more, low]
    assert changes[more]["of"] == "basal-bolus"
    for name, difference in changes[low]["difference"].items():
        assert difference == cases[low]["metrics"][name] - cases["basal-bolus"]["metrics"][name]
    assert changes[more]["difference"]["mean_mg_dl"] < 0.0 < changes[low]["difference"]["mean_mg_dl"]
    assert glucoloop("compare", "--config", "first/compare.toml", "--out", "second").code == 0
    assert json.loads((tmp_path / "second/metrics.json").read_text())["cases"] == cases
    alone = glucoloop("run", *person, "--change", low, *SHORT, "--json").json
    assert cases[low]["metrics"] == alone["metrics"]
    assert cases[low]["config"]["changes"] == [low]


@pytest.mark.long
def test_a_change_over_days_has_an_interval_over_them(glucoloop):
    person = ("--patient", "hovorka-2004", "--controller", "basal-bolus", "--announce-meals", "--meal", "60g@8h")
    change, days = "basal, +20%", ("--days", 4, "--meal-size-spread", 40)
    answer = glucoloop("compare", *person, *days, "--change", change, "--json", "--out", "four")
    assert answer.code == 0, answer.err
    of_day = pl.read_parquet("four/glucose_1min.parquet").filter(pl.col("t_min") > 0.0)
    of_day = of_day.group_by("case", day=((pl.col("t_min") - 1.0) / 1440.0).floor(), maintain_order=True).agg(
        mean_mg_dl=pl.col("glucose_mg_dl").mean(),
        time_70_180_pct=100.0 * pl.col("glucose_mg_dl").is_between(70.0, 180.0).mean(),
    )
    as_it_is, changed = (of_day.filter(pl.col("case") == case) for case in ("basal-bolus", change))
    interval = answer.json["changes"][change]["interval"]
    for name in ("mean_mg_dl", "time_70_180_pct"):
        differences = (changed[name] - as_it_is[name]).to_numpy()
        assert differences.size == 4
        expected = stats.t.interval(0.95, 3, differences.mean(), stats.sem(differences))
        assert interval[name] == pytest.approx(expected)
    told = glucoloop("compare", *person, *days, "--change", change).out
    low, high = interval["time_70_180_pct"]
    assert f"{change} instead of the therapy as it is: time from 70 to 180 mg/dl" in told
    assert f"({low:+.1f} to {high:+.1f})" in told
    assert "interval" not in str(glucoloop("compare", *person, "--days", 2, "--change", change).out)


@pytest.mark.long
def test_a_change_without_effect_is_told(glucoloop):
    both = ("--patient", "hovorka-2004", "--controller", "pid", "--controller", "basal-bolus", "--start", "06:00")
    answer = glucoloop("compare", *both, "--change", "basal, +20%, 20h-22h", *SHORT)
    assert "no effect on pid, which has no case with it: the controller pid does not use the profile" in answer.err
    assert "its hours lie outside of the run" in answer.err
    assert "basal-bolus: basal, +20%, 20h-22h: this change has no effect in this run." in answer.out
