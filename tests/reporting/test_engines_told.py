"""The engines of loops in words: grouped by what native code lacks, and few names however many cases there are."""

from glucoloop.build.designs import controller_of
from glucoloop.control.protocol import computed_settings
from glucoloop.reporting.descriptions import (
    _case_in_words,
    controllers_facts,
    engine_facts,
    engine_notes,
    run_facts,
    trial_facts,
)
from glucoloop.reporting.labelled_traces import moment_text
from glucoloop.situations.run import Run
from glucoloop.situations.situation import configured
from glucoloop.trials.trial import Trial

NATIVE, LACKING = {"engine": "native"}, {"engine": "xla", "not_native": "the operation 'sort' in the controller"}


def test_loops_that_lack_the_same_are_told_in_one_sentence():
    engines = {"a": NATIVE, **{f"b{number}": LACKING for number in range(7)}}
    assert list(engine_notes(engines)) == [
        "b0, b1, b2, b3, b4 and 2 more: native code cannot take these loops, which have the operation 'sort' in the "
        "controller; JAX ran them, to the same result but for rounding, and more slowly."
    ]
    assert engine_facts(engines) == {
        "Engine": "a: native code; b0, b1, b2, b3, b4 and 2 more: JAX (xla): the operation 'sort' in the controller"
    }


def test_an_engine_that_was_asked_for_needs_no_note():
    assert list(engine_notes({"a": {"engine": "xla", "not_native": None}, "b": NATIVE})) == []


def test_the_page_of_a_trial_has_the_tuning_that_a_controller_used():
    run = configured(Run, controller=["pid", "basal"])
    pid = computed_settings(controller_of(run, run.cases[0]))
    assert pid["gain"] > 0.0
    facts = controllers_facts(run.cases, {"pid": pid, "basal": {}})
    assert f"gain {pid['gain']:.4g}" in facts["As designed, pid"]
    assert "As designed, basal" not in facts
    # a 0 that stands for what follows from the design is not told beside it
    assert facts["Controller pid"].endswith("closed loop 30 min, step 0 mU/min")


def test_a_setting_without_a_value_is_not_told():
    run = configured(Run, controller="meal-mpc")
    assert run.case.tuning["meals_by_time"] == ""
    assert "meals by time" not in _case_in_words(run.case)


def test_meals_of_a_long_run_are_told_by_day_and_clock_in_their_order():
    settings = {"scenario": "week, days=2", "start": "06:00", "controller": ["pid"]}
    run = configured(Run, settings)
    told = run_facts(run, run.case)["Meals"].split(" g at ")[1:]
    clocks = [text.partition(",")[0] + "," + text.partition(",")[2][:6] for text in told]
    first = min(run.eaten(), key=lambda meal: meal.t_min).t_min
    assert clocks[0] == moment_text(first, 2880.0, 360.0)
    assert clocks == sorted(clocks)
    assert trial_facts(configured(Trial, {**settings, "people": 2}))["Meals"].startswith("45 g at 13:00, 70 g at 18:00")
