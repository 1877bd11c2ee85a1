"""``glucoloop tune``."""

import polars as pl
import pytest

SHORT = ("--duration", 150)
SMALL = ("--controller", "move_horizon=1:2, prediction_horizon=4|8")


def test_point_is_the_run_of_the_same_options(glucoloop):
    ranges = "mpc, move_horizon=1:2, prediction_horizon=4|8, known_dead_time=true"
    found = glucoloop("tune", "--controller", ranges, *SHORT, "--dead-time", 5, "--json").json
    one = "mpc, move_horizon=1, known_dead_time=true"  # p = 8 by default
    alone = glucoloop("run", "--controller", one, *SHORT, "--dead-time", 5, "--json").json
    surface = found["surface"]
    point = list(zip(surface["move_horizon"], surface["prediction_horizon"], strict=True)).index((1, 8))
    assert surface["sse"][point] == pytest.approx(alone["metrics"]["sse"], abs=1e-6)
    (controller,) = found["config"]["controller"]
    assert (controller["name"], controller["move_horizon"], controller["known_dead_time"]) == ("mpc", "1:2", True)
    assert found["printed"]["prediction_horizon"] == 8


def test_folder_repeats_the_search(glucoloop, tmp_path):
    arguments = ("--controller", f"{SMALL[1]}, move_weight=0|1", "--top", 2, *SHORT)
    first = glucoloop("tune", *arguments, "--out", "first")
    assert first.code == 0
    assert (
        glucoloop("tune", "--config", "first/tune.toml", "--out", "second").out.replace("second", "first") == first.out
    )
    table = pl.read_parquet(tmp_path / "first/surface.parquet")
    assert table.height == 8
    assert {"move_weight", "sse", "feasible", "oscillates", "acceptable"} <= set(table.columns)
    assert table.equals(pl.read_parquet(tmp_path / "second/surface.parquet"))
    assert {file.name for file in (tmp_path / "first").iterdir()} == {
        "SHA256SUMS", "model.json", "surface.csv", "surface.html", "surface.parquet", "surface.pdf", "surface.png",
        "surface.svg",
        "tables.tex",
        "tune.json",
        "tune.toml",
    }  # fmt: skip


def test_table_shows_where_the_printed_tuning_stands(glucoloop):
    out = glucoloop("tune", "--controller", "move_horizon=2:3, prediction_horizon=4:5", "--top", 1).out
    rows = [line.split() for line in out.splitlines() if line.strip() and line.split()[0].isdigit()]
    assert [row[:3] for row in rows] == [["1", "3", "4"], ["5", "2", "8"]]
    assert rows[-1][-1] == "printed"
    assert "The printed tuning (2, 8, 1, 0) ranks 5 of 5" in out
    assert "Of 5 tunings 0 break a constraint and 0 more oscillate; 5 are acceptable." in out


def test_noise_gives_medians_over_seeds(glucoloop):
    shared = ("--noise", 1.45, "--controller", "move_horizon=2, prediction_horizon=10", *SHORT, "--json")
    found = glucoloop("tune", *shared, "--seeds", 1, "--seed", 4).json
    alone = glucoloop("run", "--noise", 1.45, "--seed", 4, *SHORT, "--json").json
    assert found["surface"]["output_weight"] == [3.0]
    assert found["surface"]["sse"] == [pytest.approx(alone["metrics"]["sse"], abs=1e-6)]
    assert glucoloop("tune", *shared, "--seeds", 3).json["config"]["seeds"] == 3


def test_filters_of_a_controller_with_estimation(glucoloop):
    found = glucoloop(
        "tune", "--controller", "mpc-se, move_horizon=2, prediction_horizon=7, reference_filter=.3:.5:.1",
        "--patient", "operating_point=nominal-22", *SHORT, "--json",
    ).json  # fmt: skip
    assert found["surface"]["reference_filter"] == [0.3, 0.4, 0.5, 0.65]
    assert found["printed"]["reference_start"] == 0
    assert found["model"] is None


def test_seeds_are_of_any_noise(glucoloop):
    answer = glucoloop(
        "tune", "--controller", "move_horizon=2, prediction_horizon=7", *SHORT, "--sensor", "correlated-noise",
        "--seeds", 2,
    )  # fmt: skip
    assert "Results are medians of 2 seeds; oscillation was judged in the run of the first." in answer.out


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (("--controller", "move_horizon=x"), "move_horizon is 'x'; write it like 1:4"),
        (("--controller", "move_horizon=4:1"), "lower end first"),
        (("--controller", "move_horizon=9, prediction_horizon=2:4"), "look farther ahead"),
        (("--controller", "move_weight=-1"), "move_weight is -1; give a finite number of 0 or more"),
        (("--controller", "reference_filter=.5"), "no setting 'reference_filter'"),
        (
            ("--controller", "mpc-se, reference_filter=1"),
            "reference_filter is 1; give a number of 0 or more and below 1",
        ),
        (("--controller", "pid"), "'pid' cannot be tuned"),
        (("--controller", "mpv"), "did you mean 'mpc'"),
        (("--seeds", 3), "without noise, another sensor or a fault all are alike"),
        (("--noise", 1, "--seeds", 0), "--seeds is 0"),
        (("--top", 0), "--top is 0"),
        (("--duration", 101), "whole number of samples"),
        (
            ("--controller", "prediction_horizon=1:1000, move_horizon=1:50"),
            "prediction_horizon is 289; give a whole number from 0 to 288",
        ),
    ],
)
def test_refusals(refused, options, told):
    assert told in refused("tune", *options)


def test_ranges_of_a_file_may_be_numbers_or_lists(glucoloop, refused, tmp_path):
    (tmp_path / "t.toml").write_text(
        "duration_min = 100\n[controller]\nmove_horizon = 2\nprediction_horizon = [4, 8]\n"
    )
    assert glucoloop("tune", "--config", "t.toml", "--json").json["surface"]["prediction_horizon"] == [4, 8]
    (tmp_path / "t.toml").write_text("[controller]\nmove_horizon = true\n")
    assert "move_horizon is True" in refused("tune", "--config", "t.toml")


def test_too_many_panels_leave_the_picture_out(glucoloop, tmp_path):
    answer = glucoloop(
        "tune", "--controller", "move_horizon=1|2, prediction_horizon=2|3, move_weight=0:3.5:.5, output_weight=1|2",
        *SHORT, "--out", "o",
    )  # fmt: skip
    assert "No picture was drawn: the surface would need 16 panels" in answer.out
    assert not (tmp_path / "o/surface.png").exists()
    assert "The surface is not shown" in (tmp_path / "o/surface.html").read_text()
