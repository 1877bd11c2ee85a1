"""The table of a stress test as a person reads it, at a terminal or in a pipe."""

import io
import types

import pytest
from rich.console import Console

from glucoloop.studies.stress import STANDARD_FAULTS
from glucoloop.studies.stress.study import tables

STUCK = "stuck, start_min=60, duration_min=90"


def printed(table, width=110):
    out = io.StringIO()
    Console(file=out, width=width, markup=False).print(table)
    return out.getvalue()


def stress_table(found):
    (table,) = tables(types.SimpleNamespace(rescue=None, glucagon=None), found)
    return table


def line(text, start):
    """Numbers of the first line that begins so."""
    found = next(words for words in text.splitlines() if words.strip().startswith(start))
    # the second number of a pair is set to the width of its column
    return found.strip().removeprefix(start).replace("| ", "|").replace("| ", "|").split()


@pytest.fixture(scope="module")
def result(make_stress):
    bad = {("mpc", False, STUCK): (22.4, range(25)), ("mpc", True, STUCK): (6.26, [3, 8])}
    return make_stress(["imc", "mpc"], [STUCK, "late"], bad)


def test_numbers_without_and_with_the_guard_stand_side_by_side(result):
    text = printed(stress_table(result))
    below = text[text.index("\n mpc") :]
    # worse off, mean, worst, below 54, minimum, events, saturated, fallback, suspended
    assert line(below, "stuck") == ["25|2", "2.8|0.8", "22|6.3", "11|3.1", "53|69", "45|13", "12|12", "6.7", "<0.1"]
    assert line(below, "late") == ["0|0", "0|0", "0|0", "0|0", "75|75", "0|0", "12|12", "6.7", "<0.1"]
    words = " ".join(text.split())
    assert "In each pair a|b, a is without the guard and b with it." in words
    assert "people whose time below 60 mg/dl was longer by over 1 % of the run than without the fault" in words


def test_every_controller_has_every_fault(result):
    text = printed(stress_table(result))
    starts = [words.split()[0] for words in text.splitlines() if words.strip()]
    assert starts.count("stuck") == starts.count("late") == starts.count("no") == 2
    assert "imc" in starts
    assert "mpc" in starts


@pytest.mark.parametrize("guards", [(False,), (True,)])
def test_with_one_kind_only_there_are_no_pairs(make_stress, guards):
    text = printed(stress_table(make_stress(["imc"], [STUCK], guards=guards)))
    assert "|" not in text
    assert ("susp." in text) == guards[0]
    assert f"All numbers are {'with' if guards[0] else 'without'} the guard." in text


def test_the_standard_faults_on_a_thousand_people_fit_110_columns(make_stress):
    bad = {("mpc", guarded, fault): (44.4, range(999)) for guarded in (False, True) for fault in STANDARD_FAULTS}
    result = make_stress(["mpc"], STANDARD_FAULTS, bad, change=lambda row: {"people": 1000, "low_events": 2499})
    text = printed(stress_table(result), width=200)
    assert max(len(words.rstrip()) for words in text.splitlines()) <= 110


@pytest.mark.long
def test_a_narrow_terminal_leaves_out_columns_but_cuts_no_number_short(result):
    def numbers(width):
        text = printed(stress_table(result), width)
        below = text[text.index("\n mpc") :]
        return line(below, "stuck"), "left out on the right" in " ".join(text.split())

    whole, left_out = numbers(200)
    assert len(whole) == 9
    assert not left_out
    for width in range(30, 111):
        shown, left_out = numbers(width)
        assert shown == whole[: len(shown)]
        assert left_out == (len(shown) < 9)
    assert shown == whole


def test_where_nobody_took_part_nothing_is_told(make_stress):
    keys = ("controller", "guarded", "fault", "people")
    result = make_stress(["imc"], ["late"], change=lambda row: dict.fromkeys(row.keys() - set(keys)) | {"people": 0})
    text = printed(stress_table(result))
    assert line(text, "late") == ["n/a|n/a"] * 7 + ["n/a", "n/a"]
    assert "nan" not in text
    assert "None" not in text


def test_labels_are_shown_as_they_are(make_stress):
    text = printed(stress_table(make_stress(["[red]wild[/red]"], ["late"])))
    assert "[red]wild[/red]" in text
