"""Gain and lag of people from their own records, and the controllers that know them."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from glucoloop.build import individual
from glucoloop.build.individual import by_record, impulse_response, individual_design, pulses
from glucoloop.control import MealMPC
from glucoloop.models.nonlinear import individual_model
from glucoloop.patients import patient, population, virtual_people
from glucoloop.simulation.internal_model import linear_model, nonlinear_model
from glucoloop.situations.situation import configured
from glucoloop.trials.trial import Trial

PEOPLE = 24


def trial_of(by="record"):
    return configured(
        Trial,
        people=PEOPLE,
        meals=["50g@50min"],
        duration_min=600.0,
        controller={"name": "meal-mpc", "individual_by": by},
        seed=3,
        sensor="white-noise, variance=1.45",
        design="individual",
    )


@pytest.fixture(scope="module")
def people():
    return virtual_people(population("parker2000"), 3, np.arange(PEOPLE))


@pytest.fixture(scope="module")
def known(people):
    """What records with noise tell of people."""
    return by_record(trial_of(), people)


def gain_of(model):
    return float(model.C @ jnp.linalg.solve(jnp.eye(model.Gamma.size) - model.Phi, model.Gamma))


@pytest.fixture(scope="module")
def true_gain(people):
    def own(place):
        return jax.tree.map(lambda a: a[place] if jnp.ndim(a) else a, people.patient)

    return np.array([gain_of(linear_model(own(place))) for place in range(PEOPLE)]) / gain_of(linear_model(patient()))


def test_impulse_response_is_that_of_the_linear_model():
    model = linear_model(patient())
    found = impulse_response(model, 400)
    assert found[0] == pytest.approx(float(model.C @ model.Gamma))
    assert found.sum() == pytest.approx(gain_of(model), rel=1e-3)


def test_a_record_tells_the_gain_of_the_linearisation(people, true_gain, known):
    assert np.log(true_gain).std() > 0.25
    gain, lag = known(people)
    assert np.sqrt(np.mean(np.log(gain / true_gain) ** 2)) < 0.12
    assert ((lag > 0.4) & (lag < 2.0)).all()


def test_pulses_go_up_and_down():
    shape = pulses(5.0)
    assert shape.size == 72
    np.testing.assert_array_equal(np.flatnonzero(shape > 0.0), np.arange(6))
    np.testing.assert_array_equal(np.flatnonzero(shape < 0.0), np.arange(36, 42))


@pytest.mark.parametrize("by", ["record", "basal", "none"])
def test_everybody_gets_his_own(people, true_gain, known, monkeypatch, by):
    one = patient()
    model = nonlinear_model(one)
    own = individual_model(model, model.insulin_mU_min)
    monkeypatch.setattr(individual, "controller_of", lambda *_: MealMPC().replaced(model=own))
    monkeypatch.setattr(individual, "by_record", lambda *_: known)
    trial = trial_of(by)
    found = individual_design(trial, trial.cases[0], None, people)(people).model
    np.testing.assert_array_equal(found.insulin_mU_min, people.basal_insulin_mU_min)
    error = np.sqrt(np.mean(np.log(np.asarray(found.gain) / true_gain) ** 2))
    assert found.gain.shape == found.lag.shape == (PEOPLE,)
    if by == "none":
        assert (found.gain == 1.0).all()
    else:
        assert error < {"record": 0.12, "basal": 0.95 * np.sqrt(np.mean(np.log(true_gain) ** 2))}[by]


@pytest.mark.long
def test_somebody_without_a_basal_rate_does_not_disturb_the_others(known):
    found = virtual_people(population("parker2000"), 0, [11, 12], setpoint_mg_dl=120.0)
    assert found.feasible.tolist() == [False, True]
    gain, lag = known(found)
    assert (gain[0], lag[0]) == (1.0, 1.0)
    assert np.isfinite((gain[1], lag[1])).all()
    assert gain[1] != 1.0
