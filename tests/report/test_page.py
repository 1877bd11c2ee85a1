"""The page: one file, complete, offline, and safe whatever a label holds."""

import json
import re

import numpy as np
import pytest

from glucoloop.metrics import summarise
from glucoloop.report import interactive_page


def curves(page):
    """What plotly is given to draw."""
    call = re.search(r'Plotly\.newPlot\(\s*"runs",\s*(\[.*?\]),\s*\{', page, re.DOTALL)
    return json.loads(call.group(1))


@pytest.fixture(scope="module")
def page(quiet, noisy):
    return interactive_page(
        {"calm": quiet, "wild": noisy}, {"calm": summarise(quiet), "wild": summarise(noisy)}, title="Two runs"
    )


def test_the_page_is_well_formed_and_says_what_it_is(page, reader):
    read = reader(page)
    assert page.startswith("<!doctype html>")
    assert read.text["title"] == read.text["h1"] == ["Two runs"]
    assert read.text["footer"] == ["Research software, not a medical device."]
    assert ("charset", "utf-8") in read.attributes
    assert "viewport" in dict(read.attributes).values()


def test_the_page_needs_no_network(page, reader):
    read = reader(page)
    assert not {"link", "iframe", "img"} & set(read.tags)
    assert not {"src", "href"} & {name for name, _ in read.attributes}
    assert len(page) > 1_000_000  # plotly itself is inside


def test_the_curves_are_the_runs(page, quiet, noisy):
    drawn = {curve["name"]: curve for curve in curves(page)}
    assert list(drawn)[:4] == [
        "setpoint 80 mg/dl",
        "lowest allowed 60 mg/dl",
        "basal 20 mU/min",
        "pump limits 0 and 66.9 mU/min",
    ]
    np.testing.assert_allclose(drawn["calm"]["y"], quiet.fine_glucose_mg_dl, atol=1e-3)
    np.testing.assert_allclose(drawn["calm"]["customdata"], quiet.fine_glucose_mg_dl / 18.0156, atol=1e-3)
    held = np.append(np.repeat(np.asarray(noisy.insulin_mU_min), 5), noisy.insulin_mU_min[-1])
    np.testing.assert_allclose(drawn["wild, insulin"]["y"], held, atol=1e-3)
    np.testing.assert_allclose(drawn["wild, insulin"]["customdata"], held * 0.06, atol=1e-3)
    assert len(drawn["wild, reading"]["x"]) == 117
    assert "calm, reading" not in drawn
    for unit in ("mg/dl", "mmol/l"):
        assert unit in drawn["calm"]["hovertemplate"]
    for unit in ("mU/min", "U/h"):
        assert unit in drawn["calm, insulin"]["hovertemplate"]


def test_the_metrics_stand_below(page, reader):
    read = reader(page)
    assert page.index("<table>") > page.index("Plotly.newPlot")
    assert "Undershoot" in read.text["th"]
    assert "551+" in read.text["td"]
    assert {"mg/dl", "min", "%", "U", "mU/min"} <= set(read.text["td"])


def test_a_single_run_needs_no_label(noisy, reader):
    page = interactive_page(noisy, summarise(noisy))
    assert [curve["name"] for curve in curves(page)][-3:] == ["glucose", "insulin", "reading"]
    assert "Value" in reader(page).text["th"]


def test_labels_are_shown_as_they_are_and_never_run(quiet, noisy, reader):
    labels = ["<script>alert(1)</script>", "</script><img src=x onerror=alert(1)>"]
    traces = dict(zip(labels, (quiet, noisy), strict=True))
    metrics = {label: summarise(trace) for label, trace in traces.items()}
    title = "</title><script>alert(2)</script> & $plot"
    page = interactive_page(traces, metrics, title=title)
    plain = interactive_page({"a": quiet, "b": noisy}, {"a": metrics[labels[0]], "b": metrics[labels[1]]})
    read = reader(page)
    assert read.tags == reader(plain).tags
    assert "".join(read.text["h1"]) == title
    for label in labels:
        assert label in read.text["th"]
        assert label not in page
        # plotly, too, reads entities, and so shows the label as it is
        assert any(curve["name"] == label.replace("<", "&lt;").replace(">", "&gt;") for curve in curves(page))


def test_a_run_that_left_the_numbers_makes_a_page(make_trace, reader):
    glucose = np.full(601, 80.0)
    glucose[300:] = np.nan
    trace = make_trace(glucose)
    page = interactive_page(trace, summarise(trace))
    shown = next(curve for curve in curves(page) if curve["name"] == "glucose")
    assert shown["y"][299:301] == [80.0, None]
    assert "n/a" in reader(page).text["td"]


@pytest.mark.parametrize(("meals", "expected"), [(3, "50 g<br>▼"), (20, "◀ 50 g"), (100, "▼")])
def test_meals_are_told_as_space_allows(make_trace, meals, expected):
    carbs_g = np.zeros(120)
    carbs_g[:meals] = 50.0
    trace = make_trace(np.full(601, 80.0), carbs_g=carbs_g)
    page = interactive_page(trace, summarise(trace))
    assert page.count(json.dumps(expected).replace("<", "\\u003c").replace(">", "\\u003e")) == meals


@pytest.mark.parametrize("labels", [("a", "c"), ("b", "a"), ("a",)])
def test_metrics_of_other_runs_are_refused(quiet, noisy, labels):
    with pytest.raises(ValueError, match="under the same labels"):
        interactive_page({"a": quiet, "b": noisy}, {label: summarise(quiet) for label in labels})


def test_metrics_of_one_run_do_not_stand_for_several(quiet):
    with pytest.raises(ValueError, match="under the same labels"):
        interactive_page({"glucose": quiet}, summarise(quiet))
