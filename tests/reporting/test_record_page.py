"""The page of records of glucose: one file, offline, with each standard number, and safe whatever a label holds."""

import dataclasses
import datetime as dt
import html
import re

import numpy as np
import pytest

from glucoloop.metrics.readings.catalogue import MEASURES, numbers_of
from glucoloop.metrics.readings.profile import day_profile
from glucoloop.metrics.readings.series import Readings
from glucoloop.reporting.record_groups import GOALS, ReportedRecord
from glucoloop.reporting.record_page import MAX_IN_FULL, record_page
from monitor_records import with_gaps


def record(
    label="Record 1", days=14, seed=2, notes=("Glucose was brought from mmol/l to mg/dl.",), day_0=dt.date(2025, 1, 6)
):
    readings = Readings.of(*with_gaps(days, seed), day_0)
    return ReportedRecord(label, readings, numbers_of(readings), notes)


@pytest.fixture(scope="module")
def one():
    return record()


@pytest.fixture(scope="module")
def page(one):
    return record_page([one], GOALS["adult"])


def words(page):
    """Text of the page, without tags and in mg/dl."""
    body = re.sub(r"<(script|style).*?</\1>", " ", page, flags=re.DOTALL)
    body = re.sub(r'<span class="mmol">.*?</span>', "", body)
    return " ".join(html.unescape(re.sub(r"<[^>]+>", " ", body)).split())


def test_the_page_is_well_formed_and_in_the_order_of_the_profile_that_clinics_know(page, reader):
    read = reader(page)
    assert read.text["h1"] == ["Ambulatory glucose profile"]
    assert read.text["h3"] == ["Glucose statistics and goals", "Time in ranges"]
    assert read.text["h2"] == [
        *("Glucose over the day", "Daily glucose profiles", "Episodes", "Times of day", "What was read", "All metrics")
    ]
    assert read.text["footer"] == ["Research software, not a medical device."]
    read.refuse_loads()
    assert len(page) < 300_000


def test_the_ten_standard_numbers_stand_on_it(page, one):
    text, of = words(page), one.numbers
    assert "Record 1, 2025-01-06 to 2025-01-19" in text
    for number in (
        f"Days {of['days']:.1f} 14 or more ✓",
        f"Time active {of['active_pct']:.1f} % 70 % or more ✓",
        f"Mean glucose {of['mean_mg_dl']:.0f} mg/dl",
        f"Glucose management indicator (GMI) {of['gmi_pct']:.1f} %",
        f"Glucose variability (CV) {of['cv_pct']:.1f} % 36 % or less",
        "Very high: above 250 mg/dl",
        "High: 181 to 250 mg/dl",
        f"Target: 70 to 180 mg/dl {of['time_70_180_pct']:.1f} %",
        "Low: 54 to 69 mg/dl",
        "Very low: below 54 mg/dl",
    ):
        assert number in text, number
    minutes = round(14.4 * of["time_70_180_pct"])
    assert f"{minutes // 60} h {minutes % 60} min more than 70 %" in text


def test_the_bar_has_all_readings(page, one):
    bar = re.search(r'class="agp-bar".*?</div>', page)[0]
    shares = [float(share) for share in re.findall(r"flex-grow: ([\d.e-]+)", bar)]
    assert sum(shares) == pytest.approx(100.0, abs=1e-3)
    assert one.numbers["time_70_180_pct"] == pytest.approx(max(shares), abs=1e-3)


def test_curves_are_the_percentiles(page, one, drawn):
    [curves] = drawn(page)
    profile = day_profile(one.readings)
    found = {curve.name: curve for curve in curves}
    assert list(found) == ["5 to 95 %", "25 to 75 %", "median"]
    for name, edges in (("5 to 95 %", (5, 95)), ("25 to 75 %", (25, 75)), ("median", (50,))):
        np.testing.assert_allclose(found[name].t_min, profile.t_min)
        for values, percentage in zip(found[name].edges, edges, strict=True):
            np.testing.assert_allclose(values, profile.percentiles_mg_dl[percentage], atol=0.051)


