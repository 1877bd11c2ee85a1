"""What is drawn, where, and that it can be read."""

import dataclasses
import io
import sys

import matplotlib
import numpy as np
import pytest

from glucoloop.control.protocol import DoseForecast
from glucoloop.reporting import plot
from glucoloop.reporting.figure_files import _figure_bytes, figure_files
from glucoloop.units import MG_DL_PER_MMOL_L


def texts(figure):
    from matplotlib.text import Text

    return [text for text in figure.findobj(Text) if text.get_visible() and text.get_text().strip()]


def words(figure):
    return [text.get_text() for text in texts(figure)]


def levels(axes):
    """Heights of the lines that run across the panel."""
    return [line.get_ydata()[0] for line in axes.lines if line.get_transform() == axes.get_yaxis_transform()]


def curve(axes, ydata):
    return next(line for line in axes.lines if np.array_equal(line.get_ydata(), ydata))


def assert_nothing_is_clipped(figure):
    figure.draw_without_rendering()
    drawn = figure.get_tightbbox()
    assert drawn.x0 >= 0.0
    assert drawn.y0 >= 0.0
    assert drawn.x1 <= figure.get_figwidth()
    assert drawn.y1 <= figure.get_figheight()


def test_a_run_shows_glucose_above_and_insulin_below(quiet):
    figure = plot(quiet, title="A quiet run")
    above, below = figure.axes
    glucose = curve(above, np.asarray(quiet.fine_glucose_mg_dl))
    np.testing.assert_array_equal(glucose.get_xdata(), quiet.fine_t_min)
    assert levels(above) == [80.0, 60.0]
    insulin = curve(below, np.append(quiet.insulin_mU_min, quiet.insulin_mU_min[-1]))
    assert insulin.get_drawstyle() == "steps-post"
    np.testing.assert_array_equal(insulin.get_xdata(), [*range(0, 600, 5), 600])
    assert levels(below)[0] == 20.0
    assert above.get_ylabel() == "Glucose (mg/dl)"
    assert below.get_ylabel() == "Insulin (mU/min)"
    assert below.get_xlabel() == "Time (min)"
    assert below.get_xlim() == (0.0, 600.0)
    shown = words(figure)
    for expected in ("A quiet run", "50 g", "60 mg/dl", "setpoint 80 mg/dl", "basal 20 mU/min"):
        assert expected in shown


def test_a_meal_is_marked_at_its_time(quiet):
    above = plot(quiet).axes[0]
    mark = next(line for line in above.lines if line.get_marker() == "v")
    assert list(mark.get_xdata()) == [50.0]
    note = next(text for text in above.texts if text.get_text() == "50 g")
    assert note.xy[0] == 50.0


def test_readings_are_dots_only_where_they_tell_something(quiet, noisy):
    def dots(trace):
        return [line for line in plot(trace).axes[0].lines if line.get_marker() == "." and len(line.get_xdata())]

    assert not dots(quiet)
    (shown,) = dots(noisy)
    valid = np.asarray(noisy.reading_valid)
    np.testing.assert_array_equal(shown.get_xdata(), np.asarray(noisy.t_min)[valid])
    np.testing.assert_array_equal(shown.get_ydata(), np.asarray(noisy.reading_mg_dl)[valid])
    assert "sensor readings" in words(plot(noisy))


def test_the_pumps_upper_limit_is_drawn_when_it_comes_into_view(quiet, noisy):
    assert 66.9 not in levels(plot(quiet).axes[1])
    assert 66.9 in levels(plot(noisy).axes[1])
    assert "pump limits 0 and 66.9 mU/min" in words(plot(noisy))


def test_compared_runs_differ_in_colour_and_in_dashes(quiet, noisy):
    figure = plot({"calm": quiet, "wild": noisy})
    lines = [curve(figure.axes[0], np.asarray(trace.fine_glucose_mg_dl)) for trace in (quiet, noisy)]
    assert lines[0].get_color() != lines[1].get_color()
    assert lines[0].get_linestyle() != lines[1].get_linestyle()
    (legend,) = figure.legends
    assert [text.get_text() for text in legend.get_texts()][:2] == ["calm", "wild"]


def test_many_runs_all_look_different(quiet):
    figure = plot({f"run {i}": quiet for i in range(12)})
    same = [line for line in figure.axes[0].lines if len(line.get_xdata()) == 601]
    assert len({(line.get_color(), str(line._dash_pattern)) for line in same}) == 12


