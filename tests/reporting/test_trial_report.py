"""The record of a trial."""

from glucoloop.studies.trial.report import RANGES, ranges_pct


def test_times_that_include_one_another_are_told_apart():
    times = ranges_pct(
        {
            "time_below_54_pct": 1.0,
            "time_below_70_pct": 4.0,
            "time_70_180_pct": 86.0,
            "time_above_180_pct": 10.0,
            "time_above_250_pct": 2.5,
        }.get
    )
    assert times == dict(zip(RANGES, (1.0, 3.0, 86.0, 7.5, 2.5), strict=True))
