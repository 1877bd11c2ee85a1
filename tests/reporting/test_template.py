"""Pages from templates: complete, safe whatever a value holds, and refused where a value is missing."""

import base64
import hashlib
import re

import jinja2
import pytest

from glucoloop.reporting import Repeat
from glucoloop.reporting.columns import Column, whole
from glucoloop.reporting.heat import HeatCell, HeatMap, legend_shades, shade_of
from glucoloop.reporting.template import render


@pytest.fixture
def make_page(tmp_path):
    """A function that renders a template with a body."""

    def make(body="", title="Study", **values):
        place = tmp_path / "page.html"
        head = '{% extends "base.html" %}{% import "parts.html" as parts %}{% block body %}'
        place.write_text(head + body + "{% endblock %}")
        return render(place, title, **values)

    return make


def test_every_value_is_escaped(make_page, reader):
    hostile = "</title><script>alert(1)</script> & {{ 7 * 7 }}"
    repeat = Repeat(f"stress {hostile}", {"controller": hostile}, {"a.csv": hostile})
    values = {"facts": {hostile: hostile}, "repeat": repeat, "sentences": [hostile]}
    page, plain = make_page(title=hostile, **values), make_page(facts={"a": "b"}, repeat=repeat, sentences=["c"])
    read = reader(page)
    assert read.tags == reader(plain).tags
    assert "".join(read.text["h1"]) == "".join(read.text["title"]) == hostile
    assert {hostile} <= {*read.text["dt"], *read.text["dd"], *read.text["p"]}
    assert "<script" not in page
    read.refuse_loads()


def test_a_value_that_is_missing_is_refused(make_page):
    with pytest.raises(jinja2.UndefinedError, match="'nothing' is undefined"):
        make_page("{{ nothing }}")


def test_glucose_can_be_shown_in_either_unit(make_page):
    page = make_page(facts={"Setpoint": "81.1 mg/dl, 70 to 180 mg/dl, 3 mg/dl/h, 1.45 (mg/dl)²"})
    assert '<span class="mg">81.1 mg/dl</span><span class="mmol">4.50 mmol/l</span>' in page
    assert (
        '<span class="mg">70 to 180 mg/dl</span><span class="mmol">3.9 to 10.0 mmol/l</span>, '
        '<span class="mg">3 mg/dl</span><span class="mmol">0.167 mmol/l</span>/h, 1.45 (mg/dl)²' in page
    )


def test_a_page_runs_only_its_own_script(make_page):
    assert "script-src 'none'" in make_page()
    page = make_page(script=True)
    code = re.search(r"<script>(.*?)</script>", page, re.DOTALL)[1]
    assert f"script-src 'sha256-{base64.b64encode(hashlib.sha256(code.encode()).digest()).decode()}'" in page


def test_a_page_has_only_its_own_style_sheet(make_page):
    page = make_page()
    [style] = re.findall(r"<style>(.*?)</style>", page, re.DOTALL)
    assert f"style-src-elem 'sha256-{base64.b64encode(hashlib.sha256(style.encode()).digest()).decode()}'" in page


def test_a_table_of_columns_has_a_heading_for_each_number(make_page, reader):
    columns = (
        Column(name="people", head="people", group="Who", text=whole),
        Column(name="hidden"),
        Column(name="low", head="low", group="Glucose", strong=lambda row: row["low"] is not None),
    )
    bodies = [("mpc", [("without", {"people": 3, "low": 2.5}), ("with", {"people": 3, "low": None})])]
    page = make_page('{{ parts.numbers(("Name", "Guard"), bodies, columns) }}', bodies=bodies, columns=columns)
    read = reader(page)
    assert read.text["th"] == ["Name", "Guard", "Who", "Glucose", "people", "low", "mpc"]
    assert read.text["td"] == ["without", "3", "2.5", "with", "3", "n/a"]
    assert page.count(" strong") == 1
    alone = make_page('{{ parts.numbers(["Name"], bodies, columns) }}', bodies=bodies, columns=columns[:1])
    assert "rowspan" in alone


def test_a_map_shows_its_cells_in_their_shades(make_page, reader):
    def cell(row, column):
        value = {"a": 0.0, "b": 30.0}.get(row)
        return HeatCell(shade_of(value), f"{row}{column}", "▲2" if row == "b" else "", f"over {row}")

    maps = [HeatMap("Left", ("a", "b", "c"), ("x",), cell), HeatMap("Right", ("a", "b", "c"), ("x",), cell)]
    body = '{{ parts.heat_maps("A map", "Row", maps, shades) }}'
    read = reader(make_page(body, maps=maps, shades=legend_shades(maps)))
    assert [text for text in read.text["td"] if text] == ["ax", "ax", "bx", "bx", "cx", "cx"]
    assert read.text["small"] == ["▲2", "▲2"]
    assert read.text["th"] == ["Row", "Left", "Right", "x", "x", "a", "b", "c"]
    assert "n/a" in read.text["span"]
