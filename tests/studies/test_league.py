"""The league: its numbers against NumPy and SciPy, the ranking by hand, and what it refuses."""

import numpy as np
import polars as pl
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from glucoloop.control.catalogue import CONTROLLERS
from glucoloop.patients.catalogue import PATIENTS
from glucoloop.refusal import Refusal
from glucoloop.situations.case import label_of
from glucoloop.situations.situation import configured
from glucoloop.storage.results import Results
from glucoloop.studies.league import League, reach
from glucoloop.studies.league.numbers import (
    A_DAY,
    ALL,
    LINE,
    METRICS,
    _worst_mean,
    harms,
    line_table,
    over_all_cells,
    ranking,
)
from glucoloop.studies.league.report import _first, page, sentences
from glucoloop.studies.league.study import _LeagueSearch, _lines_of, _shards_of, rows
from glucoloop.trials import engine

ON_TARGET = {
    "time_70_180_pct": 90.0,
    "time_below_70_pct": 1.0,
    "time_below_54_pct": 0.0,
    "time_above_180_pct": 9.0,
    "time_above_250_pct": 0.0,
    "gri": 10.0,
    "minimum_mg_dl": 60.0,
}


def people_of(controller, number=12, scenario="day", **metrics):
    """People of one line, whose metrics are on all targets unless they are given."""
    columns = {name: np.full(number, ON_TARGET.get(name, 1.0)) for name in (*METRICS, *A_DAY)}
    columns |= {name: np.asarray(values, float) for name, values in metrics.items()}
    line = {"family": "f", "sensor": "s", "scenario": scenario, "controller": controller}
    head = {name: [value] * number for name, value in line.items()}
    return pl.DataFrame({**head, "person": np.arange(number), **columns})


def numbers(*people, reference="ref", worse_by_pct=1.0):
    table = pl.concat(people)
    lines = table.select(LINE).unique(maintain_order=True)
    return {row["controller"]: row for row in line_table(table, lines, reference, worse_by_pct).to_dicts()}


@settings(max_examples=25)
@given(st.integers(0, 2**32 - 1), st.integers(3, 40))
def test_the_numbers_of_a_line_are_those_of_numpy_and_scipy(seed, number):
    rng = np.random.default_rng(seed)
    drawn = {name: rng.uniform(0.0, 100.0, (2, number)) for name in (*METRICS, *A_DAY)}
    ours, reference = ({name: values[which] for name, values in drawn.items()} for which in (0, 1))
    row = numbers(people_of("c", number, **ours), people_of("ref", number, **reference))["c"]
    assert row["people"] == number
    assert row["gri_mean"] == pytest.approx(ours["gri"].mean())
    assert row["lbgi_mean"] == pytest.approx(ours["lbgi"].mean())
    assert row["insulin_U_day"] == pytest.approx(ours["insulin_U_day"].mean())
    assert row["time_70_180_p5_pct"] == pytest.approx(np.quantile(ours["time_70_180_pct"], 0.05))
    assert row["ever_below_54"] == (ours["minimum_mg_dl"] < 54.0).sum()
    targets = (
        (ours["time_70_180_pct"] > 70.0)
        & (ours["time_below_70_pct"] < 4.0)
        & (ours["time_below_54_pct"] < 1.0)
        & (ours["time_above_180_pct"] < 25.0)
        & (ours["time_above_250_pct"] < 5.0)
    )
    assert row["on_target_pct"] == pytest.approx(100.0 * targets.mean())
    for bound in (54, 70):
        more = ours[f"time_below_{bound}_pct"] - reference[f"time_below_{bound}_pct"]
        assert row[f"harmed_below_{bound}"] == (more > 1.0).sum()
        assert row[f"more_below_{bound}_most_pct"] == pytest.approx(more.max())
        assert row[f"more_below_{bound}_p95_pct"] == pytest.approx(np.quantile(more, 0.95))
        harmed = row[f"harmed_below_{bound}_people"]
        assert harmed == sorted(np.flatnonzero(more > 1.0), key=lambda person: -more[person])
    for name, metric in (
        ("in_range_difference_pct", "time_70_180_pct"),
        ("below_54_difference_pct", "time_below_54_pct"),
        ("gri_difference", "gri"),
    ):
        interval = stats.ttest_rel(ours[metric], reference[metric]).confidence_interval(0.95)
        found = row[name], row[f"{name}_low"], row[f"{name}_high"]
        assert found == pytest.approx(((ours[metric] - reference[metric]).mean(), *interval))


