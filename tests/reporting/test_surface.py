"""The surface of a search, as it is drawn."""

import dataclasses

import numpy as np
import pytest

from glucoloop.control import MPCTuning, StateTuning
from glucoloop.reporting.sse_surface import plot_surface
from glucoloop.tuning.grid import tuning_grid


@pytest.fixture
def linear(surface_of):
    """Two move horizons and three prediction horizons; the smallest sum rings, the next breaks a bound."""
    surface = surface_of(tuning_grid([1, 2], [2, 4, 8]), [10, 20, 30, 40, 50, 60])
    kept, rings = np.ones(6), np.zeros(6, bool)
    kept[1], rings[0] = 0.0, True
    return dataclasses.replace(surface, kept_share=kept, oscillates=rings)


def legend(figure):
    return [text.get_text() for text in figure.legends[0].get_texts()]


def panels(figure):
    return [axes for axes in figure.axes if axes.get_visible() and axes.get_label() != "<colorbar>"]


def markers(axes):
    return {
        line.get_marker(): (float(line.get_xdata()[0]), float(line.get_ydata()[0]))
        for line in axes.lines
        if line.get_marker() != "None"
    }


def test_best_and_printed_stand_on_their_cells(linear):
    figure = plot_surface(linear, printed=MPCTuning(2, 4))
    (axes,) = panels(figure)
    assert markers(axes) == {"*": (2.5, 0.5), "D": (1.5, 1.5)}
    assert legend(figure) == ["breaks a constraint", "oscillates", "best (1, 8, 1, 0)", "printed (2, 4, 1, 0)"]
    assert [text.get_text() for text in axes.get_xticklabels()] == ["2", "4", "8"]
    assert [text.get_text() for text in axes.get_yticklabels()] == ["1", "2"]
    assert axes.get_xlabel() == "Prediction horizon p (samples)"
    assert [patch.get_hatch() for patch in axes.patches] == ["xxxxx", "/////"]
    cells = axes.collections[0].get_array().reshape(2, 3)
    np.testing.assert_array_equal(cells, [[10, 20, 30], [40, 50, 60]])


def test_hatching_covers_its_cells_alone(linear):
    (axes,) = panels(plot_surface(linear))
    broken, ringing = axes.patches
    assert broken.get_path().get_extents().bounds == (1.0, 0.0, 1.0, 1.0)
    assert ringing.get_path().get_extents().bounds == (0.0, 0.0, 1.0, 1.0)


def test_what_is_no_axis_is_a_panel(surface_of):
    tunings = tuning_grid([1, 2, 3], [3, 4], reference_filters=[0.3, 0.5, 0.57])
    figure = plot_surface(surface_of(tunings, 1.0 + np.arange(18)), printed=StateTuning(2, 4, 1.0, 0.0, 0.57))
    assert [axes.get_title() for axes in panels(figure)] == ["m = 1", "m = 2", "m = 3"]
    assert [list(markers(axes)) for axes in panels(figure)] == [["*"], ["D"], []]
    assert panels(figure)[0].get_ylabel() == r"Reference filter $\varphi_r$"
    np.testing.assert_array_equal(
        panels(figure)[1].collections[0].get_array().reshape(3, 2), [[7, 10], [8, 11], [9, 12]]
    )


def test_a_cell_without_a_number_says_why(surface_of):
    tunings = tuning_grid([1, 2], [1, 2])
    surface = dataclasses.replace(surface_of(tunings[:2], [3.0, np.nan]), refused=((tunings[2], "too fast"),))
    figure = plot_surface(surface)
    (axes,) = panels(figure)
    np.testing.assert_array_equal(
        np.ma.getmaskarray(axes.collections[0].get_array().reshape(2, 2)), [[False, True], [True, True]]
    )
    without_number = {
        label: patch.get_path().get_extents().bounds[:2]
        for label, patch in zip(legend(figure), axes.patches, strict=False)
    }
    assert without_number == {
        "glucose left the finite numbers": (1.0, 0.0),
        "no controller can be designed": (1.0, 1.0),
        "p < m, no such tuning": (0.0, 1.0),
    }


def test_one_tuning_is_a_surface(surface_of):
    figure = plot_surface(surface_of([MPCTuning()], [4.0]), printed=MPCTuning(3, 3), title="one $ [x]")
    assert legend(figure) == ["best (2, 8, 1, 0)", "printed (3, 3, 1, 0), beside the grid"]
    assert figure.get_suptitle() == r"one \$ [x]"


@pytest.mark.parametrize("width", ["single", "double"])
def test_nothing_is_clipped(linear, width):
    figure = plot_surface(linear, printed=MPCTuning(2, 4), title="A title of some length, about a surface", width=width)
    figure.draw_without_rendering()
    drawn = figure.get_tightbbox()
    assert min(drawn.x0, drawn.y0) >= 0.0
    assert drawn.x1 <= figure.get_figwidth()
    assert drawn.y1 <= figure.get_figheight()


def test_what_cannot_be_drawn_is_refused(linear, surface_of):
    many = tuning_grid([1, 2], [2, 3], reference_filters=[0.3, 0.5], move_weights=np.arange(7.0))
    with pytest.raises(ValueError, match="14 panels"):
        plot_surface(surface_of(many, 1.0 + np.arange(len(many))))
    with pytest.raises(ValueError, match="no finite sum"):
        plot_surface(dataclasses.replace(linear, sse=np.full(6, np.nan)))
    with pytest.raises(ValueError, match="unknown width"):
        plot_surface(linear, width="triple")
