"""Pages in a browser: axe-core finds nothing, nothing is loaded, and plots answer to the keyboard."""

import datetime as dt
import re
from pathlib import Path

import numpy as np
import pytest

from browser import in_browser, needs_browser
from glucoloop.metrics import summarise
from glucoloop.metrics.readings import Readings, numbers_of
from glucoloop.reporting import Repeat, interactive_page
from glucoloop.reporting.record_groups import GOALS, ReportedRecord
from glucoloop.reporting.record_page import record_page
from glucoloop.reproduction.parker1999 import POINTS
from glucoloop.reproduction.parker1999.comparison import ENTRIES, ComparedEntry, Reproduced
from glucoloop.reproduction.parker1999.experiments import PointResults
from glucoloop.reproduction.parker1999.study import page
from glucoloop.studies.trial.page import trial_page
from glucoloop.studies.tuning.study import _Searched, _surface_page
from glucoloop.tuning.grid import tuning_grid
from monitor_records import with_gaps

FAULT = "stuck, start_min=60, latest_min=120, duration_min=90"

_NO_RUNS = PointResults("setpoint-81", None, 60, None, {}, {}, {})


def _as_wide_as_the_full_one():
    """All printed entries, each with a result that does not agree, at every operating point."""
    found = Reproduced(120.25, low=99.75, high=130.25)
    return [ComparedEntry(entry=entry, reproduced=dict.fromkeys(POINTS, found)) for entry in ENTRIES]


def _record(label, days, group=""):
    readings = Readings.of(*with_gaps(days, 3), dt.date(2025, 1, 6))
    notes = ("Glucose was brought from mmol/l to mg/dl.",)
    return ReportedRecord(label, readings, numbers_of(readings), notes, group)


def _groups():
    return [_record(f"{group}: person {number}", 2, group) for group in ("before", "after") for number in range(1, 5)]


pytestmark = [pytest.mark.long, needs_browser]


@pytest.fixture(scope="module")
def pages(quiet, noisy, make_report, make_stress, stress_page, league_page, surface_of, tmp_path_factory):
    """One page of each kind, as files."""
    tunings = tuning_grid([1, 2], [1, 2, 8])
    surface = surface_of(tunings, [30.0, 10.0, 20.0, 40.0, 5.0][: len(tunings)])
    facts = {"Sensor": "no noise", "Setpoint": "80 mg/dl"}
    repeat = Repeat("run --config run.toml", {"controller": "mpc", "seed": 3}, {"trace.csv": "one row per sample"})
    texts = {
        "runs": interactive_page(
            {"calm": quiet, "wild": noisy},
            {"calm": summarise(quiet), "wild": summarise(noisy)},
            faults=[FAULT],
            facts=facts,
            repeat=repeat,
        ),
        "trial": trial_page(make_report("calm", "wild")),
        "stress": stress_page(make_stress(["imc", "mpc"], [FAULT], {("mpc", True, FAULT): (9.0, [1])})),
        "league": league_page,
        "surface": _surface_page(
            _Searched(surface, surface.rank_of(surface.tunings[0])), "Tunings", tunings, facts=facts, repeat=repeat
        ),
        "record": record_page([_record("before", 14), _record("after", 3)], GOALS["adult"]),
        "groups": record_page(_groups(), GOALS["adult"], notes=["1 record could not be read."]),
        "reproduction": page(dict.fromkeys(POINTS, _NO_RUNS), _as_wide_as_the_full_one(), 1),
    }
    folder = tmp_path_factory.mktemp("pages")
    for name, text in texts.items():
        (folder / f"{name}.html").write_text(text, encoding="utf-8")
    return folder


@pytest.fixture(scope="module")
def seen(pages):
    answers = in_browser(Path(__file__).with_name("browser.mjs"), *sorted(pages.iterdir()))
    return {(Path(of["file"]).stem, of["width"], of["colorScheme"]): of for of in answers}


