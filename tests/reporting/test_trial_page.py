"""The page of a trial: one file, complete, offline, and safe whatever a label holds."""

import dataclasses
import html
import json
import re

import numpy as np
import pytest

from glucoloop.metrics.control_variability import grid_counts, zone_pct
from glucoloop.studies.trial.page import trial_page
from glucoloop.studies.trial.report import RANGES, MetricDistribution
from glucoloop.text import percent
from glucoloop.units import MG_DL_PER_MMOL_L


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
        "Who was harmed",
        "Headline numbers",
        "Response of the population",
        "Spread of the metrics",
        "Time in range",
        "Control-variability grid",
        "People with the worst outcomes",
        "Situation",
    ]
    assert read.text["footer"] == ["Research software, not a medical device."]
    told = "".join(read.text["p"])
    assert "12\u202f400 virtual people, of whom 3 have no basal rate" in told
    assert "parker2000" in read.text["dd"]
    assert "81.1 mg/dl" in read.text["span"]


def test_the_page_is_small_and_needs_no_network(page, reader):
    reader(page).refuse_loads()
    assert len(page) < 300_000


def test_bands_lie_between_the_percentiles_and_not_beyond(page, report, drawn):
    for figure, case in zip(drawn(page)[:2], report.cases.values(), strict=True):
        glucose = [curve for curve in figure if curve.unit == "mg/dl"]
        assert [curve.name for curve in glucose] == ["90 % of the people", "50 % of the people", "median"]
        for curve, edges in zip(glucose, ((0.05, 0.95), (0.25, 0.75)), strict=False):
            for found, quantile in zip(curve.edges, edges, strict=True):
                np.testing.assert_allclose(found, case.glucose_quantiles[quantile], atol=0.051)
        np.testing.assert_allclose(glucose[2].values, case.glucose_quantiles[0.5], atol=0.051)
        np.testing.assert_allclose(glucose[2].t_min, case.bands_t_min, atol=0.051)
        median = [curve for curve in figure if curve.unit == "mU/min"][-1]
        assert (median.held, median.t_min[-1]) == (True, 1440.0)  # the last rate until the end
        found = median.values[np.searchsorted(median.t_min, case.insulin_t_min, side="right") - 1]
        np.testing.assert_allclose(found, case.insulin_quantiles[0.5], atol=0.0051)


def test_all_controllers_have_the_same_axes(page, plots):
    ranges = [[panel["range"] for panel in plot["panels"]] for plot in plots(page)]
    assert len(ranges) == 4  # bands, and the worst, of two controllers
    assert ranges[0] == ranges[1]
    assert ranges[2] == ranges[3]


def test_meals_and_faults_are_marked(report, plots):
    faults = ["stuck, start_min=60, duration_min=90", "occlusion, start_min=200, latest_min=300, duration_min=60"]
    page = trial_page(dataclasses.replace(report, meals=[(480.0, 70.0), (1440.0, 30.0)], faults=faults))
    assert len(plots(page)) == 4  # bands and the worst, of two controllers
    for plot in plots(page):
        glucose, insulin = plot["panels"]
        assert glucose["marks"] == [[480.0, "70 g"]]  # the other one is after the end
        assert (glucose["spans"], insulin["spans"]) == ([[60.0, 150.0]], [[200.0, 360.0]])


def test_who_was_harmed_is_counted(page, report, reader):
    cells = re.findall(r"<td[^>]*>(.*?)</td>", page)
    for case in report.cases.values():
        number, share = case.ever_below[70]
        assert (f"{number} ({percent(share)})" if number else "nobody") in cells
    assert "Ever below" in "".join(reader(page).text["th"])


def test_the_headline_numbers_stand_with_their_units(page, report, reader):
    read = reader(page)
    assert "Undershoot, median" in read.text["th"]
    assert {"all", "n/a"} <= set(read.text["td"])
    for case in report.cases.values():
        undershoot = case.table["Undershoot, median", "mg/dl"]
        digits = 1 if undershoot >= 10.0 else 2
        assert f"{undershoot:.{digits}f}" in read.text["span"]
        assert f"{undershoot / MG_DL_PER_MMOL_L:.2f}" in read.text["span"]


def test_a_headline_number_has_the_digits_that_tell_it(report, make_case, reader):
    table = {("Whole", ""): 3.0, ("Large", ""): 12.34, ("Small", ""): 1.234, ("Tiny", ""): 0.00123}
    case = dataclasses.replace(make_case(10.0), table=table)
    read = reader(trial_page(dataclasses.replace(report, cases={"one": case})))
    assert {"3", "12.3", "1.23", "0.0012"} <= set(read.text["td"])


def test_metrics_are_shown_in_their_units(page, report):
    assert page.count(">Undershoot</h3>") == page.count(">Insulin delivered</h3>") == 1
    for case in report.cases.values():
        insulin, undershoot = case.metric_counts["insulin_total_mU"], case.metric_counts["undershoot_mg_dl"]
        assert f"<b>{insulin.median / 1000.0:.2f}</b> ({insulin.p5 / 1000.0:.2f} – {insulin.p95 / 1000.0:.2f})" in page
        assert f"<b>{undershoot.median / MG_DL_PER_MMOL_L:.2f}</b>" in page


def test_what_is_zero_for_everybody_has_no_filled_band(report, make_case, plots):
    case = make_case(10.0)
    edges = np.linspace(0.0, 1.0, 61)
    nothing = MetricDistribution(edges, np.histogram(np.zeros(400), edges)[0], 0.0, 0.0, 0.0)
    page = trial_page(
        dataclasses.replace(
            report,
            cases={
                "none": dataclasses.replace(
                    case,
                    metric_counts={"time_below_60_pct": nothing},
                    insulin_quantiles={q: np.zeros_like(v) for q, v in case.insulin_quantiles.items()},
                )
            },
        )
    )
    assert page.count("0 for everybody") == 1
    assert 'class="outline"' not in page
    assert [len(panel["areas"]) for panel in plots(page)[0]["panels"]] == [2, 0]


