"""Recorded samples: what is compared with them, and the bounds of recorded doses."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from glucoloop.build.designs import controller_of
from glucoloop.control.protocol import Observation
from glucoloop.firmware.exported import export
from glucoloop.firmware.samples import _spread, arithmetic, joined, leaves_of, record
from glucoloop.pumps import bolus_limits
from glucoloop.situations.case import default_case
from glucoloop.situations.situation import default_situation

SAMPLES = 12


@pytest.fixture(scope="module")
def runs(on_chip):
    functions = arithmetic(on_chip.exported)
    situation = default_situation()
    return [
        record(on_chip.exported, on_chip.controller, situation, *functions, samples=SAMPLES, seed=seed)
        for seed in (1, 2)
    ]


def test_samples_are_spread_from_the_first_to_the_last():
    assert _spread(5, 10) == [0, 2, 5, 8, 10]
    assert _spread(100, 3) == [0, 1, 2, 3]


@pytest.mark.long
def test_a_run_begins_with_a_waking_controller(on_chip, runs):
    both = joined(runs)
    assert len(both.observations) == 2 * SAMPLES
    assert both.wrong_step(*arithmetic(on_chip.exported)) is None
    assert both.wrong_decision(*arithmetic(on_chip.exported)) is None
    assert dataclasses.replace(both, run=2 * SAMPLES).wrong_step(*arithmetic(on_chip.exported)) == SAMPLES - 1


@pytest.mark.long
@pytest.mark.parametrize("what", ["decisions", "states"])
def test_one_changed_bit_is_found(on_chip, runs, what):
    leaves = [list(sample) for sample in getattr(runs[0], what)]
    leaves[7][0] = np.nextafter(leaves[7][0], np.float32(np.inf))
    changed = dataclasses.replace(runs[0], **{what: leaves})
    assert changed.wrong_step(*arithmetic(on_chip.exported)) == {"decisions": 7, "states": 6}[what]


def test_a_bolus_is_at_most_the_largest_of_the_pump():
    situation = default_situation()
    controller = controller_of(situation, default_case("basal-bolus", situation))
    seen = Observation(
        glucose_mg_dl=jnp.asarray(110.0),
        valid=jnp.asarray(True),
        setpoint_mg_dl=jnp.asarray(81.1),
        delivered_mU_min=jnp.asarray(22.3),
        announced_carbs_g=jnp.asarray(300.0),
        delivered_bolus_mU=jnp.asarray(0.0),
    )
    exported = export(controller, situation.limits, seen, ["bolus"], bolus=bolus_limits(max_U=2.0))
    init, step = arithmetic(exported)
    leaves = leaves_of(seen, exported)
    decision = jax.tree.unflatten(jax.tree.structure(exported.traced.decision), step(init(leaves), leaves)[1])
    assert decision.bolus_mU == 2000.0
