"""The page: one file, complete, offline, and safe whatever a label holds."""

import base64
import hashlib
import html
import re

import numpy as np
import pytest

from glucoloop.control import Status
from glucoloop.display_units import showing
from glucoloop.metrics import summarise
from glucoloop.reporting import Repeat, interactive_page
from glucoloop.reporting.columns import metric_rows
from glucoloop.units import MG_DL_PER_MMOL_L

FAULT = "occlusion, start_min=200, duration_min=60, open_fraction=0, noticed=false"


def shown(text):
    """Text of HTML in mg/dl, without its tags."""
    return re.sub(r"<[^>]*>", "", re.sub(r'<span class="(?:mmol|uh)">[^<]*</span>', "", text))


@pytest.fixture(scope="module")
def page(quiet, noisy):
    return interactive_page(
        {"calm": quiet, "wild": noisy}, {"calm": summarise(quiet), "wild": summarise(noisy)}, title="Two runs"
    )


def test_the_page_is_well_formed_and_says_what_it_is(page, reader):
    read = reader(page)
    assert page.startswith("<!doctype html>")
    assert read.text["title"] == read.text["h1"] == ["Two runs"]
    assert read.text["h2"] == ["Summary", "What happened", "Metrics", "Numbers of the picture"]
    assert read.text["footer"] == ["Research software, not a medical device."]
    assert ("charset", "utf-8") in read.attributes
    assert ("name", "viewport") in read.attributes


def test_the_page_is_small_and_needs_no_network(page, reader):
    reader(page).refuse_loads()
    assert len(page) < 80_000


def test_only_the_script_of_the_page_may_run(page):
    script = page.partition("<script>")[2].partition("</script>")[0]
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    assert f"script-src 'sha256-{digest}'" in page


def test_the_unit_is_that_of_the_command(quiet):
    with showing("mmol/l"):
        shown = interactive_page(quiet, summarise(quiet))
    assert 'id="unit-mmol" checked' in shown
    assert 'id="unit-mg">' in shown
    assert 'id="unit-mu" checked' in shown


def test_the_pictures_are_in_the_unit_that_is_shown(quiet, page, plots):
    with showing("mmol/l, U/h"):
        shown = interactive_page(quiet, summarise(quiet))
    for was, panel, factor in zip(
        plots(interactive_page(quiet, summarise(quiet)))[0]["panels"],
        plots(shown)[0]["panels"],
        (1.0 / MG_DL_PER_MMOL_L, 0.06),
        strict=True,
    ):
        assert (panel["unit"], panel["other"]) == (was["other"], was["unit"])
        assert panel["factor"] == pytest.approx(1.0 / factor)
        assert panel["step"] == pytest.approx(factor * was["step"])
        assert panel["range"] == pytest.approx([factor * end for end in was["range"]])
        assert [line["y"] for line in panel["lines"]] == [line["y"] for line in was["lines"]]


def test_the_curves_are_the_runs(page, quiet, noisy, drawn, plots):
    (figure,) = drawn(page)
    curves = {curve.name: curve for curve in figure}
    assert list(curves) == ["calm, glucose", "wild, glucose", "calm, delivered", "wild, delivered"]
    calm, wild = curves["calm, glucose"], curves["wild, delivered"]
    np.testing.assert_allclose(calm.t_min, quiet.fine_t_min)
    np.testing.assert_allclose(calm.values, quiet.fine_glucose_mg_dl, atol=0.051)
    held = wild.values[np.searchsorted(wild.t_min, np.asarray(noisy.t_min), side="right") - 1]
    np.testing.assert_allclose(held, noisy.insulin_mU_min, atol=0.0051)
    assert (wild.held, wild.t_min[-1]) == (True, 600.0)
    assert (calm.unit, wild.unit) == ("mg/dl", "mU/min")
    dots = [dots for panel in plots(page)[0]["panels"] for dots in panel["dots"]]
    assert [(len(of["t"]), None in of["y"], of["run"]) for of in dots] == [(117, False, 1)]


def test_both_units_stand_on_the_axes(page, plots):
    glucose, insulin = plots(page)[0]["panels"]
    assert (glucose["unit"], glucose["other"]) == ("mg/dl", "mmol/l")
    assert glucose["factor"] == pytest.approx(1.0 / MG_DL_PER_MMOL_L)
    assert (insulin["unit"], insulin["other"], insulin["factor"]) == ("mU/min", "U/h", pytest.approx(0.06))


def test_who_has_no_script_is_told_where_the_numbers_are(page, reader):
    read = reader(page)
    assert "".join(read.text["p"]).count("What happened, and numbers of the picture, stand below.") == 1
    assert "noscript" in read.tags