def test_a_target_is_met_strictly_by_every_person_alone():
    row = numbers(people_of("ref", 4, time_70_180_pct=[70.0, 70.1, 99.0, 20.0], time_below_54_pct=[0.0, 0.9, 1.0, 0.0]))
    assert row["ref"]["on_target_pct"] == 25.0


def test_a_person_is_compared_only_where_the_reference_is_known():
    row = numbers(people_of("c", 3, time_below_54_pct=[5.0, 3.0, 90.0]), people_of("ref", 2))["c"]
    assert (row["people"], row["harmed_below_54"], row["harmed_below_54_people"]) == (3, 2, [0, 1])
    interval = stats.ttest_1samp([5.0, 3.0], 0.0).confidence_interval(0.95)
    assert (row["below_54_difference_pct_low"], row["below_54_difference_pct_high"]) == pytest.approx(tuple(interval))


def test_without_the_reference_nobody_is_compared_and_nobody_said_to_be_unharmed():
    row = numbers(people_of("c", 3, gri=[1.0, 2.0, 3.0]))["c"]
    assert (row["people"], row["gri_mean"]) == (3, 2.0)
    assert (row["harmed_below_54"], row["gri_difference"], row["gri_difference_low"]) == (None, None, None)


def test_a_line_without_people_has_no_numbers():
    table = people_of("ref", 3)
    lines = pl.concat([table.select(LINE).unique(), people_of("c", 1).select(LINE)])
    _, row = line_table(table, lines, "ref", 1.0).to_dicts()
    assert (row["people"], row["gri_mean"], row["harmed_below_54"]) == (0, None, None)
    assert harms([row], "ref") == []


def test_all_cells_together_are_the_means_of_those_who_are_known_in_all():
    day = people_of("c", 3, gri=[10.0, 20.0, 30.0], minimum_mg_dl=[50.0, 60.0, 70.0])
    week = people_of("c", 2, "week", gri=[30.0, 0.0], minimum_mg_dl=[80.0, 55.0])
    together = over_all_cells(pl.concat([day, week]), 2)
    assert together["person"].to_list() == [0, 1]
    assert together["gri"].to_list() == [20.0, 10.0]
    assert together["minimum_mg_dl"].to_list() == [50.0, 55.0]
    assert together["sensor"].to_list() == [ALL, ALL]


def ranked(**gri):
    people = [people_of(name, len(values), gri=values) for name, values in gri.items()]
    return ranking(pl.concat(people), "f", seed=1)


def test_the_best_on_average_need_not_be_best_for_the_worst_off():
    steady = np.full(100, 30.0) + np.linspace(0.0, 1.0, 100)
    bold = np.where(np.arange(100) < 90, 5.0, 80.0)
    found = ranked(steady=steady, bold=bold, poor=steady + 40.0)
    assert (found["overall"]["best"], found["overall"]["second"]) == ("bold", "steady")
    assert found["overall"]["difference"] == pytest.approx(steady.mean() - bold.mean())
    interval = stats.ttest_rel(steady, bold).confidence_interval(0.95)
    assert (found["overall"]["low"], found["overall"]["high"]) == pytest.approx(tuple(interval))
    assert found["overall"]["distinguished"]
    assert (found["worst_off"]["best"], found["worst_off"]["people"]) == ("steady", 10)
    assert found["worst_off"]["gri"]["bold"] == pytest.approx(80.0)
    assert found["worst_off"]["gri"]["steady"] == pytest.approx(np.sort(steady)[-10:].mean())
    assert found["for_whom"] == {"steady": 10, "bold": 90, "poor": 0}


def test_equals_are_not_told_apart_and_best_for_nobody():
    found = ranked(one=np.arange(60.0), other=np.arange(60.0))
    assert not found["overall"]["distinguished"]
    assert not found["worst_off"]["distinguished"]
    assert found["for_whom"] == {"one": 0, "other": 0}
    assert _first(found["overall"]) == "shared by one, other, each with a glycemia risk index of 29.5"
    assert _first(ranked(one=np.zeros(9), other=np.ones(9))["overall"]).startswith(
        "one with a glycemia risk index of 0.0"
    )


def test_few_of_the_worst_off_are_not_told_apart():
    found = ranked(one=np.zeros(40), other=np.full(40, 50.0))
    assert found["overall"]["distinguished"]
    assert (found["worst_off"]["people"], found["worst_off"]["distinguished"]) == (4, False)


