"""The memory of a guard: what was lost is found again, for each person alone."""

import dataclasses
import itertools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from glucoloop._pytree import pytree, static
from glucoloop.control import (
    Decision,
    StateTuning,
    Status,
    design_mpc_se,
    guarded,
)
from glucoloop.models.state_space import LinearModel
from guarding import BASAL, EVERY, MPC, OPEN, Wants, follow, observe, step
from naming import naming


@pytree
class Fragile:
    """Its memory is lost at a reading above 200; it keeps a number for each person, a line, and one number for all."""

    sample_time_min: float = static(default=EVERY)

    def init(self, observation):
        return {"own": observation.glucose_mg_dl, "line": jnp.stack([observation.glucose_mg_dl] * 4), "shared": 1.0}

    def step(self, state, observation):
        lost = jnp.where(observation.glucose_mg_dl > 200.0, jnp.inf, 0.0)
        state = {"own": state["own"] + lost, "line": state["line"].at[2].add(-lost), "shared": state["shared"]}
        return state, Decision(
            insulin_mU_min=jnp.full_like(lost, BASAL + 1.0), status=jnp.zeros(observation.valid.shape, int)
        )


def test_a_memory_that_is_no_longer_finite_is_restarted_for_that_person_alone():
    guard = guarded(Fragile(), OPEN)
    people = np.array([100.0, 100.0, 100.0])
    state = guard.init(observe(people))
    state, _ = step(guard, state, observe(people))
    state, _ = step(guard, state, observe(np.array([101.0, 240.0, 102.0])))
    state, decision = step(guard, state, observe(np.array([101.0, 140.0, 102.0])))
    assert decision.status.tolist() == [Status.OK, Status.RESTARTED, Status.OK]
    np.testing.assert_array_equal(decision.insulin_mU_min, [BASAL + 1.0, BASAL, BASAL + 1.0])
    np.testing.assert_array_equal(state.inner["own"], [100.0, 140.0, 100.0])
    np.testing.assert_array_equal(state.inner["line"][:, 1], 140.0)
    np.testing.assert_array_equal(state.inner["line"][:, 0], 100.0)
    assert float(state.inner["shared"]) == 1.0
    state, decision = step(guard, state, observe(np.array([101.0, 141.0, 102.0])))
    assert decision.status.tolist() == [Status.OK] * 3


@pytest.fixture(scope="module")
def estimating():
    model = LinearModel(
        Phi=jnp.array([[0.9]]),
        Gamma=jnp.array([-0.3]),
        C=jnp.array([1.0]),
        state=jnp.array([81.0]),
        insulin_mU_min=jnp.array(BASAL),
        glucose_mg_dl=jnp.array(81.0),
        sample_time_min=EVERY,
    )
    return design_mpc_se(model, [1.0], StateTuning(move_horizon=2, prediction_horizon=7))


@pytest.mark.parametrize("absurd", [-1e20, 1e20, -5e3, 1e4, math.nan])
def test_an_estimate_that_no_person_can_have_begins_anew_and_the_status_says_so(estimating, absurd):
    guard = guarded(estimating)
    state = follow(guard, [81.0, 90.0, 100.0, 110.0, 118.0])[2][-1]
    lost = dataclasses.replace(
        state, inner=dataclasses.replace(state.inner, estimate=jnp.full_like(state.inner.estimate, absurd))
    )
    lost, decision = step(guard, lost, observe(124.0, BASAL))
    assert int(decision.status) == Status.RESTARTED
    assert float(decision.insulin_mU_min) == BASAL
    assert abs(float(lost.inner.estimate[0])) < 100.0
    _, decision = step(guard, lost, observe(126.0, decision.insulin_mU_min))
    assert int(decision.status) != Status.RESTARTED
    assert float(decision.insulin_mU_min) > BASAL


def test_a_memory_that_is_finite_and_absurd_is_restarted():
    guard = guarded(MPC)
    state = follow(guard, [81.0, 90.0, 100.0, 110.0, 118.0])[2][-1]
    free = state.inner.free_response.at[-1].set(-1e5)
    lost = dataclasses.replace(state, inner=dataclasses.replace(state.inner, free_response=free))
    lost, decision = step(guard, lost, observe(124.0, BASAL))
    assert int(decision.status) == Status.RESTARTED
    assert float(jnp.max(jnp.abs(lost.inner.free_response))) < 1e3


NONSENSE = [math.nan, math.inf, -math.inf, 1e300, -1e300, -7.0, 0.5]


