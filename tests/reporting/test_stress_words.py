"""Short names of faults, and sentences about a stress test."""

import itertools
from types import SimpleNamespace

import pytest

from glucoloop.faults import FAULTS
from glucoloop.patients import population
from glucoloop.reporting.columns import _percent, terse_percent, whole, whole_glucose
from glucoloop.reporting.descriptions import settings_in_words, short_names, when_in_words
from glucoloop.reporting.heat import SHADES_PCT as SHADES
from glucoloop.reporting.heat import UNKNOWN, shade_of
from glucoloop.studies.stress import STANDARD_FAULTS
from glucoloop.studies.stress.study import COLUMNS, _conclusions, _worse_people_text, sentences

STUCK, DRIFT = "stuck, start_min=60, duration_min=90", "drift, mg_dl_h=3"


@pytest.mark.parametrize(
    ("faults", "names"),
    [
        (["late, delay_min=15"], ["late"]),
        (["spikes, size_mg_dl=60", "spikes, size_mg_dl=-40"], ["spikes size 60 mg/dl", "spikes size -40 mg/dl"]),
        (["drift, mg_dl_h=3", "drift, mg_dl_h=-3"], ["drift 3 mg/dl per h", "drift -3 mg/dl per h"]),
        (
            ["calibration, gain=1.15", "calibration, gain=1, offset_mg_dl=15", "calibration, gain=1"],
            ["calibration gain 1.15", "calibration offset 15 mg/dl", "calibration gain 1, offset 0 mg/dl"],
        ),
        (["occlusion", "occlusion, noticed=true"], ["occlusion not noticed", "occlusion noticed"]),
        (["nonsense, value=nan", "nonsense, value=0"], ["nonsense value nan", "nonsense value 0"]),
        # how long it lasts says more than when it begins
        (
            ["missing, start_min=10, duration_min=60", "missing, start_min=20, duration_min=240", "stuck"],
            ["missing 60 min", "missing 240 min", "stuck"],
        ),
        (
            ["missing, start_min=10, duration_min=60", "missing, start_min=20, duration_min=60"],
            ["missing from 10 min", "missing from 20 min"],
        ),
        (["spikes, per_day=12", "spikes, per_day=3"], ["spikes 12 a day", "spikes 3 a day"]),
        # one at any time, one at random: no single time tells all three apart
        (
            ["missing", "missing, per_day=3", "missing, start_min=20, latest_min=40"],
            ["missing", "missing 3 a day", "missing from 20 min, up to 40 min"],
        ),
    ],
)
def test_a_name_holds_what_sets_a_fault_apart(faults, names):
    assert list(short_names(faults).values()) == names


def test_the_standard_faults_have_names_of_their_own_that_fit_a_terminal():
    names = short_names(STANDARD_FAULTS)
    assert len(set(names.values())) == len(STANDARD_FAULTS)
    assert max(map(len, names.values())) <= 27


def test_faults_that_differ_only_in_how_they_are_written_keep_their_texts():
    faults = ["spikes, size_mg_dl=60", "spikes,size_mg_dl=6e1"]
    assert list(short_names(faults).values()) == faults


@pytest.mark.parametrize(
    ("fault", "when"),
    [
        ("stuck", "always"),
        ("resolution", "always"),
        ("missed-pulses", "at random, at any time"),
        ("stuck, start_min=60", "from 60 min to the end"),
        ("stuck, duration_min=30", "from 0 min, for 30 min"),
        (
            "stuck, start_min=60, latest_min=300, duration_min=30",
            "from a moment between 60 and 300 min, for 30 min",
        ),
        ("spikes, per_day=12", "at random, 12 times a day, for one sample"),
        ("spikes, per_day=0.5, duration_min=10", "at random, 0.5 times a day, for 10 min"),
    ],
)
def test_when_a_fault_is_there_is_said(fault, when):
    assert when_in_words(FAULTS.choose(fault)) == when


def test_what_is_set_is_said_with_its_unit():
    told = settings_in_words(FAULTS.choose("compression, start_min=60, depth=0.3, tau_min=12"))
    assert told == "depth 0.3, tau 12 min"
    assert settings_in_words(FAULTS.choose("stuck, start_min=60")) == ""


