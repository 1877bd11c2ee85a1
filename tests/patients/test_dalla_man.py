"""The average person of the simulator of 2008: rest, balances, and what is refused."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import glucoloop as gl
from glucoloop.patients import Inputs, Population, population, virtual_people
from glucoloop.patients.catalogue import patient_entry
from glucoloop.patients.dalla_man import STATE_NAMES, DallaManPatient
from glucoloop.patients.variation import Variation

C = DallaManPatient.nominal


@functools.cache
def average():
    return gl.patient("uva-padova-2008")


def insulin_at_rest(rate_mU_min):
    """Plasma insulin in pmol/l at steady state, by the algebra of the linear balances."""
    u = 6.0 * rate_mU_min / C["weight_kg"]
    m_30 = C["HE_b"] * C["m_1"] / (1.0 - C["HE_b"])
    return u / (C["m_2"] + C["m_4"] - C["m_1"] * C["m_2"] / (C["m_1"] + m_30)) / C["V_I"]


def test_the_state_at_rest_is_that_of_the_balances_by_hand():
    rate = float(average().basal_insulin_mU_min)
    x = dict(zip(STATE_NAMES, np.asarray(average().steady_state(rate)), strict=True))
    insulin = insulin_at_rest(rate)
    assert x["G_p"] / C["V_G"] == pytest.approx(120.0)
    assert x["I_p"] / C["V_I"] == pytest.approx(insulin)
    assert x["X"] == pytest.approx(insulin - C["I_b"])
    assert x["I_1"] == x["I_d"] == pytest.approx(insulin)
    made = C["k_p1"] - C["k_p2"] * x["G_p"] - C["k_p3"] * insulin
    taken_up = (C["V_m0"] + C["V_mx"] * x["X"]) * x["G_t"] / (C["K_m0"] + x["G_t"])
    assert made == pytest.approx(C["F_cns"] + taken_up)
    assert C["k_1"] * x["G_p"] - C["k_2"] * x["G_t"] == pytest.approx(taken_up)
    # what is injected is eliminated in the periphery and by the liver
    assert C["k_d"] * x["I_sc1"] == pytest.approx(C["k_a2"] * x["I_sc2"])


def test_constants_keep_the_identities_of_the_paper():
    # m_4 = 2/5 (1 - HE_b) of the clearance, which is 0.4 m_2 where the liver extracts 60 %; the paper rounds to 0.194
    assert C["m_4"] == pytest.approx(0.4 * C["m_2"], abs=5e-4)
    assert 0.0 < C["k_min"] < C["k_max"]


STATES = st.lists(st.floats(0.0, 400.0), min_size=10, max_size=10)


@given(STATES, st.floats(0.0, 500.0), st.floats(0.0, 300.0))
def test_what_is_not_made_or_taken_up_is_conserved(state, meal, insulin):
    x = jnp.asarray(state)
    rates = dict(zip(STATE_NAMES, np.asarray(_rates(x, jnp.asarray(insulin), jnp.asarray(meal))), strict=True))
    s = dict(zip(STATE_NAMES, state, strict=True))
    made = max(C["k_p1"] - C["k_p2"] * s["G_p"] - C["k_p3"] * s["I_d"], 0.0) + meal / C["weight_kg"]
    brain = C["F_cns"] * min(s["G_p"] / (5.0 * C["V_G"]), 1.0)
    kidney = C["k_e1"] * max(s["G_p"] - C["k_e2"], 0.0)
    tissues = (C["V_m0"] + C["V_mx"] * s["X"]) * s["G_t"] / (C["K_m0"] + s["G_t"])
    assert rates["G_p"] + rates["G_t"] == pytest.approx(made - brain - kidney - tissues, abs=1e-9)
    given_insulin = 6.0 * insulin / C["weight_kg"]
    lost = C["m_4"] * s["I_p"] + C["HE_b"] * C["m_1"] / (1.0 - C["HE_b"]) * s["I_l"]
    inside = sum(rates[name] for name in ("I_p", "I_l", "I_sc1", "I_sc2"))
    assert inside == pytest.approx(given_insulin - lost, abs=1e-9)


@jax.jit
def _rates(x, insulin, meal):
    return average().derivative(jnp.zeros(()), x, Inputs(insulin_mU_min=insulin, meal_mg_min=meal))


@given(STATES)
def test_no_state_leaves_zero_downwards(state):
    for place, name in enumerate(STATE_NAMES):
        if name != "X":
            at_zero = jnp.asarray(state).at[place].set(0.0)
            assert float(_rates(at_zero, jnp.zeros(()), jnp.zeros(()))[place]) >= 0.0, name


def test_there_is_no_spurious_rest_without_glucose():
    # the simulator stops glucose below zero for good; here it always recovers
    x = jnp.zeros(10)
    assert float(_rates(x, jnp.zeros(()), jnp.zeros(()))[0]) == pytest.approx(C["k_p1"])
    with pytest.raises(ValueError, match="no physiological steady state exists at 500 mU/min"):
        average().steady_state(500.0)


@pytest.mark.long
def test_everybody_of_the_population_rests():
    people = virtual_people(population("lognormal", patient="uva-padova-2008"), 0, np.arange(200))
    glucose = np.asarray(people.patient.glucose_mg_dl(people.rest))
    np.testing.assert_allclose(glucose, 120.0, rtol=1e-6)
    sound = patient_entry("uva-padova-2008").sound(jnp.asarray(people.rest), jnp.asarray(40.0))
    assert all(np.all(which) for which in sound)
    assert np.ptp(np.asarray(people.patient.meal_model.k_max)) > 0.01


def test_an_impossible_population_is_refused():
    with pytest.raises(ValueError, match=r"b can vary from 0\.72 to 1\.02 but must stay between 0 and 1"):
        Population(
            "x",
            (Variation(parameter="b", distribution="uniform", spread=0.15, centre=0.87),),
            patient="uva-padova-2008",
        )
    with pytest.raises(ValueError, match=r"V_mx can vary from .* but must stay above 0"):
        Population(
            "x", (Variation(parameter="V_mx", distribution="normal", spread_pct=50.0),), patient="uva-padova-2008"
        )


def test_glucose_is_read_in_plasma_and_in_the_interstitium():
    x = jnp.arange(10.0) + 100.0
    assert float(average().glucose_mg_dl(x)) == pytest.approx(100.0 / 1.88)
    assert float(average().seen_mg_dl(x, "interstitial")) == pytest.approx(102.0 / 1.88)
