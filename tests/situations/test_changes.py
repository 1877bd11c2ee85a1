"""Texts of changes of a therapy, and what they do to a run."""

import contextlib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from glucoloop.refusal import Refusal
from glucoloop.situations.run import Run
from glucoloop.situations.situation import configured
from glucoloop.situations.therapy_text import BolusShift, CarbCount, change_text, read_change
from glucoloop.studies.closed_loop import close_the_loop
from glucoloop.studies.run import Comparison
from glucoloop.therapy import TARGET, TherapyChange
from glucoloop.units import MU_PER_U

MORNING = {
    "patient": "hovorka-2004",
    "controller": ["basal-bolus"],
    "announce_meals": True,
    "start": "06:00",
    "duration_min": 180.0,
    "meals": ["60g@1h"],
}
HOURS = st.tuples(st.integers(0, 1439), st.integers(0, 1440)).filter(lambda hours: hours[0] != hours[1])


def test_texts_are_what_they_say():
    assert read_change("bolus, 15 min earlier") == BolusShift(15.0)
    assert read_change("bolus, 0.5h later") == BolusShift(-30.0)
    assert read_change("carbs, 20% too low") == CarbCount(80.0)
    assert read_change("carbs, 30 % too high") == CarbCount(130.0)
    assert read_change("target, 120, 22h-7h") == TherapyChange(TARGET, 1320.0, 420.0, value=120.0)
    half_less = read_change("correction_factor, -50%")
    assert half_less == read_change("correction, 50%") == TherapyChange("correction_mg_dl_U", 0.0, 1440.0, factor=0.5)


CHANGES = st.one_of(
    st.builds(BolusShift, st.floats(0.1, 180.0) | st.floats(-180.0, -0.1)),
    st.builds(CarbCount, st.floats(10.0, 99.0) | st.floats(101.0, 200.0)),
    st.builds(
        lambda field, hours, percent: TherapyChange(field, *map(float, hours), factor=percent / 100.0),
        st.sampled_from(["basal_mU_min", "carb_ratio_g_U", "correction_mg_dl_U", TARGET]),
        HOURS,
        st.floats(10.0, 1000.0),
    ),
)


def text_of(change):
    if isinstance(change, BolusShift):
        return f"bolus, {abs(change.earlier_min)!r} min {'earlier' if change.earlier_min > 0.0 else 'later'}"
    if isinstance(change, CarbCount):
        return f"carbs, {abs(change.percent - 100.0)!r}% too {'high' if change.percent > 100.0 else 'low'}"
    return change_text(change)


@given(CHANGES)
def test_a_text_is_read_as_it_was_written(change):
    again = read_change(text_of(change))
    assert type(again) is type(change)
    assert [value for value in again if isinstance(value, float)] == pytest.approx(
        [value for value in change if isinstance(value, float)], rel=1e-12
    )


_NAMES = ("basal", "bolus", "carbs", "carb_ratio", "target", "earlier", "too", "low", "breakfast", "min", "from")
_AMOUNTS = ("15", "20%", "+10%", "1e999", "nan", "-0", "8", "6h", "22:00", "-", ",")
WORDS = st.sampled_from([*_NAMES, *_AMOUNTS])


@given(st.text(max_size=30) | st.lists(WORDS, max_size=8).map(" ".join) | st.lists(WORDS, max_size=4).map(",".join))
def test_any_text_is_a_change_or_refused_in_a_sentence(text):
    with contextlib.suppress(Refusal):
        assert isinstance(read_change(text), TherapyChange | BolusShift | CarbCount)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("basl, +10%", "did you mean 'basal'.*bolus or carbs"),
        ("basal, +10%, 6h", "hours of the day"),
        ("basal, +10%, 25h-26h", "no time of day"),
        ("basal, +3000%", "10% to 1000%"),
        ("basal", "write it like"),
        ("bolus, 15 min", "15 min earlier"),
        ("bolus, 15 min earlier, breakfast", "hours 'breakfast', and the boluses of all meals move.*'bolus, 15 min ea"),
        ("bolus, 15 min earlier, 6h-10h", "hours '6h-10h'.*'carb_ratio, -10%, breakfast'"),
        ("carbs, 20% too low, 25h", "hours '25h', and the carbohydrate of all meals.*'carbs, 20% too low'"),
        ("bolus, soon, 6h-10h", "tells no time"),
        ("bolus, 0 min earlier", "up to 180 min"),
        ("bolus, 4h later", "up to 180 min"),
        ("bolus, +10%", "carb_ratio, -10%"),
        ("carbs, 20%", "20% too low"),
        ("carbs, 95% too low", "90% too low or 100% too high"),
        ("carbs, 0% too low", "90% too low"),
        ("carbs, -20% too low", "90% too low"),
    ],
)
def test_a_wrong_text_is_refused(text, says):
    with pytest.raises(Refusal, match=says):
        read_change(text)


