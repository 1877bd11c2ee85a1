"""The thirty people of the simulator of 2008 against simglucose 0.2.11, given the same inputs minute by minute.

What is simglucose's own: a meal is eaten at 5 g/min, and glucose below zero is stopped for good; nobody comes near that
in the days of the tests.
"""

import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from glucoloop.meals import Eaten, absorb
from glucoloop.patients import population, virtual_people
from glucoloop.patients.dalla_man import DallaManPatient
from glucoloop.refusal import MissingExtraError
from glucoloop.simulation import Adaptive, Explicit
from glucoloop.simulation.plant import SampleGrid
from glucoloop.situations.situation import configured
from glucoloop.trials.engine import prepare, run_people
from glucoloop.trials.trial import Trial
from other_programs import answer_of, installed

FAMILY = "uva-padova-2008"
FIVE_MEALS = ((420, 45.0), (630, 15.0), (760, 70.0), (1010, 15.0), (1140, 80.0))
"""Minute and carbohydrate of the meals of a day."""
THREE_MEALS = ((420, 45.0), (720, 70.0), (1110, 80.0))
DAYS = """
import logging, types
logging.disable(logging.CRITICAL)  # gym asks to be replaced
from simglucose.patient.t1dpatient import Action, T1DPatient

def course(name, insulin_U_min, carbs_g):
    person = T1DPatient.withName(name)
    volume = person._params.Vg
    # the same numbers, looked up a hundred times faster
    person._params = types.SimpleNamespace(**person._params.to_dict())
    rows = [(person.state[3] / volume, person.state[12] / volume)]
    for insulin, carbs in zip(insulin_U_min, carbs_g, strict=True):
        person.step(Action(CHO=carbs, insulin=insulin))
        rows.append((person.state[3] / volume, person.state[12] / volume))
    return rows

print(json.dumps({name: course(name, **given) for name, given in asked.items()}))
"""
"""Plasma and interstitial glucose at each minute, from the start on, by what is given to whom in each minute."""
PRINTED = {
    "adult#001": {60: 138.560, 90: 167.710, 120: 193.646, 180: 179.748, 300: 169.977, 600: 112.495},
    "adolescent#001": {60: 149.020, 90: 153.474, 120: 158.464, 300: 110.960, 600: 122.810},
    "adult#005": {60: 142.670, 120: 191.839, 330: 181.542, 600: 140.026},
    "child#001": {60: 141.205, 90: 224.642, 180: 51.355, 270: 25.106, 600: 57.113},
}
"""Glucose by minute that a run of simglucose printed: 60 g at 60 min with 6 U in that minute."""


@pytest.fixture(scope="module")
def people():
    """Population of the installed package."""
    folder = installed("simglucose")
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(sys, "path", [*sys.path, str(folder)])
        return population("simglucose", patient=FAMILY)


def profile(people, name):
    return np.array(people.table.profile[name])


def where_they_rest(people):
    """All thirty at the glucose of the table, each under the basal rate of the table."""
    return DallaManPatient(
        parameters={name: jnp.asarray(values) for name, values in people.table.values.items()},
        basal_insulin_mU_min=jnp.asarray(profile(people, "basal_mU_min")),
        setpoint_mg_dl=jnp.asarray(profile(people, "setpoint_mg_dl")),
    )


def courses(people, meals, insulin_mU_min, integrator=None):
    """Plasma and interstitial glucose ``(minutes + 1, people, 2)`` and states, minute by minute."""
    patient, n = where_they_rest(people), len(people.table.names)
    each = {"t_min": [t for t, _ in meals], "carbs_g": [g for _, g in meals], "eating_min": [g / 5.0 for _, g in meals]}
    meal_arrays = Eaten(
        **{name: np.repeat(np.array(values, float)[:, None], n, axis=1) for name, values in each.items()}
    )
    grid = SampleGrid(sample_time_min=1.0, samples=insulin_mU_min.shape[0])
    plant, outside = (integrator or Explicit()).prepare(patient, absorb(patient.meal_model, meal_arrays), grid)
    x = jnp.asarray(patient.steady_state(patient.basal_insulin_mU_min))

    @jax.jit
    def run(x):
        def one(x, entry):
            return (after := plant.advance(x, *entry)[0]), after

        return jax.lax.scan(one, x, (jnp.asarray(insulin_mU_min), outside))[1]

    states = np.concatenate([x[None], run(x)])
    return np.stack([states[:, 0], states[:, 2]], axis=-1) / np.array(people.table.values["V_G"])[:, None], states


def with_boluses(people, meals, minutes, boluses_U):
    """Basal rates with boluses in the minutes of meals, ``(minutes, people)`` in mU/min."""
    insulin = np.tile(profile(people, "basal_mU_min"), (minutes, 1))
    for (minute, _), bolus in zip(meals, boluses_U, strict=True):
        insulin[minute] += 1000.0 * bolus
    return insulin


def by_carb_ratio(people, meals):
    return with_boluses(people, meals, 1440, [grams / profile(people, "carb_ratio_g_U") for _, grams in meals])


