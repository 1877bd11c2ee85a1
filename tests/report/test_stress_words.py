"""Short names of faults, and sentences about a stress test."""

import dataclasses
import itertools
import math

import pytest

from glucoloop.parts.faults import FAULTS
from glucoloop.report.fault_words import settings_in_words, short_names, when_in_words
from glucoloop.studies.stress import results
from glucoloop.studies.stress._cells import SHADES, UNKNOWN, shade_of, short_mg_dl, short_pct
from glucoloop.studies.stress._grid import grid_of
from glucoloop.studies.stress._words import left_out, numbers_told, verdict
from glucoloop.studies.stress.page import stress_page
from glucoloop.studies.stress.stress import STANDARD_FAULTS

STUCK, DRIFT = "stuck, start_min=60, duration_min=90", "drift, mg_dl_h=3"


@pytest.mark.parametrize(
    ("faults", "names"),
    [
        (["late, delay_min=15"], ["late"]),
        (["spikes, size_mg_dl=60", "spikes, size_mg_dl=-40"], ["spikes size 60 mg/dl", "spikes size -40 mg/dl"]),
        (["drift, mg_dl_h=3", "drift, mg_dl_h=-3"], ["drift 3 mg/dl/h", "drift -3 mg/dl/h"]),
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
    ("value", "text"),
    [(0.0, "0"), (1e-9, "<0.1"), (0.05, "0.1"), (5.04, "5.0"), (99.97, "99.9"), (100.0, "100"), (math.nan, "n/a")],
)
def test_little_is_never_told_as_none(value, text):
    assert short_pct(value) == text


def test_a_concentration_below_0_is_no_number():
    assert (short_mg_dl(-0.2), short_mg_dl(-3.6), short_mg_dl(math.nan)) == ("not valid", "not valid", "n/a")


def test_a_shade_reaches_up_to_its_bound(make_stress_row):
    below = [shade.most_pct for shade in SHADES]
    assert [shade_of(make_stress_row("mpc", True, "", below=value)) for value in below] == list(SHADES)
    above = [shade_of(make_stress_row("mpc", True, "", below=value + 1e-9)) for value in below[:-1]]
    assert above == list(SHADES[1:])
    assert shade_of(make_stress_row("mpc", True, "", below_60_worst_pct=math.nan)) is UNKNOWN


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


def test_what_stands_and_what_does_not_is_counted(make_stress):
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
    standing, broken, harm, quiet = verdict(grid_of(result))
    assert standing == (
        "With the guard, 3 of 4 combinations of a controller and a fault passed: with the fault, nobody spent more "
        "than 1 % more of the time below 60 mg/dl than without it. Without the guard, 1 of 4 passed."
    )
    assert (
        broken
        == "Combinations that failed with the guard: mpc under stuck (1 of 40 people worse off, by at most 4.0 % of "
        "the time)."
    )
    assert harm.startswith("In no combination, with or without a fault, did the guard lengthen")
    assert "imc: 0 % and 151 → 153; mpc: 0 % and 151 → 153." in quiet
    # 1 + 6.66 + 0.004 + 0.25
    assert quiet.endswith(
        "Without a fault, the guard acted at this percentage of the samples: 7.9 % with imc; 7.9 % with mpc."
    )


def test_harm_that_the_guard_does_is_said(make_stress):
    result = make_stress(["imc"], [STUCK], {("imc", False, STUCK): (2.0, []), ("imc", True, STUCK): (10.0, [3])})
    harm = verdict(grid_of(result))[2]
    # the mean is an eighth of the worst
    assert harm == (
        "In 1 of 2 combinations, those without a fault included, the mean time below 60 mg/dl was longer with the "
        "guard than without it: by at most 1.0 % of the time, in imc under stuck."
    )


def test_only_the_worst_of_many_that_do_not_stand_are_listed(make_stress):
    faults = [f"drift, mg_dl_h={rate}" for rate in range(1, 9)]
    bad = {("imc", True, fault): (float(index + 2), [1]) for index, fault in enumerate(faults)}
    broken = verdict(grid_of(make_stress(["imc"], faults, bad)))[1]
    assert broken.startswith("Combinations that failed with the guard: imc under drift 8 mg/dl/h (")
    assert broken.count("imc under") == 5
    assert broken.endswith("; and 3 more.")


def test_a_test_without_a_guard_speaks_of_none(make_stress):
    told = verdict(grid_of(make_stress(["imc"], [STUCK], {("imc", False, STUCK): (9.0, [1])}, guards=(False,))))
    assert told[0].startswith("Without the guard, 0 of 1 combinations")
    assert told[1].startswith("Combinations that failed without the guard")
    assert len(told) == 3
    assert "acts" not in told[2]


def test_cells_in_which_nobody_took_part_do_not_count_as_standing(make_stress, make_stress_row):
    result = make_stress(["imc"], [STUCK, DRIFT])
    empty = {"people": 0, "below_60_mean_pct": math.nan, "below_60_worst_pct": math.nan, "worst_more_pct": math.nan}
    rows = tuple(dataclasses.replace(row, **empty) if row.tried.fault == DRIFT else row for row in result.rows)
    assert verdict(grid_of(dataclasses.replace(result, rows=rows)))[0] == (
        "With the guard, 1 of 1 combinations of a controller and a fault passed: with the fault, nobody spent more "
        "than 1 % more of the time below 60 mg/dl than without it. Without the guard, 1 of 1 passed. In 1 further "
        "combination nobody could take part."
    )


def test_who_took_no_part_is_told(make_stress):
    result = make_stress(["imc"], [STUCK], able=40, infeasible=3)
    told = "Of 43 people 3 have no basal rate for the setpoint and took no part."
    assert left_out(result) == [told]
    assert told in stress_page(result)
    assert next(results.verdict(result)) == told
    assert left_out(make_stress(["imc"], [STUCK])) == []


def test_people_whose_glucose_did_not_stay_finite_are_told(make_stress):
    result = make_stress(["imc"], [STUCK, DRIFT], able=40)
    rows = tuple(dataclasses.replace(row, people=38) if row.tried.fault == DRIFT else row for row in result.rows)
    assert left_out(dataclasses.replace(result, rows=rows)) == [
        "In 2 of 6 combinations the glucose of some people, 2 of 40 people at most "
        f"(imc | {DRIFT}), did not stay a finite number, with or without the fault; they are in no number there."
    ]


def test_nothing_is_concluded_from_cells_in_which_nobody_took_part(make_stress):
    result = make_stress(["imc"], [STUCK], able=0, infeasible=40)
    empty = {"people": 0, "below_60_mean_pct": math.nan, "below_60_worst_pct": math.nan, "worst_more_pct": 0.0}
    rows = tuple(dataclasses.replace(row, **empty) for row in result.rows)
    result = dataclasses.replace(result, rows=rows)
    assert list(results.verdict(result)) == ["Of 40 people 40 have no basal rate for the setpoint and took no part."]
    assert not any("In none is the mean time" in told for told in verdict(grid_of(result)))


def test_a_test_without_faults_says_so(make_stress):
    assert verdict(grid_of(make_stress(["imc"], [])))[0] == "No fault was tried."


def test_as_many_people_are_named_as_can_be_read(make_stress_row):
    assert numbers_told(make_stress_row("imc", True, STUCK, below=9.0, worse=[5, 3])) == "5, 3"
    assert numbers_told(make_stress_row("imc", True, STUCK, below=9.0, worse=range(23))).endswith("18, 19 and 3 more")


def test_what_is_no_grid_is_refused(make_stress):
    result = make_stress(["imc", "mpc"], [STUCK])
    with pytest.raises(ValueError, match="no rows to show; give at least one"):
        grid_of(dataclasses.replace(result, rows=()))
    with pytest.raises(ValueError, match="two rows of 'imc'; leave one out"):
        grid_of(dataclasses.replace(result, rows=(*result.rows, result.rows[0])))
    with pytest.raises(ValueError, match=r"no row of 'mpc \| guarded \| stuck.*'; give one for every cell"):
        grid_of(dataclasses.replace(result, rows=result.rows[:-1]))
