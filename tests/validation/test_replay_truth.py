"""Replays where the truth is known: what is compared, and that the twin's own doses give its glucose again."""

import numpy as np
import pytest

import replay_truth as truth
from glucoloop.forecasts.grid import SAMPLES_PER_DAY, gridded_record
from glucoloop.patients.population import population
from glucoloop.twins import (
    StoredTwin,
    change_range,
    explained,
    explained_people,
    find_twin,
    replay_people,
    under_doses,
)

ZEROS = np.zeros((4, 3)).tolist()


def row(seed, true, predicted, half_width):
    ends = np.stack([np.array(predicted) - half_width, np.array(predicted) + half_width])
    return {
        "condition": "one by another",
        "seed": seed,
        "numbers": [165.0, 60.0, 2.0],
        "daily_dose_U": 40.0,
        "true": true,
        "predicted": predicted,
        "range": ends.tolist(),
        "predicts": seed > 0,
        "fall_mg_dl_U": [20.0, 10.0, 50.0 if seed else 30.0],
        "true_fall_mg_dl_U": 40.0,
    }


def test_slope_error_and_coverage_are_those_of_the_changes():
    true = np.array([[10.0, -5.0, 0.0], [-10.0, 5.0, 1.0], [4.0, -2.0, 0.0], [-4.0, 2.0, 1.0]])
    rows = [row(0, true.tolist(), (0.5 * true).tolist(), 2.0), row(1, true.tolist(), (0.5 * true).tolist(), 2.0)]
    assert truth.slope(rows, "mean") == pytest.approx(0.5)
    assert truth.error(rows, "mean") == pytest.approx(0.5 * 7.0)
    assert truth.covered_pct(rows, "mean") == 50.0  # 2 of 4 are within 2 mg/dl
    text = "\n".join(truth.lines(rows))
    assert "slope 0.50 (0.50 to 0.50)" in text
    assert "sensitivity over the true one 0.50 (0.50 to 0.50), within the range 50 %" in text
    assert "do not rely: 1 of 2" in text
    nothing = [row(0, ZEROS, ZEROS, 1.0)]
    assert "slope unknown" in "\n".join(truth.lines(nothing))


def test_the_range_of_changes_reaches_over_both_ends_and_nine_of_ten_people_drawn():
    drawn = np.linspace(0.0, 10.0, 11)
    assert change_range(np.concatenate([[1.0, 2.0, 12.0], drawn]), [False] * 3 + [True] * 11) == pytest.approx(
        (0.5, 12.0)
    )
    assert change_range(np.array([2.0, 1.0, 3.0]), [False] * 3) == (1.0, 3.0)


def test_who_is_there_is_not_computed_again():
    condition = truth.CONDITIONS[0]
    done = [{**row(5, ZEROS, ZEROS, 1.0), "condition": condition.name}]
    assert list(truth.results([condition], [5], done)) == []


@pytest.mark.long
def test_a_twin_of_the_persons_own_family_says_what_other_doses_do():
    condition = truth.Condition("hovorka-2004", "hovorka-2004", "basal-bolus", 0.6)
    life = truth.lived(condition, 4, days=6)
    np.testing.assert_allclose(life.under(1.0, 1.0), life.glucose_mg_dl, atol=1e-6)
    record = gridded_record(life.record())
    assert record.insulin_U.sum() == pytest.approx(
        float((5.0 * life.trace.insulin_mU_min + life.trace.bolus_mU).sum()) / 1000.0, rel=0.01
    )
    assert record.carbs_g.sum() < 0.8 * float(np.asarray(life.trace.carbs_g).sum())
    twin = StoredTwin.of(find_twin(record, population("boiroux2017", patient="hovorka-2004"), held_out_days=1).plain())
    explanation = explained(twin.patient, twin.p, record, twin.mean_mg_dl)
    again = under_doses(twin.patient, twin.p, explanation, record)
    np.testing.assert_allclose(again, explanation.glucose_mg_dl, rtol=1e-9)
    true = life.under(1.2, 1.0) - life.glucose_mg_dl
    more = truth.changed_doses(record, 1.2, 1.0)
    assert more.insulin_U.sum() == pytest.approx(record.insulin_U.sum() + 0.2 * record.basal_U.sum())
    counted = slice(SAMPLES_PER_DAY, None)
    people = explained_people(list(replay_people(twin, 10, 0)), record, twin.mean_mg_dl)
    changes = [
        (under_doses(of.patient, of.p, of.explained, more) - of.explained.glucose_mg_dl)[counted].mean()
        for of in people
    ]
    low, high = change_range(np.array(changes), [of.drawn for of in people])
    assert low < true[counted].mean() < high < 0.0