def test_the_metrics_are_those_of_the_runs_in_both_units(page, quiet, noisy):
    of_all = {"calm": summarise(quiet), "wild": summarise(noisy)}
    table = page[page.index(">Metrics</h2>") :].partition("</table>")[0]
    lines = [line for line in table.split("<tr>") if 'scope="row"' in line]
    rows = metric_rows(of_all)
    assert len(lines) == len(rows) > 30
    for line, row in zip(lines, rows, strict=True):
        name, *cells = re.findall(r"<t[hd][^>]*>(.*?)</t[hd]>", line)
        assert shown(name) == row.name
        assert tuple(map(shown, cells)) == (*row.values, row.unit)
    undershoot = of_all["wild"].undershoot_mg_dl / MG_DL_PER_MMOL_L
    assert f'<span class="mmol">{undershoot:.2f}</span>' in table
    assert '<span class="mmol">3.9 mmol/l</span>' in table


def test_what_happened_is_marked_and_told(make_trace, plots):
    glucose = 80.0 - np.where((np.arange(601) > 300) & (np.arange(601) < 331), 15.0, 0.0)
    status = np.zeros(120, int)
    status[60:66] = Status.SUSPENDED
    command = np.full(120, 20.0)
    insulin = np.where(np.arange(120) // 12 == 4, 0.0, command)
    bolus = np.zeros(120)
    bolus[10] = 4200.0
    trace = make_trace(
        glucose,
        insulin,
        command_mU_min=command,
        status=status,
        bolus_mU=bolus,
        command_bolus_mU=bolus,
        reported_bolus_mU=bolus,
    )
    page = interactive_page(trace, summarise(trace), faults=[FAULT])
    told = shown(page)
    assert "Meals: 50 g at 50 min." in told
    assert "Fault: occlusion, open fraction 0, not noticed, from 200 min, for 60 min." in told
    assert "Glucose below 70 mg/dl from 301 to 330 min." in told
    assert "Glucose below 54" not in told
    assert "Glucose above" not in told
    assert "Guard: insulin suspended from 300 to 330 min." in told
    assert "Boluses delivered: 4.2 U at 50 min." in told
    (plot,) = plots(page)
    assert [panel["spans"] for panel in plot["panels"]] == [[], [[200.0, 260.0]], []]
    lanes = {lane["name"]: lane["rows"] for lane in plot["lanes"]}
    assert lanes["Guard: insulin suspended"] == [{"periods": [[300.0, 330.0]], "colour": 0}]


def test_what_was_commanded_is_drawn_where_it_differs(make_trace, drawn):
    command = np.full(120, 20.0)
    blocked = make_trace(np.full(601, 80.0), np.zeros(120), command_mU_min=command)
    (figure,) = drawn(interactive_page(blocked, summarise(blocked)))
    assert [curve.name for curve in figure if curve.name] == ["glucose", "commanded", "delivered"]
    asked = next(curve for curve in figure if curve.name == "commanded")
    assert set(asked.values) == {20.0}


def test_what_is_on_board_is_drawn_of_subcutaneous_insulin(make_trace, drawn, plots):
    fields = {"bolus_mU": np.where(np.arange(120) == 10, 4200.0, 0.0)}
    shot = make_trace(np.full(601, 80.0), np.full(120, 20.0), subcutaneous=True, **fields)
    page = interactive_page(shot, summarise(shot))
    names = [panel["name"] for panel in plots(page)[0]["panels"]]
    assert names == ["Glucose", "Insulin", "Boluses", "Insulin on board", "Carbohydrate on board"]
    (figure,) = drawn(page)
    curves = {curve.name: curve for curve in figure}
    for name, column, digits in (("insulin", "insulin_on_board_U", 2), ("carbohydrate", "carbs_on_board_g", 1)):
        curve = curves[f"{name} on board"]
        np.testing.assert_allclose(curve.t_min, shot.t_min)
        np.testing.assert_allclose(curve.values, getattr(shot, column), atol=0.51 * 10.0**-digits)
    assert curves["insulin on board"].values.max() == pytest.approx(4.2, abs=0.01)
    vein = make_trace(np.full(601, 80.0), np.full(120, 20.0), **fields)
    assert len(plots(interactive_page(vein, summarise(vein)))[0]["panels"]) == 3


def test_the_whole_situation_is_told(quiet, reader):
    repeat = Repeat("run --config run.toml", {"controller": "mpc", "seed": 3}, {"trace.csv": "one row per sample"})
    facts = {"Sensor": "no <noise>", "Setpoint": "80 mg/dl"}
    page = interactive_page(quiet, summarise(quiet), facts=facts, repeat=repeat)
    read = reader(page)
    assert read.text["h2"][-1] == "Situation"
    assert "no <noise>" in read.text["dd"]
    assert any(text.startswith("glucoloop 0.") for text in read.text["dd"])
    assert "glucoloop run --config run.toml --out again" in read.text["code"]
    assert any('controller = "mpc"\nseed = 3' in text for text in read.text["code"])
    assert ("href", "trace.csv") in read.attributes


def test_a_single_run_needs_no_label(noisy, reader, drawn):
    page = interactive_page(noisy, summarise(noisy))
    assert [curve.name for curve in drawn(page)[0] if curve.name] == ["glucose", "delivered"]
    assert "Value" in reader(page).text["th"]


def test_labels_are_shown_as_they_are_and_never_run(quiet, noisy, reader, drawn):
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
        assert any(curve.name == f"{label}, glucose" for curve in drawn(page)[0])


def test_a_run_that_left_the_numbers_makes_a_page(make_trace, reader, drawn):
    glucose = np.full(601, 80.0)
    glucose[300:] = np.nan
    trace = make_trace(glucose)
    page = interactive_page(trace, summarise(trace))
    curve = next(curve for curve in drawn(page)[0] if curve.name == "glucose")
    finite = np.isfinite(curve.values)
    assert curve.t_min[finite].tolist() == list(range(300))
    assert "n/a" in reader(page).text["span"]


@pytest.mark.long
def test_a_long_run_keeps_its_extremes_and_stays_small(make_trace, drawn):
    t = np.arange(14 * 1440 + 1.0)
    glucose = 100.0 + 30.0 * np.sin(t / 200.0)
    glucose[7777] = 41.0
    trace = make_trace(glucose, meal_sample=None)
    traces = {f"run {index}": trace for index in range(10)}
    page = interactive_page(traces, {label: summarise(trace) for label in traces})
    assert len(page) < 300_000
    for curve in drawn(page)[0][:10]:
        assert curve.values.min() == pytest.approx(41.0)


@pytest.mark.parametrize("meals", [3, 100])
def test_meals_are_marked(make_trace, meals, plots):
    carbs_g = np.zeros(120)
    carbs_g[:meals] = 50.0
    trace = make_trace(np.full(601, 80.0), carbs_g=carbs_g)
    page = interactive_page(trace, summarise(trace))
    assert len(plots(page)[0]["panels"][0]["marks"]) == meals


@pytest.mark.parametrize("labels", [("a", "c"), ("b", "a"), ("a",)])
def test_metrics_of_other_runs_are_refused(quiet, noisy, labels):
    with pytest.raises(ValueError, match="under the same labels"):
        interactive_page({"a": quiet, "b": noisy}, {label: summarise(quiet) for label in labels})


def test_metrics_of_one_run_do_not_stand_for_several(quiet):
    with pytest.raises(ValueError, match="under the same labels"):
        interactive_page({"glucose": quiet}, summarise(quiet))


def test_what_a_clinician_would_say_stands_before_the_picture(make_trace):
    glucose = np.full(601, 300.0)
    glucose[:120] = 100.0
    trace = make_trace(glucose, np.zeros(120))
    told = shown(interactive_page(trace, summarise(trace)))
    summary = told.partition("Summary")[2].partition("What happened")[0]
    assert summary.index("Glucose was from 70 to 180 mg/dl for 20.0 %") < summary.index("above 250 mg/dl for 80.0 %")
    assert "none at all for 10 h" in summary
    assert "Glucose above 250 mg/dl from 120 to 600 min." in told


def test_a_glucose_below_0_is_no_number(make_trace, drawn):
    glucose = np.linspace(100.0, -20.0, 601)
    trace = make_trace(glucose)
    page = interactive_page(trace, summarise(trace))
    (figure,) = drawn(page)
    curve = next(curve for curve in figure if curve.name == "glucose")
    assert np.nanmin(curve.values) >= 0.0
    assert not re.search(r"[-−]\d[\d.]*( mg/dl|</td>)", page.partition("<script>")[0])
    least = next(row for row in metric_rows({"": summarise(trace)}) if row.name == "Minimum glucose")
    assert least.values == least.other == ["not valid"]
    undershoot = next(row for row in metric_rows({"": summarise(trace)}) if row.name == "Undershoot")
    assert undershoot.values == ["not valid"]
    assert "the patient's model is not valid there" in html.unescape(page)
