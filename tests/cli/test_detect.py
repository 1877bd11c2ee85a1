"""``glucoloop detect``."""

import dataclasses
import json

import numpy as np
import polars as pl
import pytest

from glucoloop.estimation.unknown_meal.replay import MealEstimates
from glucoloop.meals import draw_meals
from glucoloop.situations.situation import configured
from glucoloop.studies.detection import Detection, study
from glucoloop.studies.detection.evaluate import Scores, _Days, _score
from glucoloop.studies.detection.study import _plot_detection, _results

SMALL = ("--controller", "basal", "--days", 1, "--estimator", "kalman", "--seed", 5)
TABLES = ("meals", "curve", "size_error", "day")
FILES = {
    "SHA256SUMS",
    "tables.tex",
    "detect.json",
    "detect.toml",
    "figure.png",
    "figure.svg",
    "figure.pdf",
    *(f"{table}.{kind}" for table in TABLES for kind in ("csv", "parquet")),
}


def done(detection):
    """As if every estimator said half an hour late what is true, but for one false alarm on the fasting day."""
    t_min = 5.0 * np.arange(288)
    meals = draw_meals(detection.all_days, detection.seed, [0])
    begin, carbs_g = meals.t_min, meals.carbs_g
    since = t_min[:, None, None] - begin - 30.0
    eating = ((since > 0.0) & (since < carbs_g / 0.36)).any(axis=1).astype(float)
    first, second = np.moveaxis(np.minimum(carbs_g, 0.36 * np.maximum(since, 0.0)), 1, 0)
    told = np.where(second > 0.0, second, first)
    days = _Days(
        person=np.array([0]),
        day=np.array([0]),
        meals=meals,
        basal_insulin_mU_min=np.full(1, 25.0),
        reading_mg_dl=np.full((288, 1), 81.0),
        insulin_mU_min=np.full((288, 1), 25.0),
        glucose_mg_dl=np.full((288, 1), 81.0),
    )
    estimates = dict.fromkeys((field.name for field in dataclasses.fields(MealEstimates)), eating)
    estimates |= {"carbs_g": told, "remaining_g": 10.0 * eating, "emptying_mg_min": 360.0 * eating}
    alarm = np.where(t_min[:, None] == 100.0, 0.8, 0.0)
    fed = dataclasses.replace(days, estimates=MealEstimates(**estimates))
    fasted = dataclasses.replace(days, estimates=MealEstimates(**{**estimates, "eating": alarm}))
    return Scores({name: _score(detection, fed, fasted) for name in detection.tried}, 1, 0)


@pytest.fixture
def asked(monkeypatch):
    """What was asked for, in place of computing it."""
    asked = []
    monkeypatch.setattr(study, "evaluate", lambda detection, progress: asked.append(detection) or done(detection))
    return asked


@pytest.mark.long
def test_folder_holds_every_meal_and_repeats_itself(glucoloop, tmp_path, asked):
    first = glucoloop("detect", *SMALL, "--out", "a")
    assert first.code == 0, first.err
    assert {entry.name for entry in (tmp_path / "a").iterdir()} == FILES
    for part in ("kalman", "Delay of detection", "False alarms on fasting days", "Of 1 day with meals", "Wrote curve"):
        assert part in first.out
    tables = {name: pl.read_parquet(tmp_path / f"a/{name}.parquet") for name in TABLES}
    assert tables["meals"].height == 2
    assert tables["day"].height == 288
    for name, table in tables.items():
        assert pl.read_csv(tmp_path / f"a/{name}.csv").height == table.height
        assert set(table["estimator"]) == {"kalman"}
    assert tables["meals"]["delay_min"].is_between(30.0, 35.0).all()
    assert tables["curve"].filter(threshold=0.5)["false_alarms_fasting_per_day"].item() == 1.0
    assert tables["curve"].filter(threshold=0.9)["false_alarms_fasting_per_day"].item() == 0.0

    again = glucoloop("detect", "--config", "a/detect.toml", "--out", "b", "--json")
    assert again.code == 0, again.err
    assert asked[0].tree() == asked[1].tree()
    assert (asked[0].case.controller.name, asked[0].days, asked[0].seed) == ("basal", 1, 5)
    told = {key: value for key, value in again.json.items() if key != "files"}
    assert told == json.loads((tmp_path / "a/detect.json").read_text())
    assert told["engines"]["kalman"]["engine"] == "xla"
    assert "Engine: JAX (xla): the replay of estimators, which runs in JAX alone." in first.out
    assert told["estimators"]["kalman"]["size_error_after_end_mean_absolute_g"] == pytest.approx(0.0, abs=1e-9)
    assert (tmp_path / "a/SHA256SUMS").read_text() == (tmp_path / "b/SHA256SUMS").read_text()


def test_what_is_given_wins_over_the_file(glucoloop, tmp_path, asked):
    (tmp_path / "mine.toml").write_text(
        'days = 7\nestimators = ["kalman"]\ncontroller = "meal-mpc, meals_per_h=0.1, mean_carbs_g=30"\n'
    )
    more = ("--controller", "meals_per_h=0.2", "--people", 3, "--days", 1, "--estimator", "moving-horizon")
    assert glucoloop("detect", "--config", "mine.toml", *more).code == 0
    (detection,) = asked
    assert (detection.days, detection.people, list(detection.tried)) == (1, 3, ["moving-horizon"])
    assert (detection.estimating.meals_per_h, detection.estimating.mean_carbs_g) == (0.2, 30.0)


def test_nothing_of_the_figure_is_clipped():
    asked = configured(Detection, days=1)
    figure = _plot_detection(_results(asked, done(asked)), title="A title that is long " * 4)
    figure.draw_without_rendering()
    drawn = figure.get_tightbbox()
    assert min(drawn.x0, drawn.y0) >= 0.0
    assert drawn.x1 <= figure.get_figwidth()
    assert drawn.y1 <= figure.get_figheight()
    assert {text.get_text() for text in figure.legends[0].get_texts()} == {"moving-horizon", "kalman", "true rate"}
    thresholds = [text for axes in figure.axes for text in axes.texts if text.get_text() == "0.5"]
    first, second = (text.get_window_extent() for text in thresholds)
    assert not first.overlaps(second)


def test_help_tells_of_both_estimators(glucoloop, monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")
    answer = glucoloop("detect", "--help")
    assert answer.code == 0
    for part in ("moving-horizon, kalman", "--estimates-by", "100; of several people 1", "--fault"):
        assert part in answer.out
    assert "--announce-meals" not in answer.out


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (("--estimator", "kalmen"), "--estimator: unknown estimator 'kalmen'; did you mean 'kalman'?"),
        (("--threshold", 2), "--threshold is 2; give a number above 0 and below 1"),
        (("--threshold", "high"), "--threshold is 'high'; give a number"),
        (("--days", 0), "--days is 0; give"),
        (("--people", 0), "--people is 0; give"),
        (("--meal", "50g@25h"), "the meal at 1500 min begins after the run ends at 1440 min"),
        (("--overwrite",), "--overwrite is about an output folder; name one with --out"),
        (("--controller", "basal, move_weight=1"), "the controller basal has no setting 'move_weight'"),
    ],
)
def test_mistakes(refused, tmp_path, arguments, sentence):
    assert sentence in refused("detect", *arguments)
    assert list(tmp_path.iterdir()) == []
