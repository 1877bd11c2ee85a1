"""The figure of records shows the percentiles and the times in ranges that are computed."""

import numpy as np
import pytest

from glucoloop.metrics.readings import Readings, day_profile, numbers_of
from glucoloop.reporting.record_figure import plot_records
from glucoloop.reporting.record_groups import GOALS, ReportedRecord
from glucoloop.reporting.record_page import MAX_IN_FULL
from monitor_records import with_gaps


@pytest.fixture(scope="module")
def records():
    made = [Readings.of(*with_gaps(4, seed)) for seed in range(MAX_IN_FULL + 1)]
    return [ReportedRecord(f"cost of ${place}$", of, numbers_of(of)) for place, of in enumerate(made)]


def test_curves_and_bars_are_what_was_computed(records):
    figure = plot_records(records[:2], GOALS["adult"])
    for record, curves, bar in zip(records, figure.axes[0::2], figure.axes[1::2], strict=False):
        profile = day_profile(record.readings)
        drawn = [line for line in curves.lines if len(line.get_xdata()) == profile.t_min.size]
        np.testing.assert_array_equal(drawn[0].get_xdata(), profile.t_min / 60.0)
        np.testing.assert_array_equal(drawn[0].get_ydata(), profile.percentiles_mg_dl[50])
        heights = [patch.get_height() for patch in bar.patches]
        expected = [record.numbers[one.result] for one in reversed(GOALS["adult"].ranges)]
        assert heights == pytest.approx(expected)
        assert sum(heights) == pytest.approx(100.0)
    assert figure.axes[0].get_title(loc="left") == r"cost of \$0\$, day 1 to day 4"
    assert figure.axes[0].get_ylim() == figure.axes[2].get_ylim()


def test_a_figure_has_as_many_records_as_the_page(records):
    figure = plot_records(records, GOALS["pregnancy"])
    assert len(figure.axes) == 2 * MAX_IN_FULL