def test_the_interval_of_the_worst_off_holds_what_more_people_show():
    rng = np.random.default_rng(3)
    one, other = rng.normal(40.0, 5.0, 300), rng.normal(46.0, 5.0, 300)
    worst = ranked(one=one, other=other)["worst_off"]
    many = [_worst_mean(rng.normal(mean, 5.0, (100_000, 1)))[0] for mean in (40.0, 46.0)]
    assert worst["low"] < many[1] - many[0] < worst["high"]
    assert worst["distinguished"]


def test_who_is_not_known_under_all_controllers_is_not_ranked():
    assert ranked(one=np.arange(5.0), other=np.arange(3.0))["people"] == 3
    assert ranking(people_of("c", 3), "another family", 0) == {"family": "another family", "people": 0}


def test_a_controller_that_harms_is_named_with_its_worst_cell():
    lines = [
        people_of("ref", 10),
        people_of("c", 10, time_below_54_pct=[5.0] + [0.0] * 9),
        people_of("good", 10),
        people_of("ref", 10, "week"),
        people_of("c", 10, "week", time_below_54_pct=[5.0] * 2 + [0.0] * 8),
    ]
    table = pl.concat(lines)
    found = line_table(table, table.select(LINE).unique(maintain_order=True), "ref", 1.0).to_dicts()
    [harm] = harms(found, "ref")
    assert (harm["controller"], harm["scenario"], harm["harmed_below_54"]) == ("c", "week", 2)
    [sentence] = sentences(asked(), Results({"rows": [], "rankings": [], "harms": [harm], "absent": []}))
    assert sentence.startswith("c: the cell with the most harm is ")
    assert "Of 10 people, 2 are below 54 mg/dl, and nobody is below 70 mg/dl," in sentence
    assert "at the 95th percentile" in sentence


@pytest.mark.parametrize(
    ("below_54", "below_70", "which", "who"),
    [
        (
            (5.0, 0.0),
            (5.0, 0.0),
            "the cell with any harm",
            "Of 10 people, 1 is below 54 mg/dl, and 1 is below 70 mg/dl,",
        ),
        ((0.0, 0.0), (5.0, 0.0), "the cell with any harm", "Of 10 people, nobody is below 54 mg/dl, and 1 is below 70"),
        ((5.0, 5.0), (5.0, 5.0), "2 cells have as much harm, and one of them", "Of 10 people, 1 is below 54 mg/dl,"),
    ],
)
def test_no_harm_is_the_most_that_is_shared_or_none(below_54, below_70, which, who):
    lines = []
    for scenario, low, very_low in zip(("day", "week"), below_70, below_54, strict=True):
        harm = {"time_below_54_pct": [very_low] + [0.0] * 9, "time_below_70_pct": [low] + [0.0] * 9}
        lines += [people_of("ref", 10, scenario), people_of("c", 10, scenario, **harm)]
    table = pl.concat(lines)
    found = line_table(table, table.select(LINE).unique(maintain_order=True), "ref", 1.0).to_dicts()
    [sentence] = sentences(asked(), Results({"rows": [], "rankings": [], "harms": harms(found, "ref"), "absent": []}))
    assert sentence.startswith(f"c: {which} is ")
    assert who in sentence
    assert ("Below 54 mg/dl that is" in sentence) == any(below_54)


# ------------------------------------------------------------------------------------------- what is asked for


def asked(**keys):
    return configured(League, keys)


def test_everything_of_the_catalogues_takes_part_but_slow_controllers():
    whole = asked()
    assert list(whole.family_names) == [name for name, patient in PATIENTS.items() if not patient.extends]
    assert set(map(label_of, whole.cases)) | set(whole.left_out) == set(CONTROLLERS)
    assert all(CONTROLLERS[name].slow for name in whole.left_out)


def test_the_reference_takes_part_once():
    assert [*map(label_of, asked(controllers=["imc"]).cases)] == ["imc", "basal-bolus"]
    assert [*map(label_of, asked(controllers=["imc"], reference="imc").cases)] == ["imc"]
    assert asked(controllers=["imc"]).left_out == ()


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({"families": []}, "--patient is none; a league needs at least one"),
        ({"sensors": ["lag", "lag"]}, "--sensor 'lag' is given twice"),
        ({"scenarios": ["week", "week"]}, "--scenario 'week' is given twice"),
        ({"controllers": ["mpc", "mpc"]}, "--controller 'mpc' is given twice"),
        ({"people": 1}, "people is 1"),
        (
            {"people": 5, "bound_people": 6},
            "--bound is 6, and a family has 5 people; give at most 5, or 6 with --people",
        ),
        ({"bound_people": 2, "rescue": "below_mg_dl=65"}, "the best doses are searched without rescue carbohydrate"),
        ({"worse_by_pct": -1.0}, "worse_by_pct is -1"),
        ({"families": ["nobody"]}, "unknown patient 'nobody'"),
        ({"reference": "nothing"}, "unknown controller 'nothing'"),
    ],
)
def test_what_is_not_possible_is_refused_in_a_sentence(keys, said):
    with pytest.raises(Refusal) as refused:
        asked(**keys)
    assert said in str(refused.value)


