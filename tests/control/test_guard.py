"""The guard: it is not there where it is not needed, its settings, and the basal rate that it is told."""

import dataclasses
import math

import jax
import numpy as np
import pytest

from glucoloop._pytree import pytree
from glucoloop.control import (
    GuardSettings,
    Status,
    design_open_loop,
    guarded,
)
from guarding import EVERY, MPC, OPEN, SETPOINT, Wants, follow, observe


def test_where_it_has_nothing_to_do_it_changes_no_bit():
    rng = np.random.default_rng(1)
    readings = SETPOINT + 25.0 + np.cumsum(rng.normal(0.3, 1.0, 60))
    guard = guarded(MPC, OPEN)
    doses, statuses, states = follow(guard, readings)
    plain, own, inner = follow(MPC, readings)
    np.testing.assert_array_equal(doses, plain)
    np.testing.assert_array_equal(statuses, own)
    jax.tree.map(np.testing.assert_array_equal, states[-1].inner, inner[-1])
    assert np.ptp(doses) > 20.0


def test_at_rest_the_usual_guard_has_nothing_to_do():
    readings = SETPOINT + np.random.default_rng(2).uniform(-0.5, 0.5, 40)
    doses, statuses, _ = follow(guarded(MPC), readings)
    np.testing.assert_array_equal(doses, follow(MPC, readings)[0])
    assert np.all(np.isin(statuses, [Status.OK, Status.SATURATED]))
    assert np.ptp(doses) > 0.1


@pytest.mark.parametrize(
    ("field", "value", "part"),
    [
        ("lowest_reading_mg_dl", -1.0, "lowest_reading_mg_dl is -1 mg/dl; give a number from 0 to 10000 mg/dl"),
        ("lowest_reading_mg_dl", 700.0, "are no range"),
        ("highest_reading_mg_dl", 10.0, "are no range"),
        ("fastest_mg_dl_min", 0.0, "above 0"),
        ("stuck_min", 0.0, "above 0"),
        ("gap_min", -5.0, "give a number from 0 to 10000"),
        ("gap_min", 100.0, "less than its gap_min"),
        ("reduced_fraction", 1.5, "reduced_fraction is 1.5; give a number from 0 to 1"),
        ("max_hour", 0.5, "max_hour is 0.5; give a number from 1 to 10000"),
        ("always_basal", 0.9, "give a number from 1 to 10000"),
        ("fall_mg_dl", 0.0, "give a number from 1 to 10000"),
        ("on_board_tau_min", 0.0, "give a number from 1 to 10000"),
        ("error_mg_dl", 1e9, "give a number from 0 to 10000"),
        ("low_mg_dl", math.nan, "low_mg_dl is nan mg/dl; give a number from 0 to 10000 mg/dl"),
        ("ahead_min", math.inf, "give a number from 0 to 10000"),
        ("ahead_min", True, "give a number in min"),
        ("ahead_min", "20", "give a number in min, such as 20"),
    ],
)
def test_settings_out_of_bounds_are_refused(field, value, part):
    with pytest.raises(ValueError, match=part):
        GuardSettings(**{field: value})


@pytest.mark.parametrize("basal", [-1.0, 70.0, math.nan])
def test_a_basal_rate_outside_the_limits_is_refused(basal):
    with pytest.raises(ValueError, match=r"give one from 0 to 66.9 mU/min"):
        guarded(MPC, basal_mU_min=basal)


def test_a_basal_rate_is_handed_to_a_controller_that_asks_for_it():
    @pytree
    class Asks(Wants):
        basal: float = 0.0

        def with_basal(self, insulin_mU_min):
            return dataclasses.replace(self, basal=insulin_mU_min)

    guard = guarded(Asks(rate=1.0)).with_basal(30.0)
    assert guard.inner.basal == 30.0
    assert float(guard.init(observe(90.0, 25.0)).doses.basal_mU_min) == 30.0
    guard = guarded(design_open_loop()).with_basal(30.0)
    assert float(guard.init(observe(90.0, 25.0)).doses.basal_mU_min) == 30.0
    assert guard.sample_time_min == EVERY