@pytest.mark.parametrize(
    ("value", "text", "terse"),
    [
        (0.0, "0", "0"),
        (1e-9, "< 0.01", "<0.1"),
        (0.05, "0.05", "0.1"),
        (5.04, "5.0", "5.0"),
        (99.97, "99.97", "99"),
        (100.0, "100", "100"),
    ],
)
def test_little_is_never_told_as_none(value, text, terse):
    assert (_percent(value), terse_percent(value)) == (text, terse)


def test_a_number_that_rounds_to_nothing_has_no_sign():
    assert (whole(-0.2), whole(-3.6)) == ("0", "-4")


def test_a_concentration_below_0_is_no_number(make_stress):
    assert (whole_glucose(-0.2), whole_glucose(75.4)) == ("not valid", "75")
    lowest = next(column for column in COLUMNS if column.name == "lowest_mg_dl")
    (row,) = make_stress(["mpc"], [], guards=(False,), change=lambda row: {"lowest_mg_dl": None}).rows
    assert lowest.value_text(row) == lowest.short_value_text(row) == "not valid"
    assert lowest.value_text(row | {"people": 0}) == "n/a"


def test_a_shade_reaches_up_to_its_bound():
    most = [shade.most for shade in SHADES]
    assert [shade_of(value) for value in most] == list(SHADES)
    assert [shade_of(value + 1e-9) for value in most[:-1]] == list(SHADES[1:])
    assert shade_of(None) is UNKNOWN


def test_shades_grow_darker_and_can_be_read():
    def luminance(colour):
        """Relative, after the Web Content Accessibility Guidelines 2.1."""
        parts = [int(colour[place : place + 2], 16) / 255.0 for place in (1, 3, 5)]
        linear = [part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in parts]
        return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]

    coloured = [shade for shade in SHADES if shade.colour]
    lights = [luminance(shade.colour) for shade in coloured]
    # as in grey print
    assert all(light > 1.15 * darker for light, darker in itertools.pairwise(lights))
    for shade in [*coloured, UNKNOWN]:
        high, low = sorted((luminance(shade.colour), luminance(shade.ink)), reverse=True)
        assert (high + 0.05) / (low + 0.05) >= 4.5


def test_what_passes_and_what_fails_is_counted(make_stress):
    result = make_stress(
        ["imc", "mpc"],
        [STUCK, DRIFT],
        {
            ("imc", False, DRIFT): (30.0, range(9)),
            ("mpc", False, STUCK): (12.0, range(4)),
            ("mpc", False, DRIFT): (20.0, range(9)),
            ("mpc", True, STUCK): (4.04, [17]),
        },
    )
    passing, failing, harm, quiet, beyond = _conclusions(result)
    assert passing == (
        "With the guard, 3 of 4 combinations of a controller and a fault passed: with the fault, nobody's time below "
        "60 mg/dl was longer by more than 1 % of the run than without it. Without the guard, 1 of 4 passed."
    )
    assert failing == (
        "Combinations that failed with the guard: mpc under stuck (1 of 40 people worse off, by at most 4.0 % of the "
        "run)."
    )
    assert harm == "In no combination, with or without a fault, did the guard lengthen the mean time below 60 mg/dl."
    assert "imc: 0 % and 151 → 153 mg/dl; mpc: 0 % and 151 → 153 mg/dl." in quiet
    # 1 + 6.66 + 0.004 + 0.25
    assert quiet.endswith("The guard then acted at this percentage of the samples: 7.9 % with imc; 7.9 % with mpc.")
    assert beyond.startswith(
        "In 3 of 12 combinations glucose fell below the valid range of the patient's model, for at most 2 of 40"
    )


def test_reasons_follow_the_conclusions(make_stress):
    result = make_stress(["mpc"], [STUCK], {("mpc", True, STUCK): (4.04, [17])})
    asked = SimpleNamespace(population=population("parker2000"), seed=0)
    *first, reason = sentences(asked, result)
    assert first == list(_conclusions(result))
    assert reason == (
        "mpc under stuck, with the guard: person 17, below 60 mg/dl for 4.0 % of the run longer. "
        "He ate <nothing> & fell."
    )


