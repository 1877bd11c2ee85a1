"""The summary of a trial is what NumPy finds in all people at once, however they are dealt into shards."""

import copy
import dataclasses

import numpy as np
import pytest
from scipy import stats

from glucoloop.metrics.control_variability import grid_counts
from glucoloop.metrics.metric import default_results
from glucoloop.trials.people import PeopleRows
from glucoloop.trials.summary import DISTRIBUTIONS, MAX_NAMED, summarise_people

METRIC_NAMES = [result.name for result in default_results()]

PEOPLE = 3000
YES_OR_NO = frozenset(name for name in METRIC_NAMES if name.startswith("settled") or name.endswith("satisfied"))


def population(seed, people=PEOPLE, infeasible=0.01):
    rng = np.random.default_rng(seed)
    # Whether a person is feasible, and the basal rate, do not depend on the controller.
    common = np.random.default_rng(99)
    feasible = common.random(people) >= infeasible
    basal = np.where(feasible, common.normal(40.0, 15.0, people), np.nan)
    metrics = {name: np.where(feasible, rng.gamma(2.0, 10.0, people), np.nan) for name in METRIC_NAMES}
    metrics |= {name: np.where(feasible, rng.random(people) < 0.3, np.nan) for name in YES_OR_NO}
    metrics["minimum_mg_dl"] = np.where(feasible, rng.normal(65.0, 8.0, people), np.nan)
    metrics["peak_mg_dl"] = metrics["minimum_mg_dl"] + rng.gamma(2.0, 40.0, people)
    metrics["time_below_60_pct"] = np.where(metrics["minimum_mg_dl"] < 60.0, 3.0, 0.0)
    metrics["time_below_60_pct"][~feasible] = np.nan
    metrics["time_below_validity_pct"] = np.where(feasible & (metrics["minimum_mg_dl"] < 44.5), 1.0, 0.0 * basal)
    return PeopleRows(np.arange(people), feasible, basal, {"F_LC": rng.random(people)}, metrics, YES_OR_NO)


def dealt(cases, size):
    """The shards of some people."""

    def part(people, rows):
        return dataclasses.replace(
            people,
            person=people.person[rows],
            feasible=people.feasible[rows],
            basal_insulin_mU_min=people.basal_insulin_mU_min[rows],
            drawn={name: values[rows] for name, values in people.drawn.items()},
            metrics={name: values[rows] for name, values in people.metrics.items()},
        )

    def read():
        for start in range(0, PEOPLE, size):
            yield {label: part(people, slice(start, start + size)) for label, people in cases.items()}

    return read


@pytest.fixture(scope="module")
def cases():
    return {"mpc": population(1), "pid": population(2)}


@pytest.fixture(scope="module")
def summary(cases):
    return summarise_people(dealt(cases, 700), max_insulin_mU_min=66.9)


def mean_of(values):
    """Mean with the interval that SciPy finds."""
    low, high = stats.ttest_1samp(values, 0.0).confidence_interval()
    return {"mean": values.mean(), "low": low, "high": high}


def controllers(summary):
    return summary.plain["controllers"]


def test_metrics_are_those_of_all_people(cases, summary):
    for label, people in cases.items():
        for name, values in people.metrics.items():
            feasible, told = values[people.feasible], controllers(summary)[label]["metrics"][name]
            if name in YES_OR_NO:
                assert told["people"] == feasible.sum()
                assert told["low"] < (share := told["share_pct"]) < told["high"]
                assert share == pytest.approx(100.0 * feasible.mean())
                continue
            expected = {
                **mean_of(feasible), "sd": feasible.std(ddof=1), "min": feasible.min(), "max": feasible.max(),
                **{f"p{p}": np.percentile(feasible, p) for p in (1, 5, 25, 75, 95, 99)}, "median": np.median(feasible),
            }  # fmt: skip
            assert told == pytest.approx(expected, rel=1e-12)