def test_mmol_per_litre_stands_on_the_right(quiet):
    figure = plot(quiet, mmol=True)
    figure.draw_without_rendering()
    above = figure.axes[0]
    (right,) = above.child_axes
    assert right.get_ylabel() == "Glucose (mmol/l)"
    np.testing.assert_allclose(right.get_ylim(), np.array(above.get_ylim()) / MG_DL_PER_MMOL_L)


def test_insulin_on_board_stands_beside_boluses(make_trace):
    fields = {"bolus_mU": np.where(np.arange(120) == 10, 4200.0, 0.0)}
    shot = make_trace(np.full(601, 80.0), np.full(120, 20.0), subcutaneous=True, **fields)
    figure = plot(shot, subcutaneous=True)
    _, _, units = figure.axes
    (line,) = (line for line in units.lines if line.get_linestyle() == "--")
    np.testing.assert_allclose(line.get_ydata(), shot.insulin_on_board_U)
    assert units.get_ylim()[1] > 4.2
    assert {"bolus", "insulin on board"} <= set(words(figure))
    vein = plot(make_trace(np.full(601, 80.0), np.full(120, 20.0), **fields))
    assert "insulin on board" not in words(vein)


def test_subcutaneous_insulin_is_in_units_per_hour_with_the_target_range(quiet):
    below = plot(quiet).axes[1]
    above, u_h = plot(quiet, subcutaneous=True).axes
    assert u_h.get_ylabel() == "Insulin (U/h)"
    np.testing.assert_allclose(u_h.get_ylim(), 0.06 * np.array(below.get_ylim()))
    assert {"70 to 180 mg/dl", "basal 1.2 U/h"} <= set(words(plot(quiet, subcutaneous=True)))
    (band,) = above.patches
    assert (band.get_y(), band.get_height()) == (70.0, 110.0)
    assert above.get_ylim()[1] > 180.0
    assert "lowest allowed 60 mg/dl" not in words(plot(quiet, subcutaneous=True))


def test_days_of_subcutaneous_insulin_begin_at_midnight(make_trace):
    trace = make_trace(np.full(2881, 80.0))
    assert plot(trace, subcutaneous=True).axes[1].get_xlabel() == "Time of day"
    assert plot(trace).axes[1].get_xlabel() == "Time (days)"


@pytest.mark.parametrize(
    ("horizon_min", "start_min", "first", "place_min"),
    [
        (600, 450.0, "08:00", 30.0),
        (1440, 0.0, "00:00", 0.0),
        (1440, 450.0, "08:00", 30.0),
        (4320, 450.0, "12:00\nday 1", 270.0),
    ],
)
def test_the_clock_is_shown_from_the_time_of_the_start(make_trace, horizon_min, start_min, first, place_min):
    figure = plot(make_trace(np.full(horizon_min + 1, 80.0)), start_min=start_min)
    figure.draw_without_rendering()
    below = figure.axes[1]
    divisor = 1.0 if horizon_min <= 720 else 60.0 if horizon_min <= 1440 else 1440.0
    ticks = [(tick.get_loc() * divisor, tick.label1.get_text()) for tick in below.xaxis.get_major_ticks()]
    assert ticks[0] == (pytest.approx(place_min), first)
    assert below.get_xlabel() == "Time of day"
    for place, text in ticks:
        clock_min = (start_min + place) % 1440.0
        assert text.startswith(f"{int(clock_min // 60):02d}:{int(clock_min % 60):02d}")
    assert_nothing_is_clipped(figure)


@pytest.mark.long
@pytest.mark.parametrize(("width", "mm"), [("single", 88.0), ("double", 180.0)])
def test_a_column_has_its_width_and_its_words_fit(quiet, noisy, width, mm):
    long = "A controller whose name will not fit on one line of a single column, nor should it have to"
    figure = plot({long: quiet, "_wild $x": noisy, r"$\frac$": quiet}, title=long * 2, width=width, mmol=True)
    assert figure.get_figwidth() * 25.4 == pytest.approx(mm)
    assert_nothing_is_clipped(figure)
    assert all(text.get_fontsize() >= 7.0 for text in texts(figure))
    assert len(figure.legends[0].get_texts()) == 3 + 5


@pytest.mark.parametrize(
    ("horizon_min", "unit"), [(600, "min"), (720, "min"), (1440, "h"), (10080, "days"), (40320, "days")]
)
def test_long_runs_are_in_hours_and_days(make_trace, horizon_min, unit):
    figure = plot(make_trace(np.full(horizon_min + 1, 80.0)), width="single")
    below = figure.axes[1]
    assert below.get_xlabel() == f"Time ({unit})"
    assert below.get_xlim()[1] == horizon_min / {"min": 1.0, "h": 60.0, "days": 1440.0}[unit]
    assert_nothing_is_clipped(figure)
    assert len(below.get_xticks()) <= 9


