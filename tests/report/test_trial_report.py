"""The record of a trial: what is missing or differs is refused, in words that tell what to give."""

import dataclasses

import numpy as np
import pytest

from glucoloop.report.trial_report import RANGES, ranges_pct


def with_case(make_report, **changes):
    first, second = make_report("a", "b").cases.values()
    return make_report(cases={"a": first, "b": dataclasses.replace(second, **changes)})


def test_times_that_include_one_another_are_told_apart():
    times = ranges_pct(
        time_below_54_pct=1.0,
        time_below_70_pct=4.0,
        time_70_180_pct=86.0,
        time_above_180_pct=10.0,
        time_above_250_pct=2.5,
    )
    assert times == dict(zip(RANGES, (1.0, 3.0, 86.0, 7.5, 2.5), strict=True))


def test_a_trial_of_nothing_is_refused(make_report):
    with pytest.raises(ValueError, match="no controller"):
        make_report()


def test_a_missing_quantile_is_refused(make_report, make_case):
    quantiles = {q: values for q, values in make_case(10.0).insulin_quantiles.items() if q != 0.95}
    with pytest.raises(ValueError, match=r"'b' lacks the quantile 0\.95 of insulin"):
        with_case(make_report, insulin_quantiles=quantiles)


def test_quantiles_at_other_times_are_refused(make_report, make_case):
    quantiles = {q: values[:-1] for q, values in make_case(10.0).glucose_quantiles.items()}
    with pytest.raises(ValueError, match=r"288 values .* at 289 times"):
        with_case(make_report, glucose_quantiles=quantiles)


def test_other_headline_numbers_are_refused(make_report):
    with pytest.raises(ValueError, match="headline numbers"):
        with_case(make_report, table={"Settled": "all"})


def test_other_edges_are_refused(make_report, make_case):
    counts = dict(make_case(10.0).metric_counts)
    of_one = counts["undershoot_mg_dl"]
    counts["undershoot_mg_dl"] = dataclasses.replace(of_one, edges=of_one.edges * 2.0)
    with pytest.raises(ValueError, match="undershoot_mg_dl of 'b' and of 'a'"):
        with_case(make_report, metric_counts=counts)


def test_edges_that_do_not_bound_the_bins_are_refused(make_report, make_case):
    counts = dict(make_case(10.0).metric_counts)
    counts["undershoot_mg_dl"] = dataclasses.replace(counts["undershoot_mg_dl"], counts=np.zeros(3))
    with pytest.raises(ValueError, match="one edge more than bins"):
        with_case(make_report, metric_counts=counts)


def test_an_unknown_metric_is_refused(make_report, make_case):
    counts = {"undershot": next(iter(make_case(10.0).metric_counts.values()))}
    with pytest.raises(ValueError, match="unknown metric 'undershot'; use one of time_70_180_pct"):
        with_case(make_report, metric_counts=counts)


def test_other_ranges_are_refused(make_report):
    with pytest.raises(ValueError, match="give below 54, 54 to 70"):
        with_case(make_report, time_in_range_pct={"below 54": 1.0})
