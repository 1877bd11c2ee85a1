"""The page of a trial: one file, complete, offline, and safe whatever a label holds."""

import dataclasses
import json
import re

import numpy as np
import pytest

from glucoloop.metrics.control_variability import grid_counts, zone_pct
from glucoloop.report import trial_page
from glucoloop.report._trial_panels import percent
from glucoloop.report.trial_report import RANGES


def plots(page):
    """What plotly is given to draw, in order."""
    return [json.loads(found) for found in re.findall(r'Plotly\.newPlot\(\s*"plot-\d+",\s*(\[.*?\]),\s*\{', page)]


@pytest.fixture(scope="module")
def report(make_report):
    return make_report("calm", "wild")


@pytest.fixture(scope="module")
def page(report):
    return trial_page(report)


def test_the_page_is_well_formed_and_says_what_it_is(page, reader):
    read = reader(page)
    assert page.startswith("<!doctype html>")
    assert read.text["title"] == read.text["h1"] == ["Trial of two"]
    assert read.text["h2"] == [
        "Headline numbers",
        "Response of the population",
        "Spread of the metrics",
        "Time in range",
        "Control-variability grid",
        "People with the worst outcomes",
    ]
    assert read.text["footer"] == ["Research software, not a medical device."]
    told = "".join(read.text["p"])
    assert "12\u202f400 virtual people, of whom 3 have no basal rate" in told
    assert {"parker2000", "81.1 mg/dl"} <= set(read.text["dd"])


def test_the_page_needs_no_network_and_holds_plotly_once(page, reader):
    read = reader(page)
    assert not {"link", "iframe", "img"} & set(read.tags)
    assert not {"src", "href"} & {name for name, _ in read.attributes}
    assert page.count("plotly.js v") == 1
    assert 1_000_000 < len(page) < 6_000_000


def test_bands_lie_between_the_quantiles(page, report):
    bands = plots(page)[:2]
    for drawn, case in zip(bands, report.cases.values(), strict=True):
        glucose = [curve for curve in drawn if curve.get("yaxis") == "y"]
        assert [curve.get("fill") for curve in glucose] == [None, "tonexty"] * 3 + [None]
        for curve, quantile in zip(glucose, (0.01, 0.99, 0.05, 0.95, 0.25, 0.75, 0.5), strict=True):
            np.testing.assert_allclose(curve["y"], case.glucose_quantiles[quantile], atol=0.051)
        assert (glucose[0]["x0"], glucose[0]["dx"]) == (0.0, pytest.approx(5.0 / 60.0))
        insulin = [curve for curve in drawn if curve.get("yaxis") == "y2"]
        assert len(insulin[-1]["y"]) == 289  # the last rate until the end
        assert insulin[-1]["y"][-1] == insulin[-1]["y"][-2]


def test_all_controllers_have_the_same_axes(page):
    ranges = re.findall(r'"range":\[([-\d.,e]+)\],"nticks":6', page)
    assert len(ranges) == 4  # bands, and the worst
    assert ranges[0] == ranges[1]
    assert ranges[2] == ranges[3]


def test_the_headline_numbers_stand_with_their_units(page, report, reader):
    read = reader(page)
    assert "Undershoot, median" in read.text["th"]
    assert {"mg/dl", "all", "n/a"} <= set(read.text["td"])
    for case in report.cases.values():
        assert f"{case.table['Undershoot, median (mg/dl)']:.2f}" in read.text["td"]


def test_metrics_are_shown_in_their_units(page, report):
    assert page.count(">Undershoot</h3>") == page.count(">Insulin delivered</h3>") == 1
    dots = [curve for curve in plots(page)[3] if curve.get("marker", {}).get("size") == 9]
    assert [dot["x"][0] for dot in dots] == pytest.approx(
        [case.metric_counts["insulin_total_mU"].median / 1000.0 for case in report.cases.values()]
    )


def test_the_grid_shows_everybody_once(page, report):
    for (people,), case in zip(plots(page)[4:6], report.cases.values(), strict=True):
        strength = np.array([[np.nan if z is None else z for z in line] for line in people["z"]])
        assert np.nansum(10.0**strength) == pytest.approx(case.cvga_counts.sum(), rel=1e-2)
        column, row = np.nonzero(case.cvga_counts)
        assert people["x0"] == column.min() + 0.5
        assert people["y0"] == row.min() + 0.5
        for zone, share in zone_pct(case.cvga_counts).items():
            assert f"{zone}<br>{percent(share)}" in page