def test_a_short_record_is_shown_with_what_the_consensus_asks_for():
    text = words(record_page([record(days=3)], GOALS["adult"]))
    assert re.search(
        r"Record 1 has 3\.0 days with [\d.]+ % of the readings\. The consensus asks for at least 14 days", text
    )
    assert "14 or more ✗" in text
    assert "All metrics" in text
    assert "The consensus asks" not in words(record_page([record()], GOALS["adult"]))


def test_several_stand_side_by_side():
    text = words(record_page([record("before", seed=3), record("after", seed=4)], GOALS["adult"]))
    assert text.index("Side by side") < text.index("before, 2025-01-06") < text.index("after, 2025-01-06")
    assert text.count("Daily glucose profiles") == 2
    assert "Metric before after Difference Unit" in text


def test_of_many_there_is_a_row_each():
    short = record(days=2, notes=())
    many = [dataclasses.replace(short, label=f"person {number}") for number in range(MAX_IN_FULL + 1)]
    page = record_page(many, GOALS["adult"])
    assert "Daily glucose profiles" not in page
    assert re.findall(r"person \d", words(page))[-7:] == [one.label for one in many]
    assert "7 of 7 records are shorter" in words(page)


def test_groups_have_the_spread_of_each_number_over_their_people():
    people = [
        dataclasses.replace(record(f"{group} {number}", days=2, seed=number + place), group=group)
        for place, group in enumerate(("before", "after"))
        for number in range(5)
    ]
    page = record_page(people, GOALS["older"])
    text = words(page)
    for head in ("before, 5 people", "after, 5 people"):
        assert head in text
    means = [one.numbers["mean_mg_dl"] for one in people[:5]]
    low, median, high = np.percentile(means, [25, 50, 75])
    assert f"Mean glucose (mg/dl) {np.mean(means):.0f} {median:.0f} ({low:.0f} to {high:.0f})" in text
    reached = 20 * sum(one.numbers["time_below_70_pct"] < 1.0 for one in people[:5])
    assert re.search(rf"All below 70 mg/dl [^a-z]*to [^a-z]* less than 1\s% {reached} %", text)
    assert text.count("Percentiles every hour") == 2
    assert re.search(r"before 3 \d\.\d ", text)  # its row
    of_all = day_profile(*(one.readings for one in people[:5]))
    values = np.concatenate([one.readings.glucose_mg_dl for one in people[:5]])
    times = np.concatenate([one.readings.time_of_day_min for one in people[:5]])
    assert of_all.percentiles_mg_dl[75][40] == np.percentile(values[(times >= 585) & (times < 615)], 75)


def test_goals_of_pregnancy_have_their_ranges():
    text = words(record_page([record()], GOALS["pregnancy"]))
    assert "Target: 63 to 140 mg/dl" in text
    assert "Very high" not in text
    for goals in GOALS.values():
        results = {result.name for measure in MEASURES for result in measure.results}
        assert {one.result for one in goals.ranges} | set(goals.goals) <= results


@pytest.mark.parametrize("hostile", ["<script>alert(1)</script>", "</script><b>", '" onclick="x', "{{ 7 * 7 }}"])
def test_a_label_is_shown_as_it_is(hostile, reader):
    page = record_page([record(hostile, days=2, notes=(hostile,)), record(days=2)], GOALS["adult"])
    reader(page).refuse_loads()
    assert hostile not in page.replace("{{ 7 * 7 }}", "")
    assert words(page).count(" ".join(hostile.split())) > 2


def test_a_simulated_course_has_days_in_place_of_dates():
    text = words(record_page([record(day_0=None, days=2)], GOALS["adult"]))
    assert "Record 1, day 1 to day 2" in text
