"""The page of a stress test: one file, complete, offline, without a script, and safe whatever a label holds."""

import re

import pytest

from glucoloop.faults import FAULTS
from glucoloop.reporting.columns import headings
from glucoloop.reporting.heat import SHADES_PCT as SHADES
from glucoloop.studies.stress import STANDARD_FAULTS
from glucoloop.studies.stress.study import COLUMNS

STUCK, SPIKES = "stuck, start_min=60, duration_min=90", "spikes, per_day=12, size_mg_dl=60"


@pytest.fixture(scope="module")
def result(make_stress):
    bad = {
        ("imc", False, SPIKES): (0.5, ()),
        ("mpc", False, STUCK): (22.4, range(30)),
        ("mpc", True, STUCK): (6.26, [3, 8]),
        ("mpc", True, SPIKES): (11.1, range(30)),
    }
    return make_stress(["imc", "mpc"], [STUCK, SPIKES], bad)


@pytest.fixture(scope="module")
def page(result, stress_page):
    return stress_page(result)


def rows_of(page, kind):
    """Cells of each row of the tables of a kind."""
    tables = re.findall(rf'<table class="{kind}".*?</table>' if kind else r"<table.*?</table>", page, re.DOTALL)
    return [re.findall(r"<t[hd].*?</t[hd]>", row, re.DOTALL) for table in tables for row in table.split("<tr>")]


def test_the_page_is_well_formed_and_says_what_it_is(page, reader):
    read = reader(page)
    assert page.startswith("<!doctype html>")
    assert read.text["title"] == read.text["h1"] == ["Stress test"]
    assert read.text["h2"] == [
        "Conclusions",
        "Longest time of any person below ",
        "Who was worse off, and why",
        "All numbers",
        "The faults",
        "Situation",
    ]
    assert '<h2>Longest time of any person below <span class="mg">60 mg/dl</span>' in page
    assert read.text["footer"] == ["Research software, not a medical device."]
    assert "glucoloop stress --config stress.toml --out again" in read.text["code"]
    assert {"parker2000", "1"} <= set(read.text["dd"])
    told = " ".join(read.text["p"])
    assert "2 controllers, without the guard and with the guard, under 2 faults, one at a time, on the same 40" in told
    assert "With the guard, 2 of 4 combinations of a controller and a fault passed" in told


def test_the_page_needs_neither_network_nor_script(page, reader):
    read = reader(page)
    read.refuse_loads()
    assert "script" not in read.tags
    assert len(page) < 60_000


def test_the_map_shows_each_cell_with_its_number_and_its_shade(page):
    body = rows_of(page, "heat")[-2]
    assert "stuck" in body[0]
    without_imc, without_mpc, _, with_imc, with_mpc = body[1:]
    assert re.search(r'class="none"[^>]*>0</td>', without_imc)
    assert "22.4<small>▲30</small>" in without_mpc
    assert SHADES[5].colour in without_mpc
    assert re.search(r'class="none"[^>]*>0</td>', with_imc)
    assert "6.3<small>▲2</small>" in with_mpc
    assert SHADES[3].colour in with_mpc
    last = rows_of(page, "heat")[-1]
    assert SHADES[1].colour in last[1]
    assert ">0.50</td>" in last[1]


def test_pointing_at_a_cell_tells_all_its_numbers(page, result):
    hovers = re.findall(r'<td [^>]*title="([^"]*)"', page)
    assert len(hovers) == len(result.rows)
    hover = next(text for text in hovers if text.startswith("mpc, stuck, with the guard"))
    assert "Time below 60 mg/dl (%): mean 0.78, longest 6.3" in hover
    assert (
        "Samples (%): saturated 12.5, missing 0, rejected 1.0, fallback 6.7, suspended &lt; 0.01, limited 0.25" in hover
    )
    assert "Worse off: people 2, most (%) 6.3" in hover
    assert all(column.head in hover for column in COLUMNS)