def test_what_is_the_same_for_everybody_has_no_axis(report, make_case):
    edges = np.linspace(0.0, 1.0, 61)
    same = MetricDistribution(edges, np.histogram(np.full(400, 0.511), edges)[0], 0.511, 0.511, 0.511)
    cases = {"one": dataclasses.replace(make_case(10.0), metric_counts={"undershoot_mg_dl": same})}
    page = trial_page(dataclasses.replace(report, cases=cases))
    assert page.count("the same for everybody") == 1
    assert 'class="outline"' not in page


def test_the_grid_counts_everybody_once(page, report):
    for grid, case in zip(page.split('<div class="cvga">')[1:], report.cases.values(), strict=True):
        drawn = json.loads(re.search(r'<script type="application/json">(.*?)</script>', grid)[1])
        counts = np.zeros_like(case.cvga_counts)
        for across, up, people in drawn["people"]:
            counts[across, up] += people
        np.testing.assert_array_equal(counts, case.cvga_counts)
        for zone, share in zone_pct(case.cvga_counts).items():
            assert f"{zone}<br>{percent(share)}" in grid
            assert f"zone {zone} {html.escape(percent(share))}" in grid  # for who hears it


def test_outlines_are_the_counts_of_the_people(page, report):
    spreads = re.findall(r'<div class="spread"><script type="application/json">(.*?)</script>', page)
    cases = report.cases.values()
    assert len(spreads) == len(next(iter(cases)).metric_counts)
    for text, metric in zip(spreads, next(iter(cases)).metric_counts, strict=True):
        drawn = json.loads(text)
        for outline, case in zip(drawn["outlines"], cases, strict=True):
            part = case.metric_counts[metric]
            assert sum(outline["counts"]) == part.people
            assert len(drawn["edges"]) == len(outline["counts"]) + 1
            assert outline["values"] == sorted(outline["values"])


def test_what_a_low_setpoint_leaves_out_of_reach_is_said(page, report):
    assert "nobody's minimum can be above" in page
    assert "nobody's minimum" not in trial_page(dataclasses.replace(report, setpoint_mg_dl=110.0))


def test_times_in_range_are_as_long_as_they_last(page, report):
    grown = [float(value) for value in re.findall(r"flex-grow: ([\d.e-]+)", page)]
    times = [case.time_in_range_pct[name] for case in report.cases.values() for name in RANGES]
    assert grown == pytest.approx([time for time in times if time > 0.0], rel=1e-5)


def test_the_worst_are_named_and_drawn(page, report, reader, drawn):
    read = reader(page)
    for figure, case in zip(drawn(page)[2:], report.cases.values(), strict=True):
        glucose = [curve for curve in figure if curve.unit == "mg/dl"]
        assert len(glucose) == 10
        assert len(figure) == 20
        for curve, person in zip(glucose, case.worst, strict=True):
            assert str(person.person) in read.text["button"]
            assert curve.about["person"] == person.person
            assert f"{person.minimum_mg_dl:.1f} mg/dl" in read.text["span"]
            assert curve.values.min() == pytest.approx(person.glucose_mg_dl.min(), abs=0.051)
    assert read.text["td"].count("hepatic uptake +38 %") == 20


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


@pytest.mark.parametrize("people", [1, 3, 8, 20])
def test_any_number_of_controllers_makes_a_page(make_report, people, reader, drawn):
    page = trial_page(make_report(*(f"controller {i}" for i in range(people))))
    assert len(drawn(page)) == 2 * people
    assert len(page) < (300_000 if people <= 8 else 450_000)
    reader(page)


def test_a_long_run_is_told_by_week(report, drawn):
    names = ("p5", "p25", "p50", "p75", "p95", "time_70_180_pct", "time_below_70_pct")
    weeks = [dict(zip(names, (70.0 + w, 90.0, 120.0 + w, 150.0, 190.0, 80.0, 3.0), strict=True)) for w in range(5)]
    cases = {label: dataclasses.replace(case, weeks=weeks) for label, case in report.cases.items()}
    page = trial_page(dataclasses.replace(report, cases=cases, length_min=31 * 1440.0))
    assert "Week by week" in page
    assert drawn(page)[0][0].name == "90 % of the people's days"
    curves = {curve.name: curve for curve in drawn(page)[2]}
    assert curves["median"].held
    np.testing.assert_allclose(curves["median"].t_min, 1440.0 * np.array([0, 7, 14, 21, 28, 31]))
    np.testing.assert_allclose(curves["median"].values, 120.0 + np.arange(5), atol=0.051)
    assert set(curves["70 to 180 mg/dl"].values) == {80.0}


def test_a_long_run_is_thinned_and_says_so(report, make_case, drawn):
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
    assert "Not every sample is drawn" in page
    assert max(len(curve.values) for curve in drawn(page)[0]) < 5000
    assert len(page) < 300_000


def test_people_whose_glucose_did_not_stay_finite_are_told(report, page, reader):
    assert "did not stay finite" not in page
    label = next(iter(report.cases))
    lost = dataclasses.replace(report.cases[label], not_finite=17)
    read = reader(trial_page(dataclasses.replace(report, cases={**report.cases, label: lost})))
    assert "Glucose did not stay finite; in no other number" in read.text["th"]
    assert "17" in read.text["td"]


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
