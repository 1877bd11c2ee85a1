"""The stress test: each cell is the very trial that it stands for, and its row what became of the people."""

import dataclasses
import math

import numpy as np
import pytest

from glucoloop.situations.situation import configured
from glucoloop.studies.stress import STANDARD_FAULTS, StressTest
from glucoloop.studies.stress.reasons import reason_of
from glucoloop.studies.stress.study import COLUMNS, _cell_table, _cells_of, _StressCell, trial_of
from glucoloop.trials import engine
from glucoloop.trials.people import PeopleRows
from glucoloop.trials.shard import people_table
from glucoloop.trials.trial import fingerprint

FAULTS = [
    "calibration, gain=1.25, offset_mg_dl=0",
    "calibration, gain=0.8, offset_mg_dl=0",
    "compression, start_min=60, duration_min=45, depth=0.4, tau_min=10",
    "spikes, per_day=20, size_mg_dl=50",
    "resolution, step_mU_min=4, least_mU_min=8",
    "occlusion, start_min=60, latest_min=90, duration_min=60, open_fraction=0, noticed=false",
]
PEOPLE = np.arange(5)


@pytest.fixture(scope="module")
def asked():
    keys = {"people": 5, "controller": ["imc"], "duration_min": 200.0, "faults": FAULTS, "guards": "without"}
    return configured(StressTest, {**keys, "seed": 4})


@pytest.fixture(scope="module")
def prepared(asked):
    return engine.prepare(trial_of(asked))


@pytest.fixture(scope="module")
def results(asked, prepared):
    return {cell.label: engine.run_people(prepared, cell.label, PEOPLE) for cell in _cells_of(asked)}


@pytest.mark.long
def test_cells_that_differ_in_a_fault_share_a_loop(asked, prepared):
    loops = {id(of_case.loop) for of_case in prepared.cases.values()}
    assert len(prepared.cases) == 1 + len(FAULTS)
    assert len(loops) == 2  # a resolution does not come and go


@pytest.mark.parametrize("fault", [FAULTS[0], FAULTS[4], FAULTS[5]])
@pytest.mark.long
def test_a_cell_is_the_trial_of_its_fault_alone(asked, results, fault):
    cell = next(cell for cell in _cells_of(asked) if cell.fault == fault)
    alone = dataclasses.replace(asked.base, faults=tuple(of for of in asked.faults if of.text == fault))
    assert alone.fault_texts == (fault,)
    told = engine.run_people(engine.prepare(alone), alone.cases[0].label, PEOPLE)
    for name in ("minimum_mg_dl", "peak_mg_dl", "insulin_total_mU", "samples_saturated"):
        np.testing.assert_allclose(results[cell.label].metrics[name], told.metrics[name], rtol=1e-12)


@pytest.mark.long
def test_faults_are_met_by_the_same_people_and_noise(asked, results):
    without = results[next(iter(_cells_of(asked))).label]
    for result in results.values():
        np.testing.assert_array_equal(result.basal_insulin_mU_min, without.basal_insulin_mU_min)
    # a fault that begins at 60 min changes nothing before: the minimum glucose of a run at steady state is the same
    assert len({float(result.metrics["minimum_mg_dl"][0]) for result in results.values()}) > 4


@pytest.mark.long
def test_the_worst_person_is_simulated_again(asked, prepared, results):
    _, cell, *_ = _cells_of(asked)
    minimum = results[cell.label].metrics["minimum_mg_dl"]
    person = int(np.argmin(minimum))
    reason = reason_of(prepared, cell.label, person)
    least = float(minimum[person])
    if least < 60.0:
        assert f"minimum {least:.1f} mg/dl" in reason
        assert "too high" in reason
    else:
        assert f"by {least - 60.0:.1f} mg/dl" in reason


# ------------------------------------------------------------------------------------------- rows, by hand


def people(below_60, minimum, feasible=(True, True, True), **metrics):
    size = len(below_60)
    filled = {
        name: np.zeros(size)
        for name in (
            "time_below_54_pct", "low_events", "very_low_events", "samples_saturated", "samples_missing",
            "samples_rejected", "samples_fallback", "samples_suspended", "samples_dose_limited",
        )
    }  # fmt: skip
    filled |= {"time_below_60_pct": np.array(below_60), "minimum_mg_dl": np.array(minimum)}
    filled |= {"peak_mg_dl": np.full(size, 150.0), "mean_mg_dl": np.full(size, 90.0)}
    filled |= {name: np.array(values, float) for name, values in metrics.items()}
    return PeopleRows(
        person=np.arange(size),
        feasible=np.array(feasible),
        basal_insulin_mU_min=np.full(size, 25.0),
        drawn={},
        metrics=filled,
    )


CELLS = (_StressCell("mpc", False, ""), _StressCell("mpc", False, FAULTS[0]))


def rows_of(*shards):
    """Rows of the two cells, from the people of each in each shard."""
    labelled = [dict(zip((cell.label for cell in CELLS), shard, strict=True)) for shard in shards]
    return _cell_table(CELLS, people_table(labelled), samples=40, days=1.0, columns=COLUMNS).to_dicts()