SMALL = {"people": 3, "families": ["kanderian-2009"], "scenarios": ["plain-day"], "controllers": ["imc"], "seed": 4}


def test_a_table_of_people_limits_their_number_and_a_scenario_its_length():
    lines = _lines_of(asked(**{**SMALL, "people": 50, "scenarios": ["week, days=2"], "seed": 4}))
    assert {line.trial.people for line in lines} == {10}
    assert {line.days for line in lines} == {2.0}


@pytest.mark.long
def test_a_row_is_the_very_trial_that_it_stands_for():
    league = asked(**SMALL)
    results = list(_LeagueSearch(league).missing([]))
    assert [result.line for result in results] == _lines_of(league)
    for result in results:
        alone = engine.run_people(engine.prepare(result.line.trial), result.line.controller, np.arange(3))
        for name in METRICS:
            np.testing.assert_array_equal(result.people[name], alone.metrics.get(name, np.zeros(3)))
    kind = rows(league)
    cells = [dict(row) for row in kind.table(results).iter_rows(named=True)]
    again = [kind.row(row, results[:number]) for number, row in enumerate(cells)]
    for read, result in zip(again, results, strict=True):
        assert read[:5] == result[:5]
        for name, values in result.people.items():
            np.testing.assert_array_equal(read.people[name], values)
    for wrong in ({"controller": "pid"}, {"person": [0, 1]}, {"shard": 1}):
        with pytest.raises(Refusal):
            kind.row({**cells[1], **wrong}, results[:1])


@pytest.mark.long
def test_people_eat_against_low_glucose_and_their_grams_are_a_column():
    """Under far too much basal insulin everybody eats, and nobody does without a rescue or without the need."""
    keys = {**SMALL, "controllers": ["basal-bolus, carb_ratio_g_U=3, label=too much", "basal-bolus"]}
    whole = {}
    for rescue in (None, "below_mg_dl=65, carbs_g=20"):
        league = asked(**keys, rescue="none" if rescue is None else rescue)
        search = _LeagueSearch(league)
        results = search.results_of(list(search.missing([])))
        whole[rescue] = {row["controller"]: row for row in results.rows if row["sensor"] != ALL}
        assert ("rescue_g_day" in results.rows[0]) == (rescue is not None)
    without, with_rescue = whole.values()
    for label, row in with_rescue.items():
        grams = row["rescue_g_day"]
        if without[label]["ever_below_54"]:
            assert grams >= 20.0 / league.people
            assert row["time_below_54_mean_pct"] < without[label]["time_below_54_mean_pct"]
    assert max(row["rescue_g_day"] for row in with_rescue.values()) > 0.0


# ------------------------------------------------------------------------------------------- what could be reached


def best_of(known, scenario="day", **metrics):
    """Best doses of the first people of a scenario."""
    number = len(metrics["gri"])
    columns = {"family": "f", "scenario": scenario, "controller": known}
    return people_of(known, number, scenario, **metrics).with_columns(**{n: pl.lit(v) for n, v in columns.items()})


def test_a_person_is_compared_with_the_same_person_under_the_best_doses():
    rng = np.random.default_rng(5)
    ours, start, advance = (rng.uniform(0.0, 50.0, number) for number in (9, 4, 4))
    in_range = rng.uniform(50.0, 100.0, 9)
    people = people_of("c", 9, gri=ours, time_70_180_pct=in_range)
    best = pl.concat([best_of("start", gri=start, time_70_180_pct=start + 50.0), best_of("advance", gri=advance)])
    found = reach.beside(people, best, 1)
    [row] = line_table(found, people.select(LINE).unique(), "ref", 1.0, reach.COLUMNS).to_dicts()
    assert row["same_people"] == 4
    assert row["same_gri_mean"] == pytest.approx(ours[:4].mean())
    assert row["start_in_range_mean_pct"] == pytest.approx(start.mean() + 50.0)
    assert row["in_range_below_start_pct"] == pytest.approx((start + 50.0 - in_range[:4]).mean())
    for name, values in (("start", start), ("advance", advance)):
        interval = stats.ttest_rel(ours[:4], values).confidence_interval(0.95)
        distance = tuple(row[f"gri_above_{name}{end}"] for end in ("", "_low", "_high"))
        assert distance == pytest.approx(((ours[:4] - values).mean(), *interval))