@pytest.mark.parametrize(("apart", "rotation", "count"), [(48, 0, 6), (12, 90, 24), (3, None, 0)])
def test_meals_that_are_close_stand_upright_or_silent(make_trace, apart, rotation, count):
    carbs_g = np.zeros(288)
    carbs_g[::apart] = 45.5
    figure = plot(make_trace(np.full(1441, 80.0), carbs_g=carbs_g))
    notes = [text for text in figure.axes[0].texts if text.get_text() == "45.5 g"]
    assert len(notes) == count
    assert all(note.get_rotation() == rotation for note in notes)
    assert_nothing_is_clipped(figure)


@pytest.mark.long
@pytest.mark.parametrize("form", ["png", "svg", "pdf"])
def test_a_figure_can_be_written_without_a_display(quiet, form):
    out = io.BytesIO()
    plot(quiet).savefig(out, format=form)
    assert out.tell() > 1000
    pyplot = sys.modules.get("matplotlib.pyplot")
    assert pyplot is None or not pyplot.get_fignums()


@pytest.mark.long
def test_fonts_of_a_pdf_are_truetype_and_the_file_is_the_same_again(quiet):
    pdf = _figure_bytes(plot(quiet), "pdf")
    assert b"/FontFile2" in pdf  # TrueType
    assert b"/Type3" not in pdf
    assert pdf == _figure_bytes(plot(quiet), "pdf")


@pytest.mark.long
def test_the_files_of_a_figure_have_one_layout_and_leave_it_its_own(quiet):
    figure = plot(quiet)
    layout = figure.get_layout_engine()
    files = figure_files("run", figure)
    assert set(files) == {"run.png", "run.svg", "run.pdf"}
    assert files["run.png"] == _figure_bytes(plot(quiet), "png")
    assert files == figure_files("run", plot(quiet))
    assert figure.get_layout_engine() is layout


def test_settings_for_print_end_with_the_file(quiet):
    before = matplotlib.rcParams["pdf.fonttype"]
    plot(quiet).savefig(io.BytesIO(), format="pdf")
    assert matplotlib.rcParams["pdf.fonttype"] == before


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_run_that_left_the_numbers_is_drawn_as_far_as_it_goes(make_trace, bad):
    glucose = np.full(601, 80.0)
    glucose[300:] = bad
    figure = plot(make_trace(glucose, np.where(np.arange(120) < 60, 20.0, bad)))
    figure.draw_without_rendering()
    assert np.isfinite(figure.axes[0].get_ylim()).all()


def test_what_cannot_be_drawn_is_refused(make_trace, quiet):
    with pytest.raises(ValueError, match="no trace to show"):
        plot({})
    with pytest.raises(ValueError, match=r"'glucose' is of people of shape \(2,\)"):
        plot(make_trace(np.full((61, 2), 80.0), meal_sample=2))
    with pytest.raises(ValueError, match="'later' and 'now' have different meals"):
        plot({"now": quiet, "later": make_trace(np.full(601, 80.0), meal_sample=20)})
    with pytest.raises(ValueError, match="unknown width 'triple'; use one of 'single', 'double'"):
        plot(quiet, width="triple")


def test_some_of_the_forecasts_are_a_fan_of_thin_lines(quiet):
    """A controller that acts every 10 min: 60 forecasts, of which each third is drawn, as far as the run goes."""
    t_min, ahead = np.asarray(quiet.t_min), np.arange(0.0, 45.0, 5.0)
    glucose = 80.0 + t_min[:, None] / 10.0 + ahead
    acts = np.arange(t_min.size)[:, None] % 2 == 0
    forecast = DoseForecast(
        ahead_min=np.where(acts, ahead, np.nan), glucose_mg_dl=np.where(acts, glucose, np.nan), insulin_mU_min=glucose
    )
    figure = plot(dataclasses.replace(quiet, forecast=forecast))
    thin = [line for line in figure.axes[0].lines if line.get_linewidth() == 0.6 and line.get_alpha()]
    assert len(thin) == 20
    for number, line in enumerate(thin):
        there = 30.0 * number + ahead <= 600.0
        np.testing.assert_allclose(line.get_xdata(), (30.0 * number + ahead)[there])
        np.testing.assert_allclose(line.get_ydata(), (80.0 + 3.0 * number + ahead)[there])
    assert "forecasts, every 30 min" in words(figure)
    assert figure.axes[0].get_ylim()[1] > 80.0 + 57.0 + 25.0
    assert "forecasts" not in " ".join(words(plot(quiet)))
    assert_nothing_is_clipped(figure)
