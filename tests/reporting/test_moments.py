"""Moments in words: minutes up to a day, day and clock beyond, which lead back to the minute."""

import json
import re
import shutil
import subprocess

import pytest
from hypothesis import given
from hypothesis import strategies as st

from glucoloop.pages import PAGES
from glucoloop.reporting.descriptions import run_facts
from glucoloop.reporting.labelled_traces import moment_text, period_text, periods_text
from glucoloop.situations.run import Run
from glucoloop.situations.situation import configured

NODE = shutil.which("node")


@given(st.integers(0, 400 * 1440))
def test_day_and_clock_lead_back_to_the_minute(t_min):
    text = moment_text(t_min, 400 * 1440)
    day, hour, minute = map(int, re.fullmatch(r"day (\d+), (\d\d):(\d\d)", text).groups())
    assert hour < 24
    assert minute < 60
    assert (day - 1) * 1440 + hour * 60 + minute == t_min


def test_moments_and_periods_of_short_and_long_runs():
    assert moment_text(14010.0, 20160.0) == moment_text(14010.0) == "day 10, 17:30"
    assert moment_text(480.0, 20160.0) == "day 1, 08:00"
    assert moment_text(480.0, 1440.0) == moment_text(480.0) == "480 min"
    assert moment_text(1440.0, 2880.0, start_min=420.0) == "day 2, 07:00"
    assert period_text(10.0, 20.0, 600.0) == "from 10 to 20 min"
    assert period_text(10.0, 10.0, 600.0) == "at 10 min"
    assert period_text(1439.0, 1450.0, 2880.0) == "from day 1, 23:59 to day 2, 00:10"
    several = [(0.0, 1.0), (5.0, 5.0), (7.0, 9.0), (11.0, 12.0)]
    assert periods_text(several, 60.0) == "from 0 to 1 min, at 5 min and in 2 later periods"


@pytest.mark.skipif(NODE is None, reason="needs node (Debian: apt install nodejs)")
def test_pages_tell_the_same_moments():
    times = [0, 5, 480, 1439, 1440, 14010, 20160]
    code = (
        f"import {{ timeText, markText, unitOfTime }} from {json.dumps((PAGES / 'axes.mjs').as_uri())};"
        f"const all = (end) => {json.dumps(times)}.map((t) => timeText(t, unitOfTime(end)));"
        "const marks = [0, 720, 1440].map((t, i) => markText(t, unitOfTime(2880), i === 0));"
        "const others = [markText(720, 'days', true), markText(60, 'min', false), timeText(1440, 'days', 420)];"
        "console.log(JSON.stringify([all(20160), all(1e6), all(600), marks, others]));"
    )
    done = subprocess.run([NODE, "--input-type=module", "-e", code], capture_output=True, text=True, check=True)
    days, weeks, minutes, marks, others = json.loads(done.stdout)
    assert days == weeks == [moment_text(t, 20160) for t in times]
    assert minutes == [f"{t} min" for t in times]
    assert (marks, others) == (["day 1", "12:00", "day 2"], ["day 1, 12:00", "60", "day 2, 07:00"])


def test_a_length_of_days_is_told_in_days():
    lengths = [
        run_facts(run, run.case)["Length"] for run in (configured(Run, duration_min=n) for n in (600, 1440, 7230))
    ]
    assert lengths == ["600 min", "a day", "5 days and 30 min"]