def test_what_a_low_setpoint_leaves_out_of_reach_is_said(page, report):
    assert "nobody's minimum can be above 90 mg/dl" in page
    assert "nobody's minimum" not in trial_page(dataclasses.replace(report, setpoint_mg_dl=110.0))


def test_times_in_range_are_as_long_as_they_last(page, report):
    grown = [float(value) for value in re.findall(r"flex-grow: ([\d.e-]+)", page)]
    times = [case.time_in_range_pct[name] for case in report.cases.values() for name in RANGES]
    assert grown == pytest.approx([time for time in times if time > 0.0], rel=1e-5)


def test_the_worst_are_named_and_drawn(page, report, reader):
    cells = reader(page).text["td"]
    for drawn, case in zip(plots(page)[6:8], report.cases.values(), strict=True):
        assert len(drawn) == 2 * 10 + 2
        for place, person in enumerate(case.worst):
            assert str(person.person) in cells
            assert f"{person.minimum_mg_dl:.1f}" in cells
            np.testing.assert_allclose(drawn[2 * place]["y"], person.glucose_mg_dl, atol=0.051)
    assert cells.count("hepatic uptake +38 %") == 20


def test_labels_are_shown_as_they_are_and_never_run(make_report, reader):
    labels = ["<script>alert(1)</script>", "</script><img src=x onerror=alert(1)>"]
    title = "</title><script>alert(2)</script> & $plot"
    page = trial_page(make_report(*labels, title=title, facts={"<b>": "<i>"}))
    plain = trial_page(make_report("a", "b", facts={"c": "d"}))
    read = reader(page)
    assert read.tags == reader(plain).tags
    assert "".join(read.text["h1"]) == title
    for label in labels:
        assert label in read.text["th"]
        assert label in read.text["h3"]
        assert label not in page


@pytest.mark.parametrize("people", [1, 3, 6, 8])
def test_any_number_of_controllers_makes_a_page(make_report, people, reader):
    page = trial_page(make_report(*(f"controller {i}" for i in range(people))))
    assert len(plots(page)) == 3 * people + 2
    reader(page)


def test_a_long_run_is_thinned_and_says_so(report, make_case):
    case = make_case(10.0)
    days = 14
    t_min = np.arange(0.0, days * 1440.0 + 1.0, 5.0)
    tiled = {q: np.append(np.tile(v[:-1], days), v[-1]) for q, v in case.glucose_quantiles.items()}
    long = dataclasses.replace(
        case,
        bands_t_min=t_min,
        glucose_quantiles=tiled,
        insulin_t_min=t_min[:-1],
        insulin_quantiles={q: np.tile(v, days) for q, v in case.insulin_quantiles.items()},
    )
    page = trial_page(dataclasses.replace(report, cases={"long": long}))
    assert "not every sample is drawn" in page
    assert max(len(curve["y"]) for curve in plots(page)[0]) <= 500


def test_a_trial_in_which_nobody_could_be_tried_makes_a_page(report, make_case, reader):
    case = make_case(10.0)
    empty = dataclasses.replace(
        case,
        glucose_quantiles={q: np.full_like(v, np.nan) for q, v in case.glucose_quantiles.items()},
        insulin_quantiles={q: np.full_like(v, np.nan) for q, v in case.insulin_quantiles.items()},
        metric_counts={
            name: dataclasses.replace(part, counts=np.zeros_like(part.counts), p5=np.nan, median=np.nan, p95=np.nan)
            for name, part in case.metric_counts.items()
        },
        cvga_counts=grid_counts([], []),
        time_in_range_pct=dict.fromkeys(RANGES, np.nan),
        worst=[],
    )
    page = trial_page(dataclasses.replace(report, infeasible=report.people, cases={"none": empty}))
    assert "n/a" in page
    reader(page)


@pytest.mark.parametrize(
    ("share", "text"),
    [
        (0.0, "0 %"),
        (0.001, "< 0.01 %"),
        (0.5, "0.50 %"),
        (12.34, "12.3 %"),
        (99.46, "99.46 %"),
        (99.999, "> 99.99 %"),
        (100.0, "100 %"),
        (np.nan, "n/a"),
    ],
)
def test_few_are_never_told_as_none(share, text):
    assert percent(share).replace("\u00a0", " ") == text