def test_over_all_scenarios_stand_the_means_of_those_who_are_known_in_each():
    best = pl.concat(
        [best_of("start", gri=[1.0, 2.0]), best_of("start", "week", gri=[5.0]), best_of("advance", gri=[0.0, 0.0])]
    )
    cells = [people_of("c", 2, name, gri=[10.0, 20.0]) for name in ("day", "week")]
    together = over_all_cells(pl.concat(cells), 2)
    found = reach.beside(pl.concat([together, *cells]), best, 2)
    assert found["start_gri"].to_list() == [3.0, None, 1.0, 2.0, 5.0, None]
    assert found["gri_above_start"].to_list() == [7.0, None, 9.0, 18.0, 5.0, None]


def test_the_nearest_is_that_with_the_least_distance_on_any_sensor():
    def row(family, sensor, scenario, controller, above, people=3):
        head = {"family": family, "sensor": sensor, "scenario": scenario, "controller": controller}
        return {**head, "same_people": people, "gri_above_start": above if people else None}

    rows_ = [row("f", ALL, ALL, "c", 5.0), row("g", ALL, ALL, "c", 1.0, people=0), row("f", ALL, ALL, "d", 4.0)]
    rows_ += [row("f", "s", "day", "c", 2.0), row("f", "t", "day", "d", -1.0)]
    found = [(of["family"], of["scenario"], of["nearest"]) for of in reach.nearest(rows_)]
    assert found == [("f", ALL, "d"), ("f", "day", "d, t")]
    equal = [row("f", ALL, ALL, name, 0.0) for name in ("c", "d")]
    assert [of["nearest"] for of in reach.nearest(equal)] == ["c; d"]


def test_the_best_doses_come_last_so_that_those_of_more_people_follow():
    few, many = (_shards_of(asked(**SMALL, bound_people=number)) for number in (1, 3))
    assert [shard[:2] for shard in many[: len(few)]] == [shard[:2] for shard in few]
    assert [(line.controller, number) for line, number, _ in many[-6:]] == [
        (known, number) for number in range(3) for known in reach.KNOWN
    ]


@pytest.mark.long
def test_no_controller_is_better_than_the_best_doses_of_the_same_people():
    keys = {"families": ["hovorka-2004", "kanderian-2009"], "scenarios": ["plain-day", "unkind-day"]}
    keys |= {"people": 2, "bound_people": 2, "sensors": ["ideal"], "seed": 7}
    league = asked(**keys, controllers=["oref0", "loop-like", "mpc-se", "pid-ifb"])
    kind, search = rows(league), _LeagueSearch(league)
    results = list(search.missing([]))
    best = {(of.line[0], of.line[2], of.line[3], of.shard): of.people for of in results if of.line.sensor == ALL}
    assert len(best) == 16
    for of in results:
        if of.line.sensor == ALL:
            continue
        for place, person in enumerate(of.people["person"]):
            for known in reach.KNOWN:
                reached = best[of.line.family, of.line.scenario, known, person]
                assert of.people["gri"][place] >= reached["gri"][0] - 1e-9
                assert of.people["time_70_180_pct"][place] <= reached["time_70_180_pct"][0] + 1e-9
    for family, scenario, _, person in best:
        start, advance = (best[family, scenario, known, person]["gri"][0] for known in reach.KNOWN)
        assert advance <= start
    table = kind.table(results)
    cells = [dict(row) for row in table.iter_rows(named=True)]
    kept = [kind.row(row, results[:number]) for number, row in enumerate(cells)]
    again = [*kept[:-3], *search.missing(kept[:-3])]  # as after Ctrl-C between the two of one person
    assert kind.table(again).equals(table)
    found = search.results_of(again)
    assert len(found.plain["nearest"]) == 2 * 3
    assert all(row["gri_above_start"] >= 0.0 for row in found.plain["nearest"])
    assert "Distance to what could be reached" in page(league, found)


@pytest.mark.long
def test_a_scenario_that_has_no_best_doses_is_named_with_the_reason():
    league = asked(**{**SMALL, "scenarios": ["plain-day, warm_up_min=60"], "bound_people": 2})
    results = [of for of in _LeagueSearch(league).missing([]) if of.line.sensor == ALL]
    assert len(results) == 4
    assert all("without a warm-up" in of.reason for of in results)