def test_a_metric_that_some_people_do_not_have_is_summarised_over_those_who_have_it(cases):
    first_low = np.where(cases["mpc"].metrics["minimum_mg_dl"] < 60.0, cases["mpc"].metrics["sse"], np.nan)
    nobody = np.full(PEOPLE, np.nan)
    people = dataclasses.replace(
        cases["mpc"], metrics={**cases["mpc"].metrics, "first_low_min": first_low, "never_min": nobody}
    )
    told = summarise_people(dealt({"mpc": people}, 700), max_insulin_mU_min=66.9).plain["controllers"]["mpc"]["metrics"]
    having = first_low[np.isfinite(first_low)]
    assert told["first_low_min"] == pytest.approx(
        {
            **mean_of(having), "sd": having.std(ddof=1), "min": having.min(), "max": having.max(),
            **{f"p{p}": np.percentile(having, p) for p in (1, 5, 25, 75, 95, 99)}, "median": np.median(having),
            "people": having.size,
        },
        rel=1e-12,
    )  # fmt: skip
    assert told["never_min"].pop("people") == 0
    assert np.isnan(list(told["never_min"].values())).all()


def test_who_is_not_able_and_who_is_beyond_the_pump_are_named(cases, summary):
    people = cases["mpc"]
    assert summary.plain["people"] == PEOPLE
    assert summary.plain["unable"]["person"] == np.flatnonzero(~people.feasible).tolist()
    assert summary.plain["unable"]["count"] == (~people.feasible).sum()
    assert summary.plain["basal_beyond_pump"]["person"] == np.flatnonzero(people.basal_insulin_mU_min > 66.9).tolist()


def test_people_below_the_validity_of_their_model_are_named(cases, summary):
    for label, people in cases.items():
        low = np.flatnonzero(people.metrics["time_below_validity_pct"] > 0.0)
        assert 0 < low.size < PEOPLE
        assert controllers(summary)[label]["below_validity"] == {"count": low.size, "person": low.tolist()}


def test_folders_without_that_metric_are_summed_up(cases):
    older = {
        label: dataclasses.replace(
            people, metrics={name: of for name, of in people.metrics.items() if name != "time_below_validity_pct"}
        )
        for label, people in cases.items()
    }
    summary = summarise_people(dealt(older, PEOPLE), max_insulin_mU_min=66.9)
    assert controllers(summary)["mpc"]["below_validity"]["count"] == 0


def test_worst_are_those_with_the_least_glucose(cases, summary):
    people = cases["pid"]
    worst = controllers(summary)["pid"]["worst"]
    order = np.argsort(people.metrics["minimum_mg_dl"])[:10]
    assert [person["person"] for person in worst] == order.tolist()
    first = worst[0]
    assert first["parameters"] == {"F_LC": people.drawn["F_LC"][order[0]]}
    assert first["metrics"]["gri"] == people.metrics["gri"][order[0]]
    assert first["metrics"]["settled_2pct"] is bool(people.metrics["settled_2pct"][order[0]])


def test_low_glucose_grid_and_distributions_count_people(cases, summary):
    people = cases["mpc"]
    case, minimum = controllers(summary)["mpc"], people.metrics["minimum_mg_dl"][people.feasible]
    for limit in (70, 60, 54):
        share = case["ever_below"][f"{limit}_mg_dl"]
        assert share["people"] == (minimum < limit).sum()
        assert share["share_pct"] == pytest.approx(100.0 * (minimum < limit).mean())
    of_grid = grid_counts(minimum, people.metrics["peak_mg_dl"][people.feasible])
    np.testing.assert_array_equal(summary.cvga_counts["mpc"], of_grid)
    assert set(summary.distributions["mpc"]) == set(DISTRIBUTIONS)
    for metric, counted in summary.distributions["mpc"].items():
        other = summary.distributions["pid"][metric]
        np.testing.assert_array_equal(counted.edges, other.edges)
        assert counted.counts.sum() == people.feasible.sum()
        inside = people.metrics[metric][people.feasible].clip(counted.edges[0], counted.edges[-1])
        np.testing.assert_array_equal(counted.counts, np.histogram(inside, counted.edges)[0])