@pytest.mark.long
def test_a_day_of_all_thirty_is_that_of_simglucose(people):
    insulin, names = by_carb_ratio(people, FIVE_MEALS), people.table.names
    carbs = np.zeros(1440)
    for minute, grams in FIVE_MEALS:
        carbs[minute] = grams
    asked = {
        name: {"insulin_U_min": (insulin[:, i] / 1000.0).tolist(), "carbs_g": carbs.tolist()}
        for i, name in enumerate(names)
    }
    said = answer_of("simglucose", DAYS, asked)
    truth = np.stack([said[name] for name in names], axis=1)
    found, states = courses(people, FIVE_MEALS, insulin)
    assert np.min(truth) > 5.0
    errors = np.max(np.abs(found - truth), axis=(0, 2))
    assert np.max(errors) < 0.05
    assert np.median(errors) < 0.002
    assert np.min(np.delete(states, 7, axis=1)) >= 0.0


@pytest.mark.long
def test_a_day_of_all_thirty_is_that_of_the_adaptive_integrator(people):
    insulin = by_carb_ratio(people, THREE_MEALS)
    (found, _), (truth, _) = (courses(people, THREE_MEALS, insulin, of) for of in (None, Adaptive(1e-10)))
    assert np.min(truth) > 5.0
    assert np.min(np.ptp(truth, axis=0)) > 50.0
    np.testing.assert_allclose(found, truth, rtol=0.0, atol=0.025)


@pytest.mark.long
def test_printed_courses_are_found_again(people):
    meals, names = ((60, 60.0),), people.table.names
    found, _ = courses(people, meals, with_boluses(people, meals, 600, [np.full(len(names), 6.0)]))
    for name, printed in PRINTED.items():
        glucose = found[:, names.index(name), 0]
        np.testing.assert_allclose(glucose[list(printed)], list(printed.values()), rtol=0.0, atol=0.02)


@pytest.mark.long
def test_all_thirty_rest_where_the_table_says(people):
    patient, setpoint = where_they_rest(people), profile(people, "setpoint_mg_dl")
    basal = profile(people, "basal_mU_min")
    np.testing.assert_allclose(patient.glucose_mg_dl(patient.steady_state(basal)), setpoint, rtol=1e-9)
    np.testing.assert_allclose(patient.insulin_for(setpoint), basal, rtol=1e-8)


def test_the_table_keeps_the_identities_of_the_paper(people):
    c = {name: np.array(values) for name, values in people.table.values.items()}
    np.testing.assert_allclose(c["m_4"], 0.4 * c["m_2"], rtol=1e-9)
    G_p = profile(people, "setpoint_mg_dl") * c["V_G"]
    produced = c["k_p1"] - c["k_p2"] * G_p - c["k_p3"] * c["I_b"]
    G_t = (c["F_cns"] - produced + c["k_1"] * G_p) / c["k_2"]
    np.testing.assert_allclose(c["V_m0"], (produced - c["F_cns"]) * (c["K_m0"] + G_t) / G_t, rtol=1e-8)


@pytest.mark.long
def test_people_of_a_trial_rest_at_its_target_and_have_the_profile_of_the_table(people):
    found = virtual_people(people, 0, np.arange(30), setpoint_mg_dl=120.0)
    assert found.feasible.all()
    np.testing.assert_allclose(found.patient.glucose_mg_dl(jnp.asarray(found.rest)), 120.0, rtol=1e-9)
    higher = profile(people, "setpoint_mg_dl") > 120.0
    np.testing.assert_array_equal(found.basal_insulin_mU_min > profile(people, "basal_mU_min"), higher)
    for name in people.table.profile:
        np.testing.assert_array_equal(getattr(found.profile, name), profile(people, name))
    np.testing.assert_array_equal(found.profile.weight_kg, people.table.values["weight_kg"])


@pytest.mark.long
def test_by_their_own_basal_rates_people_of_a_trial_come_to_rest_where_the_table_says(people):
    keys = {"patient": FAMILY, "population": people, "controller": ["basal-bolus"]}
    trial = configured(Trial, {**keys, "meals": ["1g@4319min"], "duration_min": 4320.0})
    prepared = prepare(trial)
    assert prepared.cases["basal-bolus"].loop.engine == "native"
    found = run_people(prepared, "basal-bolus", np.arange(30), traces=True)
    np.testing.assert_allclose(found.glucose_mg_dl[-1], profile(people, "setpoint_mg_dl"), rtol=0.0, atol=0.05)
    assert trial.tree()["population"]["name"] == "simglucose"  # what has no simglucose any more can be read again


def test_one_person_is_chosen_by_name(people):
    one = virtual_people(people.alone("adult#001"), 0, [0])
    assert float(one.profile.basal_mU_min[0]) * 0.06 == pytest.approx(1.26736, abs=1e-5)
    with pytest.raises(ValueError, match="there is no person 'adult#011'; did you mean 'adult#01"):
        people.alone("adult#011")


def test_without_simglucose_it_is_refused_once_it_is_named(monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    told = r"^the population simglucose of uva-padova-2008 needs simglucose; .*: pip install 'glucoloop\[uva\]'$"
    with pytest.raises(MissingExtraError, match=told):
        population("simglucose", patient=FAMILY)
    assert population("lognormal", patient=FAMILY).table is None
