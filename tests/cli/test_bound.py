"""``glucoloop bound``, and ``compare --bound``."""

import math

import polars as pl
import pytest

SHORT = ("--duration", 200)
EARLY = ("--meal", "50g@20", *SHORT)


def test_bounds_stand_in_a_table(glucoloop):
    answer = glucoloop("bound", *EARLY, "--known-after", 10)
    assert answer.code == 0
    row = next(line for line in answer.out.splitlines() if "known 10 min after" in line)
    assert row.split()[-5:] == ["0.61", "0.61", "81.71", "0", "10"]
    assert "Nothing was written" in answer.out


def test_folder_repeats_the_bound(glucoloop, tmp_path):
    arguments = ("--known-after", 0, "--dead-time", 10)
    assert glucoloop("bound", *arguments, *EARLY, "--out", "first").code == 0
    again = glucoloop("bound", "--config", "first/bound.toml", "--out", "second", "--json").json
    assert {file.name for file in (tmp_path / "first").iterdir()} == {
        "SHA256SUMS", "bound.json", "bound.toml", "doses.csv", "figure.pdf", "figure.png", "figure.svg",
        "glucose_1min.csv", "tables.tex",
    }  # fmt: skip
    digests = [(tmp_path / name / "SHA256SUMS").read_text() for name in ("first", "second")]
    assert digests[0] == digests[1]
    # a dead time comes on top of what is known
    assert [of["known_after_min"] for of in again["bounds"]] == [10.0]
    assert again["bounds"][0]["bound"] == pytest.approx(0.609, abs=0.01)
    table = pl.read_csv(tmp_path / "first/doses.csv")
    assert table.columns == ["information", "world", "t_min", "insulin_mU_min"]
    assert table["insulin_mU_min"].max() <= 66.9 + 1e-9
    assert table.height == 40


def test_noise_adds_what_it_lets_one_know(glucoloop, monkeypatch, tmp_path):
    from glucoloop.bounds import HedgedDoses, optimal_doses
    from glucoloop.studies.bound import study

    def hedged(person, scenario, noise_variance, limits, **more):
        assert (scenario.meals[0].carbs_g, noise_variance) == (50.0, 1.45)
        assert more == {"dead_time_min": 10.0, "sample_time_min": 5.0}
        plans = [optimal_doses(person, scenario, limits, known_after_min=known) for known in (10.0, 20.0)]
        for question, distinguished_after_min in (("begins", 30.0), ("ends", float("inf"))):
            yield HedgedDoses(question, 0.05, distinguished_after_min, 7.5, *plans)

    monkeypatch.setattr(study, "hedged_doses", hedged)
    arguments = ("--noise", 1.45, "--known-after", 0, "--dead-time", 10, *EARLY)
    answer = glucoloop("bound", *arguments, "--out", "noisy", "--json").json
    begins, ends = answer["hedged"]
    assert begins["information"] == "told from noise that it begins, error 5%"
    assert (begins["distinguished_after_min"], ends["distinguished_after_min"]) == (30.0, None)
    assert begins["deviation_mg_dl"] == 7.5
    assert begins["other_peak_mg_dl"] > begins["peak_mg_dl"]
    table = pl.read_csv(tmp_path / "noisy/glucose_1min.csv")
    worlds = table.group_by("information", "world", maintain_order=True).agg(pl.col("glucose_mg_dl").max())
    assert worlds.rows()[1] == (begins["information"], "meal", pytest.approx(begins["peak_mg_dl"]))
    assert [world for _, world, _ in worlds.rows()] == ["meal", "meal", "no meal", "meal", "larger meal"]


def test_noise_on_several_meals_is_told_to_be_left_out(glucoloop):
    meals = ("--meal", "50g@50", "--meal", "5g@1h", "--known-after", 100)
    answer = glucoloop("bound", "--noise", 1.45, *meals, *SHORT)
    assert "The bound under sensor noise is left out here" in answer.out


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (
            ["--known-after", "soon"],
            "--known-after is 'soon'; give a number from -527040 to 527040 min, or one in h, s or d.",
        ),
        (["--known-after", "nan"], "--known-after is nan min; give a number from"),
        (["--objective", "glory"], "--objective is 'glory'; give deviation, undershoot, peak or sse."),
        (["--duration", "6000"], "a plan of 1200 doses is too long"),
        (["--config", "nothing.toml"], "nothing is asked for; give --known-after or --in-advance, or one meal and"),
        (["--config", "c.toml"], "controller is no part of a bound; leave it out"),
    ],
)
def test_what_cannot_be_is_refused(refused, tmp_path, arguments, told):
    (tmp_path / "c.toml").write_text("controller = 'mpc'\n")
    (tmp_path / "nothing.toml").write_text("known_after_min = []\n")
    assert told in refused("bound", *arguments)


@pytest.mark.long
def test_comparison_tells_the_distance_to_the_bound(glucoloop, tmp_path):
    arguments = ("compare", "--bound", "--controller", "basal", "--controller", "basal, label=idle", *EARLY)
    cases = glucoloop(*arguments, "--out", "c", "--json").json
    bound = cases["bound"]
    assert bound["deviation_mg_dl"] == pytest.approx(0.153, abs=0.01)
    for label, metrics in ((label, of["metrics"]) for label, of in cases["cases"].items()):
        deviation = max(metrics["peak_mg_dl"] - 81.1, metrics["undershoot_mg_dl"])
        distance = bound["distances"][label]
        assert distance["deviation_mg_dl"] == pytest.approx(deviation)
        assert math.isclose(distance["distance_mg_dl"], deviation - bound["deviation_mg_dl"])
    told = glucoloop("compare", "--config", "c/compare.toml").out
    row = next(line for line in told.splitlines() if "Distance to the bound" in line).split()
    assert row[4:6] == [f"{bound['distances'][label]['distance_mg_dl']:.2f}" for label in ("basal", "idle")]


@pytest.mark.long
def test_a_controller_that_gives_boluses_has_no_distance_to_a_bound_of_rates(glucoloop):
    cases = ("--controller", "basal-bolus", "--controller", "basal", "--announce-meals")
    arguments = ("compare", "--bound", "--patient", "hovorka-2004", "--meal", "80g@60min", "--duration", 300)
    answer = glucoloop(*arguments, *cases, "--json")
    bound = answer.json["bound"]
    # a bolus at the meal does better than any rates within the pump's limits
    assert answer.json["cases"]["basal-bolus"]["metrics"]["overshoot_mg_dl"] < bound["deviation_mg_dl"] - 20.0
    assert list(bound["distances"]) == ["basal"]
    assert "basal-bolus gave boluses" in answer.err
    row = next(line for line in glucoloop(*arguments, *cases).out.splitlines() if "Distance to the bound" in line)
    assert row.split()[4:6] == ["n/a", f"{bound['distances']['basal']['distance_mg_dl']:.2f}"]


@pytest.mark.long
def test_a_bound_of_rates_says_that_boluses_may_do_better(glucoloop):
    told = "without boluses"
    asked = ("bound", "--duration", 120, "--meal", "20g@30min", "--known-after", 10)
    assert told in glucoloop(*asked, "--patient", "hovorka-2004").out
    assert told not in glucoloop(*asked).out