def test_every_word_of_its_memory_may_be_lost():
    """The dose keeps its limits at once, and every number of the state is one again."""
    guard = guarded(MPC)
    leaves, structure = jax.tree.flatten(follow(guard, [81.0, 90.0, 100.0, 110.0, 118.0])[2][-1])
    for word, nonsense in itertools.product(range(len(leaves)), NONSENSE):
        with naming(f"word {word} is {nonsense}"):
            lost = jax.tree.unflatten(
                structure, [*leaves[:word], jnp.full_like(leaves[word], nonsense), *leaves[word + 1 :]]
            )
            delivered = 30.0
            for reading in (120.0, 122.0, 123.0):
                lost, decision = step(guard, lost, observe(reading, delivered))
                assert 0.0 <= decision.insulin_mU_min <= 66.9
                assert abs(decision.insulin_mU_min - delivered) <= 16.7 + 1e-9
                assert int(decision.status) in set(Status)
                delivered = float(decision.insulin_mU_min)
            for leaf in jax.tree.leaves(lost):
                assert np.all(np.isfinite(leaf))
                assert np.all(np.abs(leaf) <= 1e4)


def test_a_basal_rate_that_was_lost_is_found_again():
    for given_, basal in ((None, BASAL), (23.0, 23.0)):
        guard = guarded(Wants(rate=60.0), basal_mU_min=given_)
        state = guard.init(observe(90.0))
        for field in ("basal_mU_min", "per_basal"):
            lost = dataclasses.replace(state, doses=dataclasses.replace(state.doses, **{field: jnp.asarray(math.nan)}))
            healed, _ = step(guard, lost, observe(90.0))
            assert float(healed.doses.basal_mU_min) == pytest.approx(basal, rel=1e-15)
            assert float(healed.doses.per_basal) == pytest.approx(1.0 / basal, rel=1e-15)


@pytest.mark.long
def test_people_may_trail_or_be_mapped():
    rng = np.random.default_rng(3)
    readings = 100.0 + np.cumsum(rng.normal(0.0, 8.0, (40, 3)), axis=0)
    readings[rng.random(readings.shape) < 0.2] = np.nan
    guard = guarded(MPC)
    doses, statuses, _ = follow(guard, readings, start=np.full(3, BASAL))
    mapped = jax.vmap(lambda one: jax.lax.scan(_scanned, (guard.init(observe(one[0])), jnp.asarray(BASAL)), one)[1])
    by_map = mapped(jnp.asarray(readings.T))
    for i in range(3):
        alone, of_alone, _ = follow(guard, readings[:, i])
        np.testing.assert_allclose(doses[:, i], alone, rtol=1e-12, atol=1e-12)
        np.testing.assert_array_equal(statuses[:, i], of_alone)
        np.testing.assert_allclose(by_map[i], alone, rtol=1e-12, atol=1e-12)
    assert len(set(statuses.ravel().tolist())) > 4


def _scanned(carry, reading):
    state, delivered = carry
    state, decision = guarded(MPC).step(state, observe(reading, delivered))
    return (state, decision.insulin_mU_min), decision.insulin_mU_min


@pytest.mark.parametrize("basal", [16.93985272, 20.0, 23.7])
def test_a_first_state_that_is_rounded_to_single_precision_is_no_damaged_one(basal):
    """As native code rounds it: the controller gets what it asks for at once, and a damaged word is still noticed."""
    guard = guarded(Wants(rate=1.15 * basal), basal_mU_min=basal)
    state = guard.init(observe(150.0, basal))
    rounded = jax.tree.map(lambda leaf: leaf.astype(jnp.float32).astype(leaf.dtype), state)
    for k in range(2):
        rounded, decision = step(guard, rounded, observe(90.0 + k, basal))
    assert float(decision.insulin_mU_min) == pytest.approx(1.15 * basal)
    damaged = dataclasses.replace(state, doses=dataclasses.replace(state.doses, counted=jnp.asarray(-0.5)))
    _, decision = step(guard, damaged, observe(90.0, basal))
    assert float(decision.insulin_mU_min) == pytest.approx(basal, rel=1e-6)


def test_damaged_memory_with_a_report_that_is_too_high_lasts_until_the_next_true_report():
    """The guard does not cover this: the rate starts at the report, and then only falls to the basal rate."""
    guard = guarded(Wants(rate=60.0))
    state = guard.init(observe(100.0))
    state = dataclasses.replace(state, doses=dataclasses.replace(state.doses, counted=jnp.asarray(3.0)))
    report, rates = 130.0, []
    for k in range(6):
        state, decision = step(guard, state, observe(100.0 + 0.1 * k, report))
        report = float(decision.insulin_mU_min)
        rates.append(report)
    np.testing.assert_allclose(rates, [66.9, 50.2, 33.5, BASAL, BASAL, BASAL])
