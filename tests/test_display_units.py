"""Units of what is shown: words, headings and numbers, and no other text."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

import glucoloop as gl
from glucoloop.display_units import (
    heading_shown,
    in_both_units,
    in_shown_units,
    other_number,
    rates_as_pumps_show,
    showing,
    shown_unit,
)
from glucoloop.reporting import _style
from glucoloop.reporting.columns import Column, MetricRow, lines_table, terminal_table
from glucoloop.units import MG_DL_PER_MMOL_L


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("The lowest glucose was 81.1 mg/dl.", "The lowest glucose was 4.50 mmol/l."),
        ("from 70 to 180 mg/dl for 50 min", "from 3.9 to 10.0 mmol/l for 50 min"),
        ("below 60 or 54 mg/dl", "below 3.3 or 3.0 mmol/l"),
        ("basal rate 6.73 mU/min, 180 mg/dl", "basal rate 0.404 U/h, 10.0 mmol/l"),
        ("the basal rate is 6.73 mU/min (0.4038 U/h).", "the basal rate is 0.4038 U/h."),
        ("0 to 500 mU/min (0 to 30 U/h)", "0 to 30 U/h"),
        ("noise of variance 1.45 (mg/dl)²", "noise of variance 1.45 (mg/dl)²"),
        ("gain -2.6 mg/dl per mU/min, 1e-05 mg/dl", "gain -2.6 mg/dl per mU/min, 1e-05 mg/dl"),
        ("a drift of 3 mg/dl per h, 5 mg/dl/h", "a drift of 0.167 mmol/l per h, 0.278 mmol/l/h"),
        ("case.70 mg/dl", "case.70 mg/dl"),
    ],
)
def test_words_are_told_in_the_units_that_are_shown(text, shown):
    assert in_shown_units(text) == text
    with showing("mmol/l, U/h"):
        assert in_shown_units(text) == shown
    assert "".join(same for _, same, _ in in_both_units(text)) == text


@given(st.text(alphabet="0123456789 .e-mgdl/Uin²()"))
def test_a_text_in_the_own_units_is_the_same(text):
    with showing("mg/dl,mU/min"):
        assert in_shown_units(text) == text


@given(st.floats(0.0, 1e4))
def test_a_number_is_as_exact_in_the_other_unit(value):
    assert float(other_number(f"{value:.1f}", value, "mg/dl")) == pytest.approx(value / MG_DL_PER_MMOL_L, abs=0.005001)
    assert other_number("not valid", value, "mg/dl") == "not valid"
    assert other_number("12+", None, "mg/dl") == "0.7+"


def test_one_quantity_can_be_chosen_alone_and_a_block_ends():
    with showing("U/h"):
        assert (shown_unit("mU/min"), shown_unit("mg/dl"), shown_unit("g")) == ("U/h", "mg/dl", "g")
        with showing("mmol/l"):
            assert (shown_unit("mU/min"), shown_unit("mg/dl")) == ("mU/min", "mmol/l")
        assert heading_shown("Insulin\n(mU/min)") == "Insulin\n(U/h)"
        assert heading_shown("Response (mg/dl per mU/min)") == "Response (mg/dl per mU/min)"
    with showing("mmol/l"):
        assert heading_shown("Errors (mg/dl)²") == "Errors (mg/dl)²"
    assert shown_unit("mU/min") == "mU/min"


@pytest.mark.parametrize("units", ["", "mmol", "mg/dl, mmol/l", "U/h, U/h", "mmol/l;U/h"])
def test_what_is_no_choice_of_units_is_refused(units):
    with pytest.raises(gl.Refusal, match=r"cannot be shown in|names two units"), showing(units):
        pass


def printed(table):
    console = Console(width=120)
    with console.capture() as captured:
        console.print(table)
    return captured.get()


def test_tables_are_in_the_units_that_are_shown():
    column = Column(name="lowest_mg_dl", short="lowest\nmg/dl", text="{:.1f}".format)
    rows = [MetricRow("", "Time below 70 mg/dl", "%", ["5"]), MetricRow("", "Least", "mg/dl", ["81.1"], ["4.50"])]
    with showing("mmol/l"):
        numbers = printed(terminal_table("Case", [("", [("a", [{"lowest_mg_dl": 99.0858}])])], [column]))
        lines = printed(lines_table("Metric", ["a"], rows))
    assert "mmol/l" in numbers
    assert "5.50" in numbers
    assert "Time below 3.9 mmol/l" in lines
    assert "4.50" in lines
    assert "mg/dl" not in numbers + lines


def test_a_figure_has_round_ticks_in_the_unit_that_is_shown():
    with showing("mmol/l"):
        figure = _style.new_figure("single", 60.0, None)
    axes = figure.subplots()
    axes.plot([0.0, 1.0], [60.0, 200.0])
    axes.set_ylabel("Glucose (mg/dl)")
    axes.axhline(70.0)
    axes.text(0.5, 70.0, "70 mg/dl")
    figure.draw_without_rendering()
    figure.draw_without_rendering()  # nothing is converted twice
    assert axes.get_ylabel() == "Glucose (mmol/l)"
    assert axes.texts[0].get_text() == "3.9 mmol/l"
    ticks = axes.get_yticks() / MG_DL_PER_MMOL_L
    np.testing.assert_allclose(ticks, np.round(ticks, 3), atol=1e-9)
    assert [label.get_text() for label in axes.get_yticklabels()] == [f"{tick:.6g}" for tick in ticks]


def test_a_difference_keeps_its_sign():
    texts = [other_number(f"{value:+.1f}", value, "mg/dl") for value in (18.0182, -9.0091, 0.0)]
    assert texts == ["+1.00", "-0.50", "+0.00"]


@pytest.mark.parametrize(
    ("chosen", "subcutaneous", "shown"),
    [
        ("mg/dl", True, ("mg/dl", "U/h")),
        ("mmol/l", True, ("mmol/l", "U/h")),
        ("mg/dl", False, ("mg/dl", "mU/min")),
        ("mmol/l,mU/min", True, ("mmol/l", "mU/min")),
    ],
)
def test_rates_are_as_pumps_show_them_unless_a_unit_was_chosen(chosen, subcutaneous, shown):
    with showing(chosen):
        with rates_as_pumps_show(subcutaneous):
            assert (shown_unit("mg/dl"), shown_unit("mU/min")) == shown
        assert shown_unit("mU/min") == "mU/min"
