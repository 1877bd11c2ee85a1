"""What the print figure of a stress test shows, and that it can be read."""

import io
import sys

import matplotlib.colors
import pytest

from glucoloop.reporting.heat import SHADES_PCT as SHADES
from glucoloop.studies.stress import STANDARD_FAULTS
from glucoloop.studies.stress.study import _plot_stress

STUCK, DRIFT = "stuck, start_min=60, duration_min=90", "drift, mg_dl_h=3"


@pytest.fixture(scope="module")
def result(make_stress):
    bad = {
        ("mpc", False, STUCK): (22.4, range(30)),
        ("mpc", True, STUCK): (6.26, [3, 8]),
        ("imc", False, DRIFT): (100.0, range(40)),
    }
    return make_stress(["imc", "mpc"], [STUCK, DRIFT], bad)


def cells(axes):
    """Text and colour of each cell, by row and column."""
    rectangles = {
        (round(patch.get_y() + 0.46, 2), round(patch.get_x() + 0.48)): matplotlib.colors.to_hex(patch.get_facecolor())
        if patch.get_facecolor()[3]
        else None
        for patch in axes.patches
    }
    places = sorted({row for row, _ in rectangles})
    return {
        (places.index(round(text.xy[1], 2)), text.xy[0]): (
            text.get_text(),
            rectangles[round(text.xy[1], 2), text.xy[0]],
        )
        for text in axes.texts
    }


def texts(figure):
    from matplotlib.text import Text

    return [text for text in figure.findobj(Text) if text.get_visible() and text.get_text().strip()]


def test_each_map_shows_its_cells(result):
    figure = _plot_stress(result)
    bare, guarded = map(cells, figure.axes)
    assert bare == {
        (0, 0): ("0", None),
        (0, 1): ("0", None),
        (1, 0): ("0", None),
        (1, 1): ("22.4 ▲30", SHADES[5].colour),
        (2, 0): ("100 ▲40", SHADES[6].colour),
        (2, 1): ("0", None),
    }
    assert guarded[1, 1] == ("6.3 ▲2", SHADES[3].colour)
    assert {place for place, (text, _) in guarded.items() if text != "0"} == {(1, 1)}
    words = [text.get_text() for text in texts(figure)]
    for expected in ("Without the guard", "With the guard", "imc", "mpc", "no fault", "stuck", "drift", "to 20 %"):
        assert expected in words


@pytest.mark.parametrize("guards", [(False,), (True,)])
def test_with_one_kind_only_there_is_one_map(make_stress, guards):
    (axes,) = _plot_stress(make_stress(["imc"], [STUCK], guards=guards)).axes
    assert axes.get_title("left") == ("With the guard" if guards[0] else "Without the guard")


@pytest.mark.long
@pytest.mark.parametrize(
    ("controllers", "faults", "width"),
    [(1, 4, "single"), (4, 23, "single"), (9, 2, "single"), (1, 4, "double"), (4, 23, "double"), (9, 2, "double")],
)
def test_nothing_is_clipped_and_numbers_stay_in_their_cells(make_stress, controllers, faults, width):
    labels = ["linear MPC", r"$\frac$", "_x", "A controller whose name will not fit on one line", *"efghi"][
        :controllers
    ]
    bad = {
        (label, guarded, fault): (88.8, range(40)) for label in labels for guarded in (False, True) for fault in [STUCK]
    }
    figure = _plot_stress(make_stress(labels, [STUCK, *STANDARD_FAULTS[:faults]], bad), width=width, title="Stress $x$")
    figure.draw_without_rendering()
    drawn = figure.get_tightbbox()
    assert drawn.x0 >= 0.0
    assert drawn.y0 >= 0.0
    assert drawn.x1 <= figure.get_figwidth()
    assert drawn.y1 <= figure.get_figheight()
    assert all(text.get_fontsize() >= 7.0 for text in texts(figure))
    for axes in figure.axes:
        cell = axes.patches[0].get_window_extent()
        for text in axes.texts:
            extent = text.get_window_extent()
            assert extent.width <= 1.02 * cell.width
            assert extent.height <= 1.02 * cell.height


def test_an_unknown_width_is_refused(result):
    with pytest.raises(ValueError, match="unknown width 'triple'"):
        _plot_stress(result, width="triple")


def test_it_is_written_apart_from_pyplot(result):
    file = io.BytesIO()
    _plot_stress(result).savefig(file, format="png", dpi=50)
    assert file.getvalue().startswith(b"\x89PNG")
    pyplot = sys.modules.get("matplotlib.pyplot")
    assert pyplot is None or not pyplot.get_fignums()
