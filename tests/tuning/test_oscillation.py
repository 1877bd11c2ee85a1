"""Crossings and turns by hand, and loops that anybody would call quiet or ringing."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from glucoloop.control import MPCTuning, design_linear_mpc, design_mpc_se, design_nlqdmc_se
from glucoloop.control.tuning import PARKER_1999
from glucoloop.patients.capabilities import process_noise
from glucoloop.simulation import linear_model, nonlinear_model, simulate
from glucoloop.tuning.oscillation import _turns, crossings, oscillation

PAPER = PARKER_1999["setpoint-81", False]


@pytest.mark.parametrize(
    ("values", "count"),
    [
        ([0, 0, 0], 0),
        ([0, 5, 0], 1),
        ([0, 5, 0, 5], 2),
        ([0, 5, 4.5, 5, 4.5, 9], 0),  # wiggles
        ([0, 5, 4.5, 4, 3.5, 9], 2),  # falls by more than 1, in steps of less
        ([5, 4, 3, 9], 1),  # from the first value on
        ([3, 3.9, 3.1, 3.8, 3.2], 0),
    ],
)
def test_turns_by_hand(values, count):
    assert int(_turns(jnp.array(values, float), 1.0)) == count


# each length is compiled
@given(
    values=st.sampled_from([2, 3, 9, 40]).flatmap(
        lambda size: st.lists(st.integers(-20, 20), min_size=size, max_size=size)
    )
)
def test_turns_of_any_size_are_changes_of_direction(values):
    moves = np.diff(values)
    signs = np.sign(moves[moves != 0])
    assert int(_turns(jnp.array(values, float), 0.5)) == int((signs[1:] != signs[:-1]).sum())


def test_crossings_by_hand():
    glucose = np.array([100, 103, 101, 97, 99, 96, 104, 100.0])
    assert int(crossings(glucose, 100.0)) == 2
    assert int(crossings(glucose, 100.0, band=0.035)) == 1
    assert int(crossings(np.full(5, 100.0), 100.0)) == 0


def test_printed_tunings_do_not_oscillate(patient_81, identified_81):
    controllers = [
        design_linear_mpc(identified_81.model, PAPER.mpc),
        design_mpc_se(linear_model(patient_81), process_noise(patient_81, *PAPER.noise), PAPER.mpc_se),
        design_nlqdmc_se(nonlinear_model(patient_81), process_noise(patient_81, *PAPER.noise), PAPER.nlqdmc_se),
    ]
    assert not any(bool(oscillation(simulate(patient_81, one)).oscillates) for one in controllers)


def test_dead_beat_oscillates(patient_81, identified_81):
    found = oscillation(simulate(patient_81, design_linear_mpc(identified_81.model, MPCTuning(4, 4))))
    assert bool(found.oscillates)
    assert int(found.crossings) > 8
    assert int(found.turns) > 20


@pytest.mark.parametrize(
    ("turned", "meals", "oscillates"), [(7, 1, False), (8, 1, True), (15, 2, False), (16, 2, True)]
)
def test_each_meal_is_a_reason_to_turn(patient_81, script, turned, meals, oscillates):
    insulin = np.full(120, 20.0)
    insulin[10 : 10 + turned + 1] = np.where(np.arange(turned + 1) % 2 == 0, 30.0, 10.0)
    insulin[10 + turned + 1 :] = insulin[10 + turned]
    trace = simulate(patient_81, script([20.0]))
    carbs = jnp.zeros(120).at[jnp.array([5, 60][:meals])].set(50.0)
    flat = jnp.full(601, trace.setpoint_mg_dl)
    trace = dataclasses.replace(
        trace,
        fine_glucose_mg_dl=flat,
        insulin_mU_min=jnp.asarray(insulin),
        carbs_g=carbs,
        basal_insulin_mU_min=jnp.asarray(20.0),
    )
    found = oscillation(trace)
    assert int(found.turns) == turned
    assert int(found.crossings) == 0
    assert bool(found.oscillates) == oscillates