def test_nobody_is_kept_out_and_nothing_is_loaded(seen, pages):
    assert len(seen) == 4 * len(list(pages.iterdir()))  # at two widths, light and dark
    looked = {(width, theme) for (_, width, theme), of in seen.items() if of["looked"]}
    assert looked == {(1280, "light"), (390, "dark")}  # by axe-core, which takes long
    for place, of in seen.items():
        assert (place, of["violations"], of["loads"], of["errors"]) == (place, [], [], [])
        assert of["wide"] <= of["width"], place


def test_a_moment_is_told_by_keyboard_and_by_voice(seen, quiet):
    for width in (1280, 390):
        of = seen["runs", width, "light"]
        glucose, insulin = float(quiet.fine_glucose_mg_dl[5]), float(quiet.insulin_mU_min[1])
        for told in (of["moment"], of["readout"]):
            assert told.startswith("5 min")
            assert f"calm, glucose {glucose:.1f} mg/dl" in told
            assert f"calm, delivered {insulin:.2f} mU/min ({0.06 * insulin:.2f} U/h)" in told
        times = [float(text.removesuffix(" min")) for text in of["zoomed"]]
        assert (times[0], times[-1]) == (0.0, 300.0)  # half of 600 min, about minute 5
        assert of["saved"][0] == "plot,curve,t_min,value,unit"
        assert of["saved"][1].startswith('Glucose and insulin,"calm, glucose",0,80')


def test_a_time_of_day_is_told_with_its_percentiles(seen):
    told = seen["record", 390, "light"]["moment"]
    assert told.startswith("0.08 h")
    assert re.search(r"before, median [\d.]+ mg/dl \([\d.]+ mmol/l\), after, median", told)
    assert re.search(r"before, 25 to 75 % [\d.]+ – [\d.]+ mg/dl", told)
    assert "Mean (mmol/l)" in seen["record", 1280, "dark"]["units"]


def test_people_are_told_as_percentiles(seen):
    told = seen["trial", 1280, "dark"]["moment"]
    first = [told.index(name) for name in ("median", "50 % of the people", "90 % of the people")]
    assert first == sorted(first)


def test_one_person_can_be_singled_out(seen, make_report):
    of, worst = seen["trial", 390, "light"], make_report("calm", "wild").cases
    assert of["chosen"] == str(worst["calm"].worst[0].person)
    assert of["pressed"] == "true"
    assert f"person {of['chosen']} 81.1 mg/dl (4.50 mmol/l)" in of["told"]
    others = [f"person {person.person}" for person in worst["wild"].worst]
    # glucose and insulin of one person of the first controller, and everybody of the second
    assert sorted(of["clear"]) == sorted([f"person {of['chosen']}"] * 2 + others * 2)
    assert of["fadedAfter"] == 0


def test_a_run_can_be_hidden(seen):
    assert sorted(seen["runs", 1280, "light"]["left"]) == ["wild, delivered", "wild, glucose"]


def test_pictures_are_told_in_words(seen, quiet, noisy):
    glucose, insulin = seen["runs", 390, "dark"]["pictures"]
    least = float(np.min(quiet.fine_glucose_mg_dl))
    assert glucose.startswith(f"Glucose. calm, glucose: minimum {least:.1f} mg/dl at ")
    most = float(np.max(noisy.insulin_mU_min))
    assert f"wild, delivered: minimum 25.00 mU/min at 0 min, maximum {most:.2f} mU/min at 100 min" in insulin
    told = seen["trial", 1280, "light"]["pictures"]
    assert any("90 % of the people: minimum" in text for text in told)


def test_who_has_no_script_is_told_where_the_numbers_are(seen):
    for kind, of in ((kind, of) for (kind, _, _), of in seen.items() if of["looked"]):
        assert len(of["plain"]) == {"runs": 1, "trial": 2, "record": 3, "groups": 3}.get(kind, 0)
        assert of["plainLooks"] == 0


def test_the_choice_of_unit_reaches_the_tables(seen):
    assert "mmol/l" in seen["runs", 1280, "light"]["units"]
    assert "mg/dl" not in seen["runs", 1280, "light"]["units"].replace("(mg/dl)²", "")
