"""What the print figure of a trial shows, and that it can be read."""

import dataclasses
import io
import sys

import numpy as np
import pytest

from glucoloop.studies.trial.figure import plot_trial
from glucoloop.studies.trial.report import RANGES


def texts(figure):
    from matplotlib.text import Text

    return [text for text in figure.findobj(Text) if text.get_visible() and text.get_text().strip()]


@pytest.fixture(scope="module")
def report(make_report):
    return make_report("calm", "wild")


def test_each_controller_has_its_bands_and_its_grid(report):
    figure = plot_trial(report)
    glucose, insulin, grids = figure.axes[:2], figure.axes[2:4], figure.axes[4:6]
    for axes, case in zip(glucose, report.cases.values(), strict=True):
        median = next(line for line in axes.lines if len(line.get_xdata()) == 289)
        np.testing.assert_array_equal(median.get_ydata(), case.glucose_quantiles[0.5])
        np.testing.assert_allclose(median.get_xdata(), case.bands_t_min / 60.0)
        assert len(axes.collections) == 3
    assert glucose[0].get_ylim() == glucose[1].get_ylim()
    assert insulin[0].get_ylim() == insulin[1].get_ylim()
    assert glucose[0].get_ylabel() == "Glucose (mg/dl)"
    assert insulin[0].get_ylabel() == "Insulin (mU/min)"
    assert insulin[0].get_xlabel() == "Time (h)"
    for axes, case in zip(grids, report.cases.values(), strict=True):
        (people,) = axes.collections
        assert people.get_array().sum() == case.cvga_counts.sum()
        assert axes.get_xlim() == (60.0, 0.0)
        assert axes.get_ylabel() in ("Maximum (mg/dl)", "")
    words = [text.get_text() for text in texts(figure)]
    for expected in ("Trial of two", "calm", "wild", "median", "middle 90 %", "setpoint 81.1 mg/dl"):
        assert expected in words


def test_subcutaneous_insulin_is_drawn_as_the_field_draws_it(make_report):
    vein = plot_trial(make_report("calm", "wild")).axes[2]
    figure = plot_trial(make_report("calm", "wild", subcutaneous=True, meals=[(60.0, 40.0)]))
    glucose, insulin = figure.axes[:2], figure.axes[2:4]
    figure.draw_without_rendering()
    assert [axes.get_ylabel() for axes in insulin] == ["Insulin (U/h)", "Insulin (U/h)"]
    np.testing.assert_allclose(insulin[1].get_ylim(), 0.06 * np.array(vein.get_ylim()))
    words = [text.get_text() for text in texts(figure)]
    assert "70 to 180 mg/dl" in words
    assert not any(word.startswith("lowest allowed") for word in words)
    [meal] = [line for line in glucose[0].lines if line.get_marker() == "v"]
    assert meal.get_xdata().tolist() == [1.0]
    assert insulin[0].get_xlabel() == "Time (h)"


def test_days_of_subcutaneous_insulin_are_by_the_clock(make_report):
    def insulin_of_two_days(**fields):
        report = make_report("calm", **fields)
        [case] = report.cases.values()
        longer = dataclasses.replace(case, bands_t_min=2.0 * case.bands_t_min, insulin_t_min=2.0 * case.insulin_t_min)
        return plot_trial(dataclasses.replace(report, cases={"calm": longer})).axes[1]

    insulin = insulin_of_two_days(subcutaneous=True, start_min=420.0)
    assert insulin.get_xlabel() == "Time of day"
    assert any(label.get_text().endswith("day 2") for label in insulin.get_xticklabels())
    assert insulin_of_two_days().get_xlabel() == "Time (days)"


def test_bars_are_as_long_as_the_times(report):
    bars = plot_trial(report).axes[-1].patches
    times = [case.time_in_range_pct[name] for case in report.cases.values() for name in RANGES]
    assert [bar.get_width() for bar in bars] == pytest.approx(times)


@pytest.mark.long
@pytest.mark.parametrize("width", ["single", "double"])
@pytest.mark.parametrize("people", [1, 2, 5])
def test_nothing_is_clipped(make_report, people, width):
    labels = ["linear MPC", r"$\frac$", "_x", "A controller whose name will not fit on one line of a column", "e"]
    figure = plot_trial(make_report(*labels[:people]), width=width)
    figure.draw_without_rendering()
    drawn = figure.get_tightbbox()
    assert drawn.x0 >= 0.0
    assert drawn.y0 >= 0.0
    assert drawn.x1 <= figure.get_figwidth()
    assert drawn.y1 <= figure.get_figheight()
    assert all(text.get_fontsize() >= 7.0 for text in texts(figure))


def test_the_title_can_be_another_or_none(report):
    assert plot_trial(report, title="Other").get_suptitle() == "Other"
    assert plot_trial(report, title="").get_suptitle() == ""


def test_an_unknown_width_is_refused(report):
    with pytest.raises(ValueError, match="unknown width 'triple'"):
        plot_trial(report, width="triple")


@pytest.mark.long
def test_it_is_written_apart_from_pyplot(report):
    file = io.BytesIO()
    plot_trial(report).savefig(file, format="png", dpi=50)
    assert file.getvalue().startswith(b"\x89PNG")
    pyplot = sys.modules.get("matplotlib.pyplot")
    assert pyplot is None or not pyplot.get_fignums()