def test_harm_that_the_guard_does_is_said(make_stress):
    result = make_stress(["imc"], [STUCK], {("imc", False, STUCK): (2.0, []), ("imc", True, STUCK): (10.0, [3])})
    # the mean is an eighth of the worst
    assert (
        "In 1 of 2 combinations, those without a fault included, the mean time below 60 mg/dl was longer with the "
        "guard than without it: by at most 1.0 % of the run, in imc under stuck."
    ) in _conclusions(result)


def test_combinations_that_share_the_most_harm_are_counted(make_stress):
    bad = {("imc", True, STUCK): (10.0, [3]), ("mpc", True, DRIFT): (10.0, [3])}
    harm = " ".join(_conclusions(make_stress(["imc", "mpc"], [STUCK, DRIFT], bad)))
    assert "by at most 1.2 % of the run, in imc under stuck and 1 more." in harm


def test_only_the_worst_of_many_that_fail_are_listed(make_stress):
    faults = [f"drift, mg_dl_h={rate}" for rate in range(1, 9)]
    bad = {("imc", True, fault): (float(index + 2), [1]) for index, fault in enumerate(faults)}
    _, failing, *_ = _conclusions(make_stress(["imc"], faults, bad))
    assert failing.startswith("Combinations that failed with the guard: imc under drift 8 mg/dl per h (")
    assert failing.count("imc under") == 5
    assert failing.endswith("; and 3 more.")


def test_a_test_without_a_guard_speaks_of_none(make_stress):
    told = list(_conclusions(make_stress(["imc"], [STUCK], {("imc", False, STUCK): (9.0, [1])}, guards=(False,))))
    assert told[0].startswith("Without the guard, 0 of 1 combinations")
    assert told[1].startswith("Combinations that failed without the guard")
    assert len(told) == 3
    assert "acted" not in told[2]


def nobody(row):
    """A cell in which nobody is known."""
    return dict.fromkeys(row.keys() - {"controller", "guarded", "fault"}) | {"people": 0}


def test_cells_in_which_nobody_took_part_do_not_count_as_passing(make_stress):
    result = make_stress(["imc"], [STUCK, DRIFT], change=lambda row: nobody(row) if row["fault"] == DRIFT else {})
    told = list(_conclusions(result))
    assert told[0].startswith("In 2 of 6 combinations the glucose of some people, 40 of 40 people at most")
    assert told[1] == (
        "With the guard, 1 of 1 combinations of a controller and a fault passed: with the fault, nobody's time below "
        "60 mg/dl was longer by more than 1 % of the run than without it. Without the guard, 1 of 1 passed. In 1 "
        "further combination nobody could take part."
    )


def test_who_took_no_part_is_told(make_stress, stress_page):
    told = "3 of 43 people have no basal rate for the setpoint and were left out."
    result = make_stress(["imc"], [STUCK], people=43)
    assert next(_conclusions(result)) == told
    assert told in stress_page(result)
    assert "left out" not in " ".join(_conclusions(make_stress(["imc"], [STUCK])))


def test_people_whose_glucose_did_not_stay_finite_are_told(make_stress):
    result = make_stress(["imc"], [STUCK, DRIFT], change=lambda row: {"people": 38} if row["fault"] == DRIFT else {})
    assert next(_conclusions(result)) == (
        "In 2 of 6 combinations the glucose of some people, 2 of 40 people at most "
        f"(imc | {DRIFT} and 1 more), did not stay a finite number, with or without the fault; they are in no number "
        "there."
    )


def test_nothing_is_concluded_where_nobody_took_part(make_stress):
    result = make_stress(["imc"], [STUCK], change=nobody, able=0)
    assert list(sentences(None, result)) == ["40 of 40 people have no basal rate for the setpoint and were left out."]


def test_a_test_without_faults_says_so(make_stress):
    assert next(_conclusions(make_stress(["imc"], []))) == "No fault was tried."


def test_as_many_people_are_named_as_can_be_read():
    assert _worse_people_text({"worse_people": [5, 3]}) == "5, 3"
    assert _worse_people_text({"worse_people": list(range(23))}).endswith("18, 19 and 3 more")


def test_the_clock_of_a_long_run_counts_from_its_start():
    fault = FAULTS.choose("missing, start_min=1500, duration_min=60")
    assert when_in_words(fault, start_min=360.0) == "from day 2, 07:00, for 60 min"