def test_the_tables_hold_every_number_of_every_cell(page, result):
    by_controller = re.findall(r"<h3>(.*?)</h3>(.*?)</table>", page, re.DOTALL)
    assert [name for name, _ in by_controller] == ["imc", "mpc"]
    told = []
    for controller, table in by_controller:
        for body in re.findall(r"<tbody>(.*?)</tbody>", table, re.DOTALL):
            for line in body.split("</tr>")[:-1]:
                cells = [
                    re.sub(r'<span class="mg">(.*?)</span><span class="mmol">.*?</span>', r"\1", cell)
                    for cell in re.findall(r"<td.*?>(.*?)</td>", line)
                ]
                told.append((controller, cells[0] == "with", cells[1:]))
    # faults before guards
    faults = list(dict.fromkeys(row["fault"] for row in result.rows))
    expected = sorted(result.rows, key=lambda row: (row["controller"], faults.index(row["fault"])))
    columns = [column for _, own in headings(COLUMNS) for column in own]
    assert len(told) == len(expected) == 12
    for (controller, guarded, cells), row in zip(told, expected, strict=True):
        assert (controller, guarded) == (row["controller"], row["guarded"])
        assert cells == [column.value_text(row).replace("<", "&lt;") for column in columns]


def test_for_whom_and_why_the_worst_first(page, reader):
    read = reader(page)
    names = re.findall(r"<dt>(\w+)<span>(.*?)</span></dt>", page)
    assert names == [("mpc", "spikes"), ("mpc", "stuck")]
    told = read.text["p"]
    assert told.count("Person 0: He ate <nothing> & fell.") == 1
    assert "2 of 40 people worse off, by at most 6.3 % of the run: 3, 8" in told
    assert (
        "30 of 40 people worse off, by at most 11.1 % of the run: " + ", ".join(map(str, range(20))) + " and 10 more"
        in told
    )


def test_where_all_pass_nobody_asks_why(make_stress, stress_page, reader):
    read = reader(stress_page(make_stress(["imc"], [STUCK])))
    assert "Who was worse off, and why" not in read.text["h2"]


def test_each_fault_is_told_in_words(page, reader, make_stress, stress_page):
    cells = reader(page).text["td"]
    assert FAULTS["stuck"].summary in cells
    assert "from 60 min, for 90 min" in cells
    assert "size 60 mg/dl" in cells
    standard = reader(stress_page(make_stress(["imc"], STANDARD_FAULTS))).text["td"]
    assert {FAULTS[text.split(",")[0]].summary for text in STANDARD_FAULTS} <= set(standard)


@pytest.mark.parametrize("guards", [(False,), (True,)])
def test_with_one_kind_only_there_is_one_map(make_stress, stress_page, reader, guards):
    page = stress_page(make_stress(["imc"], [STUCK], {("imc", guards[0], STUCK): (9.0, [1])}, guards=guards))
    read = reader(page)
    assert page.count("▲1</small>") == 1
    assert ("With the guard" in read.text["th"], "Without the guard" in read.text["th"]) == (guards[0], not guards[0])
    assert ("Who was worse off, and why" in read.text["h2"]) == guards[0]


def test_labels_are_shown_as_they_are_and_never_run(make_stress, stress_page, reader):
    labels = ["<script>alert(1)</script>", '"><img src=x onerror=alert(1)>']
    bad = {(labels[0], True, STUCK): (9.0, [1])}
    page = stress_page(make_stress(labels, [STUCK], bad, facts={"<b>": "<i>"}))
    plain = stress_page(make_stress(["a", "b"], [STUCK], {("a", True, STUCK): (9.0, [1])}, facts={"c": "d"}))
    read = reader(page)
    assert read.tags == reader(plain).tags
    for label in labels:
        assert label in read.text["th"]
        assert label in read.text["h3"]
        assert label not in page