@pytest.mark.parametrize(
    ("changes", "settings", "says"),
    [
        (["basal, +10%, 0h-6h"], {"start": None}, "--start 06:00"),
        (["basal, +10%", "basal, +10%"], {}, "given twice"),
        (["carb_ratio, 8"], {"announce_meals": False}, "meals are not announced.*--announce-meals"),
        (["carb_ratio, 8"], {"controller": ["basal-bolus, carb_ratio_g_U=9"]}, "its own carb_ratio_g_U=9"),
        (["basal, +10%"], {"controller": ["mpc"]}, "mpc does not use the profile of a person"),
        (["carb_ratio, 8"], {"controller": ["mpc"], "guard": "usual"}, "mpc does not use the carbohydrate ratio"),
        (["correction, 30"], {"controller": ["pid-ifb"]}, "pid-ifb does not use the correction factor of a person"),
        (["carb_ratio, 8"], {"controller": ["pid-ifb, meal_bolus=0"]}, "pid-ifb does not use the carbohydrate ratio"),
        (["carbs, 20% too low"], {"controller": ["mpc"]}, "mpc does not use announcements"),
        (["target, 120"], {"controller": ["basal"]}, "basal does not use readings"),
        (["bolus, 15 min earlier"], {"controller": ["meal-mpc"]}, "before a meal is eaten"),
        (["bolus, 15 min earlier"], {"announce_before_min": 170.0}, "185 min before eating"),
        (["carbs, 20% too low"], {"meals": []}, "there is no meal"),
    ],
)
def test_a_change_that_is_not_possible_or_has_no_effect_is_refused(changes, settings, says):
    with pytest.raises(Refusal, match=says):
        configured(Run, {**MORNING, **settings, "changes": changes})


def test_a_comparison_has_a_case_for_each_change_that_has_an_effect_on_it():
    both = configured(
        Comparison, {**MORNING, "controller": ["mpc", "basal-bolus"], "changes": ["basal, +10%", "target, 120"]}
    )
    assert [case.label for case in both.changed_cases] == [
        *("basal-bolus: basal, +10%", "mpc: target, 120", "basal-bolus: target, 120"),
    ]
    alone = configured(Comparison, {**MORNING, "changes": ["basal, +10%"]})
    assert [case.label for case in alone.changed_cases] == ["basal, +10%"]


@pytest.fixture(scope="module")
def trace_of():
    """Trace of a morning with a meal at 7 h under changes, each simulated once."""
    traces = {}

    def trace(*changes, **settings):
        key = repr((changes, settings))
        if key not in traces:
            run = configured(Run, {**MORNING, **settings, "changes": list(changes)})
            traces[key] = close_the_loop(run, run.case).trace
        return traces[key]

    return trace


def test_ten_percent_more_basal_is_given_in_its_hours_alone(trace_of):
    plain, more = trace_of(), trace_of("basal, +10%, 7h-8h")
    inside = (plain.t_min >= 60.0) & (plain.t_min < 120.0)
    ratio = more.insulin_mU_min / plain.insulin_mU_min
    assert ratio[inside] == pytest.approx(1.1)
    assert ratio[~inside] == pytest.approx(1.0)


def test_a_change_without_hours_needs_no_clock(trace_of):
    plain, more = trace_of(start=None), trace_of("basal, +10%", start=None)
    assert more.insulin_mU_min == pytest.approx(1.1 * plain.insulin_mU_min)


def test_boluses_come_a_quarter_of_an_hour_earlier_or_later(trace_of):
    [at], [earlier], [later] = (
        trace.t_min[trace.bolus_mU > 0.0].tolist()
        for trace in (trace_of(), trace_of("bolus, 15 min earlier"), trace_of("bolus, 15 min later"))
    )
    assert (at, earlier, later) == (60.0, 45.0, 75.0)


def test_carbohydrate_that_is_counted_a_fifth_too_low_gets_a_fifth_less_insulin(trace_of):
    plain, low = trace_of(), trace_of("carbs, 20% too low")
    assert low.announced_carbs_g.sum() == pytest.approx(0.8 * 60.0)
    assert low.carbs_g.sum() == 60.0
    low_mU, plain_mU = (float(trace.bolus_mU.sum()) for trace in (low, plain))
    assert low_mU == pytest.approx(0.8 * plain_mU, abs=0.05 * MU_PER_U)  # the step of boluses


def test_a_ratio_of_breakfast_concerns_its_meal_alone(trace_of):
    meals = {"meals": ["60g@1h", "60g@5.5h"], "duration_min": 360.0}  # at 7:00 and at 11:30
    plain, changed = trace_of(**meals), trace_of("carb_ratio, 20, breakfast", **meals)
    boluses = changed.bolus_mU[changed.bolus_mU > 0.0]
    assert boluses[0] == pytest.approx(60.0 / 20.0 * MU_PER_U)
    assert boluses[0] > plain.bolus_mU[plain.t_min == 60.0][0]
    assert boluses[1] <= plain.bolus_mU[plain.t_min == 330.0][0]  # less, since glucose is lower then


def test_changes_of_a_run_act_together_and_beside_its_own_settings(trace_of):
    given = {"announce_before_min": 10.0, "carb_bias_pct": -10.0, "targets": ["130@0h-24h"]}
    both = trace_of("carbs, 20% too low", "bolus, 5 min later", "target, 110", **given)
    assert both.announced_carbs_g.sum() == pytest.approx(0.9 * 0.8 * 60.0)
    assert both.t_min[both.bolus_mU > 0.0].tolist() == [55.0]
    as_given = trace_of(announce_before_min=5.0, carb_bias_pct=-28.0, targets=["110@0h-24h"])
    assert both.bolus_mU.tolist() == as_given.bolus_mU.tolist()
