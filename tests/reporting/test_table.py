"""Tables as a person reads them, at a terminal or in a pipe."""

import io

import numpy as np
import pytest
from rich.console import Console

from glucoloop.metrics import summarise
from glucoloop.reporting import comparison_table, metrics_table


def printed(table, width=80):
    out = io.StringIO()
    Console(file=out, width=width).print(table)
    return out.getvalue()


def line(text, start):
    return next(words for words in text.splitlines() if words.strip().startswith(start)).split()


def test_each_metric_has_its_name_value_and_unit(quiet):
    text = printed(metrics_table(summarise(quiet)))
    assert line(text, "Metric") == ["Metric", "Value", "Unit"]
    assert line(text, "Undershoot") == ["Undershoot", "0.0", "mg/dl"]
    assert line(text, "Overshoot") == ["Overshoot", "10.0", "mg/dl"]
    # 10 exp(-((t - 150) / 60)^2) > 1.6 until t = 150 + 60 sqrt(ln(10 / 1.6)) = 231.2
    assert line(text, "Settling, 2 %") == ["Settling,", "2", "%", "band", "182", "min"]
    assert line(text, "Insulin delivered") == ["Insulin", "delivered", f"{5 * (2400 + 300) / 1000:.2f}", "U"]
    assert line(text, "Reading missing") == ["Reading", "missing", "0"]
    assert line(text, "All") == ["All", "three", "yes"]


def test_what_has_not_settled_is_more_than_a_number(noisy):
    text = printed(metrics_table(summarise(noisy)))
    assert line(text, "Settling, 2 %")[-2] == "551+"
    assert line(text, "Settling, 5 %")[-2] == "551+"
    assert line(text, "All") == ["All", "three", "no"]  # the change to the pump's limit is too fast


def test_what_is_not_a_number_is_not_available(make_trace):
    text = printed(metrics_table(summarise(make_trace(np.full(601, np.nan)))))
    assert line(text, "Undershoot")[1] == "n/a"
    assert line(text, "Settling, 2 %")[-2] == "n/a"
    assert "nan" not in text


def test_runs_stand_side_by_side_under_their_labels(quiet, noisy):
    text = printed(comparison_table({"calm": summarise(quiet), "[red]wild[/red]": summarise(noisy)}), width=120)
    assert line(text, "Metric") == ["Metric", "calm", "[red]wild[/red]", "Unit"]
    assert line(text, "Undershoot") == ["Undershoot", "0.0", "15.0", "mg/dl"]
    # 10 exp(-((t - 150) / 60)^2) > 4 until t = 207.4
    assert line(text, "Settling, 5 %")[-3:] == ["158", "551+", "min"]


def test_moments_of_runs_of_days_are_days_and_clocks(make_trace):
    t_min = np.arange(2 * 1440 + 1)
    metrics = summarise(make_trace(100.0 + 10.0 * np.exp(-(((t_min - 2514.0) / 60.0) ** 2)) - 20.0 * (t_min == 600)))
    text = printed(comparison_table({"pid": metrics}, start_min=450.0))
    assert [words.split() for words in text.splitlines() if words.strip().startswith("at ")] == [
        ["at", "600", "min"],
        ["at", "day", "3,", "01:24"],
    ]


def test_a_pipe_gets_plain_text_no_wider_than_it_need_be(quiet):
    text = printed(metrics_table(summarise(quiet)), width=200)
    assert "\x1b" not in text
    assert max(map(len, text.splitlines())) <= 60


def test_a_value_that_rounds_to_nothing_has_no_sign(make_trace):
    text = printed(metrics_table(summarise(make_trace(np.full(601, 80.01)))))
    assert line(text, "Undershoot")[1] == "0.0"


@pytest.mark.parametrize("table", [lambda m: metrics_table(m), lambda m: comparison_table({"a": m})])
def test_many_people_are_refused(make_trace, table):
    with pytest.raises(ValueError, match="not of one"):
        table(summarise(make_trace(np.full((61, 2), 80.0), meal_sample=2)))


def test_nothing_to_show_is_refused():
    with pytest.raises(ValueError, match="no metrics to show"):
        comparison_table({})