@pytest.mark.parametrize("size", [1500, PEOPLE])
def test_dealing_changes_rounding_alone(cases, summary, size):
    other = summarise_people(dealt(cases, size), max_insulin_mU_min=66.9).plain
    told = copy.deepcopy(summary.plain)
    for label in cases:
        for name, values in told["controllers"][label]["metrics"].items():
            assert other["controllers"][label]["metrics"].pop(name) == pytest.approx(values, rel=1e-12)
        told["controllers"][label]["metrics"] = {}
    paired = [plain["differences"]["controllers"]["pid"].pop("metrics") for plain in (told, other)]
    assert paired[0].keys() == paired[1].keys()
    for name, values in paired[0].items():
        assert paired[1][name] == pytest.approx(values, rel=1e-9, abs=1e-12)
    assert other == told


def test_people_whose_glucose_is_not_finite_are_named_and_left_out(cases):
    people = cases["mpc"]
    lost = np.flatnonzero(people.feasible)[[3, 8]]
    metrics = {name: values.copy() for name, values in people.metrics.items()}
    metrics["minimum_mg_dl"][lost] = np.nan
    broken = dataclasses.replace(people, metrics=metrics)
    case = controllers(summarise_people(dealt({"mpc": broken}, 700), max_insulin_mU_min=66.9))["mpc"]
    assert case["not_finite"]["person"] == lost.tolist()
    assert (
        case["metrics"]["gri"]["max"] == np.delete(people.metrics["gri"], lost)[np.delete(people.feasible, lost)].max()
    )


def test_many_are_counted_and_the_first_named():
    told = summarise_people(dealt({"mpc": population(1, infeasible=0.5)}, 700), max_insulin_mU_min=66.9)
    assert told.plain["unable"]["count"] > 1200
    assert len(told.plain["unable"]["person"]) == MAX_NAMED


def test_nobody_feasible():
    told = summarise_people(dealt({"mpc": population(1, infeasible=1.1)}, 700), max_insulin_mU_min=66.9)
    assert told.plain["unable"]["count"] == PEOPLE
    assert controllers(told)["mpc"]["worst"] == []
    assert np.isnan(controllers(told)["mpc"]["metrics"]["gri"]["median"])
    with pytest.raises(ValueError, match="nobody to summarise"):
        summarise_people(lambda: [], max_insulin_mU_min=66.9)


def test_differences_are_paired_and_of_the_people_known_in_both_cases(cases, summary):
    first, second = cases.values()
    differences = summary.plain["differences"]
    assert (differences["reference"], differences["controllers"].keys()) == ("mpc", {"pid"})
    of_pid = differences["controllers"]["pid"]
    assert of_pid["people"] == first.feasible.sum()
    for name, difference in of_pid["metrics"].items():
        of_pairs = [case.metrics[name][first.feasible].astype(float) for case in (second, first)]
        low, high = stats.ttest_rel(*of_pairs).confidence_interval()
        mean = (of_pairs[0] - of_pairs[1]).mean()
        assert [difference[key] for key in ("mean", "low", "high")] == pytest.approx([mean, low, high], rel=1e-9)
    low = [case.metrics["minimum_mg_dl"][first.feasible] < 60.0 for case in (first, second)]
    assert of_pid["ever_below"]["60_mg_dl"]["mean"] == pytest.approx(100.0 * (low[1].mean() - low[0].mean()))


def test_one_case_differs_from_nothing(cases):
    plain = summarise_people(dealt({"mpc": cases["mpc"]}, 700), max_insulin_mU_min=66.9).plain
    assert plain["differences"]["controllers"] == {}
