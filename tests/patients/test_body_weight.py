"""Another weight: volumes and flows, and what follows at steady state."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

from glucoloop.patients.sorensen.equations import STATE_NAMES, insulin_balances
from glucoloop.patients.sorensen.parker1999 import CONSTANTS, PARKER_1999
from glucoloop.patients.sorensen.rest import infusion_for, insulin_at_rest, rest_at
from glucoloop.patients.sorensen.varying import FLOWS, VOLUMES, scaled_to_weight

WEIGHTS = np.array([50.0, 70.0, 100.0])


def test_every_volume_and_flow_is_scaled_and_nothing_else():
    scaled = scaled_to_weight(PARKER_1999, 105.0)
    kinds = {c.name: c.meaning.split(",")[0] for c in CONSTANTS}
    of_blood = ("glucose flow", "glucose volume", "insulin flow", "insulin volume", "glucagon volume")
    for field in dataclasses.fields(PARKER_1999):
        before, after = getattr(PARKER_1999, field.name), getattr(scaled, field.name)
        if kinds.get(field.name) in of_blood:
            assert field.name in (*VOLUMES, *FLOWS)
            assert after == pytest.approx(1.5 * before, rel=1e-15)
        else:
            assert after == before


def test_at_the_reference_weight_nothing_changes():
    assert scaled_to_weight(PARKER_1999, 70.0) == PARKER_1999


def test_the_same_infusion_per_kilogram_gives_the_same_insulin():
    p = scaled_to_weight(PARKER_1999, jnp.asarray(WEIGHTS))
    insulin = np.asarray(insulin_at_rest(p, 0.4 * WEIGHTS))
    np.testing.assert_allclose(insulin, np.repeat(insulin[:, 1:2], 3, axis=1), rtol=1e-13)
    np.testing.assert_allclose(insulin_balances(p, insulin, 0.4 * WEIGHTS), 0.0, atol=1e-12)


def test_insulin_moves_as_fast_at_any_weight():
    p = scaled_to_weight(PARKER_1999, jnp.asarray(WEIGHTS))
    state = np.linspace(5.0, 40.0, 7)[:, None] * np.ones(3)
    rates = np.asarray(insulin_balances(p, state, 0.4 * WEIGHTS))
    np.testing.assert_allclose(rates, np.repeat(rates[:, 1:2], 3, axis=1), rtol=1e-11)


def test_basal_rate_is_nearly_in_proportion_to_weight():
    per_kg = np.asarray(infusion_for(scaled_to_weight(PARKER_1999, jnp.asarray(WEIGHTS)), jnp.asarray(81.1))) / WEIGHTS
    np.testing.assert_allclose(per_kg / per_kg[1], [1 - 0.0155, 1.0, 1 + 0.0108], atol=2e-4)


def test_rest_differs_by_what_the_unscaled_rates_take_from_the_flows():
    p = scaled_to_weight(PARKER_1999, jnp.asarray(WEIGHTS))
    _, x = rest_at(p, jnp.asarray(81.1))
    row = dict(zip(STATE_NAMES, np.asarray(x), strict=True))
    np.testing.assert_allclose(row["G_H"], 81.1, rtol=1e-12)
    np.testing.assert_allclose(81.1 - row["G_BV"], 70.0 / 5.9 * 70.0 / WEIGHTS, rtol=1e-10)
    np.testing.assert_allclose(81.1 - row["G_G"], 20.0 / 10.1 * 70.0 / WEIGHTS, rtol=1e-10)
