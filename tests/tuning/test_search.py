"""Searches: padded controllers are the controllers, a point is the run of its tuning, and the order is by hand."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from glucoloop.control import (
    MPCTuning,
    StateTuning,
    design_linear_mpc,
    design_mpc_se,
    design_nlqdmc_se,
    design_open_loop,
)
from glucoloop.control.catalogue import controller_entry
from glucoloop.control.tuning import PARKER_1999
from glucoloop.meals import Scenario
from glucoloop.metrics import summarise
from glucoloop.patients import patient
from glucoloop.patients.capabilities import process_noise
from glucoloop.sensors import DeadTime, WhiteNoise, white_noise
from glucoloop.simulation import linear_model, nonlinear_model, simulate
from glucoloop.situations.case import default_case
from glucoloop.situations.situation import default_situation
from glucoloop.tuning.grid import tuning_grid
from glucoloop.tuning.search import (
    _block,
    _padded,
    default_filters,
    designer,
    move_slots,
    paper_tuning_surface,
    printed_tuning,
    search,
    stack,
)
from glucoloop.tuning.surface import TuningSurface, tuning_text

PAPER = PARKER_1999["setpoint-81", False]
Q = process_noise(patient(), *PAPER.noise)
SHORT = Scenario(horizon_min=150.0)


LATE = (DeadTime(minutes=10.0),)


def design_of(name, model=None, **situation):
    """Design of a usual case."""
    made = dataclasses.replace(default_situation(), **situation)
    case = default_case(name, made)
    return designer(made, dataclasses.replace(case, known_dead_time=bool(situation)), model)


def traces_agree(one, other):
    np.testing.assert_allclose(one.fine_glucose_mg_dl, other.fine_glucose_mg_dl, rtol=0, atol=1e-11)
    np.testing.assert_allclose(one.insulin_mU_min, other.insulin_mU_min, rtol=0, atol=1e-10)
    np.testing.assert_array_equal(one.status, other.status)


@pytest.mark.parametrize("constraints", ["clip", "qp"])
def test_padded_linear_mpc_decides_as_before(patient_81, identified_81, constraints):
    controller = design_linear_mpc(identified_81.model, MPCTuning(1, 5), constraints=constraints)
    traces_agree(simulate(patient_81, controller), simulate(patient_81, _padded(controller, 2, 50)))


@pytest.mark.parametrize("constraints", ["clip", "qp"])
def test_padded_mpc_se_decides_as_before(patient_81, constraints):
    controller = design_mpc_se(linear_model(patient_81), Q, StateTuning(1, 3), constraints=constraints)
    traces_agree(simulate(patient_81, controller), simulate(patient_81, _padded(controller, 2, 14)))


@pytest.mark.long
def test_padded_nlqdmc_decides_as_before(patient_81):
    tuning = StateTuning(3, 5, 2.0, 0.5, 0.57)
    controller = design_nlqdmc_se(nonlinear_model(patient_81), Q, tuning)
    plain = simulate(patient_81, controller, scenario=SHORT)
    traces_agree(plain, simulate(patient_81, _padded(controller, 4, 7), scenario=SHORT))


def test_what_cannot_be_padded_is_refused(identified_81):
    controller = design_linear_mpc(identified_81.model, MPCTuning(2, 5))
    with pytest.raises(ValueError, match="does not fit"):
        _padded(controller, 1, 5)
    with pytest.raises(TypeError, match="OpenLoop"):
        _padded(design_open_loop(), 2, 5)


def test_stacked_controllers_stay_apart(identified_81):
    several = [design_linear_mpc(identified_81.model, MPCTuning(2, p)) for p in (5, 8)]
    stacked = stack([_padded(one, 2, 8) for one in several])
    np.testing.assert_array_equal(stacked.plan.gain[0, :5], several[0].gain)
    np.testing.assert_array_equal(stacked.plan.gain[0, 5:], 0.0)
    np.testing.assert_array_equal(stacked.plan.gain[1], several[1].gain)


def test_slots_and_blocks():
    assert [move_slots(moves, 4) for moves in (1, 2, 3, 4)] == [2, 2, 4, 4]
    assert move_slots(1, 1) == 1
    for runs in (1, 7, 8, 128, 129, 163, 1000):
        block = _block(runs)
        blocks = -(-runs // block)
        assert block % 8 == 0
        assert block <= 128
        assert blocks * block - runs < 8 * blocks


def test_point_is_the_run_of_its_tuning(patient_81, identified_81):
    grid = tuning_grid([1, 2, 3], [3, 8], move_weights=[0.0, 1.0])
    seen = []
    surface = search(
        default_situation(),
        design_of("mpc", identified_81.model),
        grid,
        progress=lambda done, total: seen.append((done, total)),
    )
    assert surface.tunings == tuple(grid)
    assert seen[-1] == (len(grid), len(grid))
    for point in (0, 11):
        metrics = summarise(simulate(patient_81, design_linear_mpc(identified_81.model, grid[point])))
        for name in ("sse", "undershoot_mg_dl", "settling_2pct_min", "minimum_mg_dl", "insulin_total_variation_mU_min"):
            assert getattr(surface, name)[point] == pytest.approx(float(getattr(metrics, name)), abs=1e-9)
        assert surface.feasible[point] == bool(metrics.constraints_satisfied)


@pytest.mark.parametrize(("name", "tuning"), [("mpc-se", PAPER.mpc_se), ("nlqdmc-se", PAPER.nlqdmc_se)])
@pytest.mark.long
def test_point_of_a_controller_with_estimation_is_the_run_of_its_tuning(patient_81, name, tuning):
    other = dataclasses.replace(tuning, reference_filter=0.3, prediction_horizon=9)
    surface = search(default_situation(), design_of(name), [tuning, other], scenario=SHORT, name=name)
    if name == "mpc-se":
        controller = design_mpc_se(linear_model(patient_81), Q, tuning)
    else:
        controller = design_nlqdmc_se(nonlinear_model(patient_81), Q, tuning)
    alone = summarise(simulate(patient_81, controller, scenario=SHORT))
    assert surface.controller == name
    assert surface.sse[0] == pytest.approx(float(alone.sse), abs=1e-9)
    assert surface.sse[1] != pytest.approx(float(alone.sse), abs=1e-3)


def test_noise_is_the_same_for_every_tuning_and_results_are_medians(patient_81, identified_81):
    seeds, sensor = (3, 4, 5), white_noise(1.45)
    situation = dataclasses.replace(default_situation(), sensor=(WhiteNoise(variance=1.45),))
    grid = [MPCTuning(2, 10, 3.0, 1.0), MPCTuning(2, 12, 3.0, 1.0)]
    design = design_of("mpc", identified_81.model)
    surface = search(situation, design, grid, seeds=seeds, scenario=SHORT)
    alone = [float(summarise(simulate(patient_81, design(grid[0]), sensor, None, SHORT, seed)).sse) for seed in seeds]
    assert surface.sse[0] == pytest.approx(np.median(alone), abs=1e-9)
    assert surface.seeds == 3


def test_known_dead_time_lengthens_the_horizon(patient_81, identified_81):
    design = design_of("mpc", identified_81.model, sensor=LATE)
    told = design_linear_mpc(identified_81.model.delayed(2), MPCTuning(2, 10))
    np.testing.assert_array_equal(design(MPCTuning(2, 8)).gain, told.gain)
    for name, by_hand in (
        ("mpc-se", lambda: design_mpc_se(linear_model(patient_81), Q, PAPER.mpc_se, dead_time_samples=2)),
        ("nlqdmc-se", lambda: design_nlqdmc_se(nonlinear_model(patient_81), Q, PAPER.nlqdmc_se, dead_time_samples=2)),
    ):
        tuning = printed_tuning("setpoint-81", name)
        ours = design_of(name, sensor=LATE)(tuning)
        assert jax.tree.structure(ours) == jax.tree.structure(by_hand())
        for one, other in zip(jax.tree.leaves(ours), jax.tree.leaves(by_hand()), strict=True):
            np.testing.assert_array_equal(one, other)


def test_tuning_without_a_controller_is_left_out_and_told(patient_81, identified_81):
    flat = dataclasses.replace(identified_81.model, step_response=jnp.zeros(36).at[3:].set(-1.0))
    design = design_of("mpc", flat)
    surface = search(default_situation(), design, tuning_grid([1], [2, 5]), scenario=SHORT)
    assert surface.tunings == (MPCTuning(1, 5),)
    assert surface.refused[0][0] == MPCTuning(1, 2)
    assert "sees -0 % of the gain" in surface.refused[0][1]
    with pytest.raises(ValueError, match="no controller can be designed"):
        search(default_situation(), design, tuning_grid([1], [2]))


def test_bad_searches(patient_81, identified_81):
    tuning, design = MPCTuning(), design_of("mpc", identified_81.model)
    with pytest.raises(ValueError, match="the grid has no tuning"):
        search(default_situation(), design, [])
    with pytest.raises(ValueError, match="no seeds"):
        search(default_situation(), design, [tuning], seeds=[])
    with pytest.raises(ValueError, match="too large"):
        search(default_situation(), design, [tuning] * 101, seeds=range(2000))
    with pytest.raises(ValueError, match="'pid' cannot be tuned"):
        design_of("pid")
    with pytest.raises(ValueError, match="filtered reference"):
        search(default_situation(), design_of("mpc-se"), [tuning])
    with pytest.raises(ValueError, match="unknown operating point 'elsewhere'"):
        printed_tuning("elsewhere", "mpc")


def toy(sse, kept=None, oscillates=None):
    """A surface whose results are given."""
    points = len(sse)
    none, zero = np.zeros(points, bool), np.zeros(points)
    return TuningSurface(
        controller="toy",
        tunings=tuple(MPCTuning(1, 1 + point) for point in range(points)),
        refused=(),
        seeds=1,
        sse=np.array(sse, float),
        undershoot_mg_dl=zero,
        minimum_mg_dl=zero,
        settling_2pct_min=zero,
        settled_2pct=none,
        settling_5pct_min=zero,
        settled_5pct=none,
        insulin_total_variation_mU_min=zero,
        kept_share=np.ones(points) if kept is None else np.array(kept, float),
        crossings=np.zeros(points, int),
        turns=np.zeros(points, int),
        oscillates=none if oscillates is None else np.array(oscillates, bool),
    )


def test_rank_by_hand():
    #      best of all, but rings | breaks a bound | 2nd | best | no number | 2nd as well | last
    surface = toy([1, 2, 7, 5, np.nan, 7, 9], kept=[1, 0.5, 1, 0.6, 0, 1, 1], oscillates=[1, 0, 0, 0, 0, 0, 0])
    assert surface.best() == MPCTuning(1, 4)
    assert surface.order().tolist() == [3, 2, 5, 6, 0, 1, 4]
    assert [surface.rank_of(tuning).rank for tuning in surface.tunings] == [None, None, 2, 1, None, 2, 4]
    rank = surface.rank_of(MPCTuning(1, 7))
    assert (rank.points, rank.sse, rank.best, rank.best_sse) == (4, 9.0, MPCTuning(1, 4), 5.0)
    assert [surface.rank_of(tuning).equal for tuning in surface.tunings] == [0, 0, 1, 0, 0, 1, 0]


def test_nothing_acceptable_and_nothing_found():
    surface = toy([1, 2], kept=[0, 0])
    with pytest.raises(ValueError, match="no tuning of the grid"):
        surface.best()
    assert surface.rank_of(MPCTuning(1, 1)).best is None
    with pytest.raises(ValueError, match=r"\(3, 9, 1, 0\) is not a point"):
        surface.rank_of(MPCTuning(3, 9))


def test_columns_are_a_table():
    columns = toy([1, 2]).columns()
    assert columns["prediction_horizon"].tolist() == [1, 2]
    assert "reference_filter" not in columns
    assert {len(values) for values in columns.values()} == {2}
    assert tuning_text(StateTuning(2, 5, 1.0, 0.0, 0.57)) == "(2, 5, 1, 0, 0.57)"


@pytest.mark.long
def test_printed_tuning_of_linear_mpc_is_not_the_least_sum_of_squares(identified_81):
    """More moves keep lowering the sum, and the printed tuning stands far from the best that does not ring."""
    surface = paper_tuning_surface("setpoint-81", "mpc", model=identified_81.model)
    rank = surface.rank_of(printed_tuning("setpoint-81", "mpc"))
    assert rank.tuning == MPCTuning(2, 8)
    assert (rank.rank, rank.points) == (27, 39)  # horizons of 1 and 2 see too little of the gain
    assert rank.best.move_horizon == 4
    assert rank.best_sse < 0.5 * rank.sse


def test_reference_filters_of_a_grid_are_those_of_the_entry_or_the_usual_one(monkeypatch):
    assert default_filters("mpc", {"move_horizon": 2}) is None
    assert default_filters("mpc-se", {"reference_filter": 0.65}) == ".3:.8:.05"
    entry = type("Outside", (controller_entry("mpc-se"),), {"reference_filters": None})
    monkeypatch.setattr("glucoloop.tuning.search.controller_entry", {"outside": entry}.__getitem__)
    assert default_filters("outside", {"reference_filter": 0.65}) == "0.65"
