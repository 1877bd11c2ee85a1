"""The engine that draws pages, in node: what stands at which place of a picture."""

import json
import re
import shutil
import subprocess

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from glucoloop.pages import PAGES

NODE = shutil.which("node")
pytestmark = pytest.mark.skipif(NODE is None, reason="needs node (Debian: apt install nodejs)")

WIDTH, HEIGHT = 1044.0 + 18.0, 336.0
PANEL = {"range": [50, 150], "band": None, "rules": [], "lines": [], "dots": [], "areas": [], "spans": []}
VIEW = {"from": 0, "to": 600, "unit": "min"}


def asked(module, expression, *arguments):
    """Value of an expression of what a module exports, of arguments called ``$``."""
    code = (
        f'import * as of from "{(PAGES / module).as_uri()}";'
        f"const $ = {json.dumps(arguments)}; console.log(JSON.stringify({expression}));"
    )
    done = subprocess.run([NODE, "--input-type=module", "-e", code], capture_output=True, text=True, check=True)
    return json.loads(done.stdout)


def drawn(panel, view=VIEW):
    """Parts of a picture whose inside is 1000 pixels wide and 300 high."""
    return asked("chart.mjs", "of.drawn($[0], $[1], $[2], $[3])", {**PANEL, **panel}, view, WIDTH, HEIGHT)


def line(x, y, **about):
    """A curve."""
    return {"name": "a", "x": x, "y": y, "colour": "red", "width": 2, "dash": [], **about}


def path_of(parts, kind="line"):
    """The path of what is drawn."""
    return re.search(rf'<path class="{kind}" d="([^"]*)"', parts["curves"])[1]


@settings(max_examples=5)
@given(st.lists(st.tuples(st.floats(-1e4, 1e4), st.floats(1e-3, 1e4), st.integers(2, 12)), min_size=20, max_size=40))
def test_levels_are_few_round_and_inside(cases):
    found = asked("axes.mjs", "$[0].map(([low, span, most]) => of.levels([low, low + span], most))", cases)
    for (low, span, most), ticks in zip(cases, found, strict=True):
        assert len(ticks) <= most + 1
        assert all(low - 1e-6 * span <= tick <= low + span * (1.0 + 1e-6) for tick in ticks)
        if len(ticks) > 1:
            steps = np.diff(ticks)
            np.testing.assert_allclose(steps, steps[0], rtol=1e-6)
            mantissa = steps[0] / 10.0 ** np.floor(np.log10(steps[0]) + 1e-9)
            assert min(abs(mantissa - round_one) for round_one in (1.0, 2.0, 2.5, 5.0, 10.0)) < 1e-6


@pytest.mark.parametrize(
    ("view", "most", "times"),
    [
        ({"from": 0, "to": 600, "unit": "min"}, 11, [0, 60, 120, 180, 240, 300, 360, 420, 480, 540, 600]),
        ({"from": 0, "to": 1440, "unit": "h"}, 5, [0, 360, 720, 1080, 1440]),
        ({"from": 70, "to": 100, "unit": "min"}, 4, [70, 80, 90, 100]),
        ({"from": 0, "to": 14 * 1440, "unit": "days"}, 4, [0, 10080, 20160]),
        ({"from": 0, "to": 2 * 1440, "unit": "days", "start": 420}, 3, [1020, 2460]),
        ({"from": 0, "to": 600, "unit": "days", "start": 420}, 5, [60, 180, 300, 420, 540]),
    ],
)
def test_times_are_round_and_as_many_as_fit(view, most, times):
    assert asked("axes.mjs", "of.times($[0], $[1])", view, most) == times


def test_a_curve_stands_at_its_times_and_values_with_its_gaps():
    parts = drawn({"lines": [line([0, 300, 450, 600], [50, 150, None, 100])]})
    assert parts["inside"] == {"left": 44, "top": 6, "width": 1000, "height": 300}
    assert path_of(parts) == "M0 300L500 0M1000 150"


def test_values_that_are_held_are_steps_until_the_end():
    parts = drawn({"lines": [line([0, 150, 300], [50, 150, 100], until=600)]})
    assert path_of(parts) == "M0 300H250V0H500V150H1000"


def test_a_band_lies_between_its_edges():
    area = {"name": "b", "x": [0, 600], "low": [50, 100], "high": [100, 150], "colour": "red", "opacity": 0.25}
    assert path_of(drawn({"areas": [area]}), "area") == "M0 150L1000 0L1000 150L0 300z"


def test_a_zoomed_picture_shows_what_is_between_its_ends():
    parts = drawn({"lines": [line([0, 300], [50, 150])]}, {"from": 150, "to": 300, "unit": "min"})
    assert path_of(parts) == "M-1000 300L1000 0"
    assert ">150 min</text>" in parts["axes"]


def test_both_axes_stand_at_the_same_values():
    parts = drawn({"second": 0.1})
    marks = re.findall(r'<text x="([\d.]+)" y="([\d.]+)" text-anchor="(end|start)"[^>]*>([\d.]+)</text>', parts["axes"])
    places = {(anchor, float(text)): float(y) for _, y, anchor, text in marks}
    assert places["end", 100.0] == places["start", 10.0] == 6.0 + 150.0 + 4.0


def test_the_range_that_is_aimed_at_faults_and_the_guard_lie_behind():
    spans = [
        {"from": 60, "to": 120, "kind": "fault", "text": "<stuck>"},
        {"from": 300, "to": 330, "kind": "guard", "text": "suspended"},
    ]
    parts = drawn({"band": [70, 180], "spans": spans})
    assert '<rect y="0" width="1000" height="240" fill="var(--target)"/>' in parts["behind"]
    assert '<rect x="100" width="100" height="300" fill="var(--fault)"><title>&lt;stuck&gt;</title>' in parts["behind"]
    assert '<rect x="500" width="50" height="5" fill="var(--guard)"><title>suspended</title>' in parts["behind"]


def test_meals_stand_above_and_their_texts_where_there_is_room():
    marks = [[60, "50 g"], [61, "20 g"], [300, "<70 g>"]]
    axes = drawn({"marks": marks})["axes"]
    assert axes.count("l-4 7z") == 3
    assert re.findall(r'fill="var\(--faint\)">([^<]*)</text>', axes) == ["50 g", "&lt;70 g&gt;"]


def test_a_band_has_no_area_where_its_edges_are_not_known():
    x = [0, 100, 200, 300, 400]
    band = {"name": "a", "x": x, "low": [60, 60, None, 60, 60], "high": [90, 90, None, 90, 90]}
    path = path_of(drawn({"areas": [{**band, "colour": "red", "opacity": 0.2}]}), "area")
    assert path.count("M") == path.count("z") == 2