def test_a_row_compares_each_person_with_himself_without_the_fault():
    without = people([0.0, 2.0, 9.0], [70.0, 58.0, 40.0], time_below_validity_pct=[0.0, 0.0, 0.5])
    under = people([1.5, 2.9, 2.0], [57.0, 53.0, 55.0], samples_fallback=[4.0, 0.0, 0.0], low_events=[2, 1, 0])
    rows = rows_of((without, under))
    assert (rows[0]["worse"], rows[0]["worse_people"], rows[0]["worst_more_pct"]) == (0, [], 0.0)
    assert (rows[1]["worse"], rows[1]["worse_people"]) == (1, [0])
    assert rows[1]["worst_more_pct"] == pytest.approx(1.5)
    assert rows[1]["below_60_worst_pct"] == pytest.approx(2.9)
    assert rows[1]["ever_below_54_pct"] == pytest.approx(100.0 / 3.0)
    assert (rows[1]["lowest_mg_dl"], rows[1]["lowest_person"]) == (53.0, 1)
    assert rows[1]["fallback_pct"] == pytest.approx(100.0 * 4.0 / 3.0 / 40)
    assert rows[1]["low_events"] == 3
    assert [row["people_below_validity"] for row in rows] == [1, 0]


def test_the_lowest_glucose_is_no_number_below_0():
    (_, under) = rows_of((people([0.0], [70.0], [True]), people([9.0], [-3.0], [True])))
    assert (under["people"], under["lowest_mg_dl"], under["lowest_person"]) == (1, None, 0)


def test_people_who_cannot_take_part_are_left_out():
    nobody = people([np.nan], [np.nan], [False], mean_mg_dl=[np.nan])
    rows = rows_of((people([0.0], [70.0], [True]), people([5.0], [50.0], [True])), (nobody, nobody))
    assert rows[1]["people"] == 1
    assert math.isclose(rows[1]["below_60_mean_pct"], 5.0)
    lost = rows_of((people([0.0], [70.0], [True]), people([5.0], [50.0], [True], mean_mg_dl=[np.nan])))
    assert (lost[0]["people"], lost[1]["people"], lost[1]["worse"]) == (1, 0, None)


def test_the_worst_off_come_first_and_equals_in_their_order():
    without, under = people([0.0] * 4, [70.0] * 4, [True] * 4), people([2.0, 9.0, 2.0, 0.5], [50.0] * 4, [True] * 4)
    assert rows_of((without, under))[1]["worse_people"] == [1, 0, 2]


# ------------------------------------------------------------------------------------------- configuration


@pytest.mark.parametrize("whole", [False, True])
def test_a_test_is_read_again_from_its_tree(asked, whole):
    again = configured(StressTest, asked.tree(whole=whole))
    assert again.tree(whole=True) == asked.tree(whole=True)
    assert fingerprint(trial_of(again)) == fingerprint(trial_of(asked))


def test_without_anything_it_is_the_papers_controllers_under_the_usual_faults():
    asked = configured(StressTest)
    assert [case.controller.name for case in asked.base.cases] == ["imc", "mpc", "mpc-se", "nlqdmc-se"]
    assert asked.base.noise_variance == 1.45
    assert (asked.people, len(asked.faults)) == (100, len(STANDARD_FAULTS))
    assert len(_cells_of(asked)) == 4 * 2 * (1 + len(asked.faults))
    labels = [cell.label for cell in _cells_of(asked)]
    assert len(set(labels)) == len(labels)


def test_a_controller_has_its_own_guard_or_that_of_all():
    own, other = "pid, guard=(usual, max_hour=2)", "imc"
    asked = configured(StressTest, controller=[own, other], guard="max_hour=3", faults=["stuck"], people=2)
    guards = {cell.label: case.guard for cell, case in _cells_of(asked).items()}
    assert {case.guard for case in asked.base.cases} == {None}
    assert [None if of is None else of.max_hour for of in guards.values()] == [*[None] * 2, 2, 2, *[None] * 2, 3, 3]


@pytest.mark.parametrize(
    ("keys", "sentence"),
    [
        ({"guards": "some"}, "guards is 'some'; give both, with or without"),
        ({"traces": "all"}, "traces is no part of a stress test; leave it out"),
        ({"guard": "none"}, "--guard is none; let --guards say whether there is one"),
        ({"controller": ["mpc, guard=none"]}, "let --guards say whether there is one"),
        ({"faults": ["stuck", "stuck"]}, "the fault 'stuck' is given twice"),
        ({"faults": []}, "there is no fault to try; give one or more"),
        ({"guard": {"fastest_mg_dl_min": "fast"}}, "fastest_mg_dl_min is 'fast'; give a number"),
        ({"faults": ["stuck, start_min=900"]}, "the fault stuck begins at 900 min, but the run ends at 600 min"),
    ],
)
def test_what_cannot_be_is_refused(keys, sentence):
    with pytest.raises(ValueError, match=r"^.*$") as refused:
        configured(StressTest, keys)
    assert sentence in str(refused.value)
