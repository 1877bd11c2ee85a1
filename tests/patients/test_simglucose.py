"""The thirty people of the simulator of 2008 against simglucose 0.2.11, given the same inputs minute by minute.

simglucose is run by a Python of its own, in which `.ci/simglucose` has put it and what it imports; where that is
missing, these tests are skipped. What is simglucose's own: a meal is eaten at 5 g/min, and glucose below zero is
stopped for good; nobody comes near that in the day of the test.
"""

import json
import os
import subprocess
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from glucoloop.meals import Eaten, absorb
from glucoloop.patients.dalla_man.simglucose import people_of_simglucose
from glucoloop.simulation import Explicit
from glucoloop.simulation.plant import SampleGrid

FOLDER = Path(os.environ.get("GLUCOLOOP_SIMGLUCOSE") or Path(__file__).parents[1] / "simglucose")
RUN = Path(__file__).parents[1] / "shared" / "simglucose_day.py"
MEALS = ((420, 45.0), (630, 15.0), (760, 70.0), (1010, 15.0), (1140, 80.0))
"""Minute and carbohydrate of the five meals of a day."""
PRINTED = {
    "adult#001": {60: 138.560, 90: 167.710, 120: 193.646, 180: 179.748, 300: 169.977, 600: 112.495},
    "adolescent#001": {60: 149.020, 90: 153.474, 120: 158.464, 300: 110.960, 600: 122.810},
    "adult#005": {60: 142.670, 120: 191.839, 330: 181.542, 600: 140.026},
    "child#001": {60: 141.205, 90: 224.642, 180: 51.355, 270: 25.106, 600: 57.113},
}
"""Glucose by minute that a run of simglucose printed: 60 g at 60 min with 6 U in that minute."""

pytestmark = [
    pytest.mark.long,
    pytest.mark.skipif(not (FOLDER / "simglucose").is_dir(), reason="needs simglucose 0.2.11: `.ci/simglucose`"),
]


@pytest.fixture(scope="module")
def people():
    return people_of_simglucose(FOLDER / "simglucose")


def courses(people, meals, insulin_mU_min):
    """Plasma and interstitial glucose ``(minutes + 1, people, 2)`` by the explicit integrator, minute by minute."""
    patient, n = people.patient(), len(people.name)
    each = {"t_min": [t for t, _ in meals], "carbs_g": [g for _, g in meals], "eating_min": [g / 5.0 for _, g in meals]}
    meal_arrays = Eaten(
        **{name: np.repeat(np.array(values, float)[:, None], n, axis=1) for name, values in each.items()}
    )
    grid = SampleGrid(sample_time_min=1.0, samples=insulin_mU_min.shape[0])
    plant, outside = Explicit().prepare(patient, absorb(patient.meal_model, meal_arrays), grid)
    x = jnp.asarray(patient.steady_state(patient.basal_insulin_mU_min))

    @jax.jit
    def run(x):
        def one(x, entry):
            return (after := plant.advance(x, *entry)[0]), after

        return jax.lax.scan(one, x, (jnp.asarray(insulin_mU_min), outside))[1]

    states = np.concatenate([x[None], run(x)])
    return np.stack([states[:, 0], states[:, 2]], axis=-1) / people.constants["V_G"][:, None], states


def with_boluses(people, meals, minutes, boluses_U):
    """Basal rates with boluses in the minutes of meals, ``(minutes, people)`` in mU/min."""
    insulin = np.tile(people.basal_insulin_mU_min, (minutes, 1))
    for (minute, _), bolus in zip(meals, boluses_U, strict=True):
        insulin[minute] += 1000.0 * bolus
    return insulin


def test_a_day_of_all_thirty_is_that_of_simglucose(people):
    boluses = [grams / people.carbs_ratio_g_U for _, grams in MEALS]
    insulin = with_boluses(people, MEALS, 1440, boluses)
    carbs = np.zeros(1440)
    for minute, grams in MEALS:
        carbs[minute] = grams
    given = {
        name: {"insulin_U_min": (insulin[:, i] / 1000.0).tolist(), "carbs_g": carbs.tolist()}
        for i, name in enumerate(people.name)
    }
    environment = {**os.environ, "PYTHONPATH": str(FOLDER)}
    done = subprocess.run(
        [sys.executable, str(RUN)],
        input=json.dumps(given),
        capture_output=True,
        text=True,
        env=environment,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    said = json.loads(done.stdout)
    truth = np.stack([said[name] for name in people.name], axis=1)
    found, states = courses(people, MEALS, insulin)
    assert np.min(truth) > 5.0
    errors = np.max(np.abs(found - truth), axis=(0, 2))
    assert np.max(errors) < 0.05
    assert np.median(errors) < 0.002
    assert np.min(np.delete(states, 7, axis=1)) >= 0.0


def test_printed_courses_are_found_again(people):
    meals = ((60, 60.0),)
    found, _ = courses(people, meals, with_boluses(people, meals, 600, [np.full(len(people.name), 6.0)]))
    for name, printed in PRINTED.items():
        glucose = found[:, people.name.index(name), 0]
        np.testing.assert_allclose(glucose[list(printed)], list(printed.values()), rtol=0.0, atol=0.02)


def test_all_thirty_rest_where_the_table_says(people):
    patient = people.patient()
    np.testing.assert_allclose(
        patient.glucose_mg_dl(patient.steady_state(patient.basal_insulin_mU_min)), people.setpoint_mg_dl, rtol=1e-9
    )
    np.testing.assert_allclose(patient.insulin_for(people.setpoint_mg_dl), people.basal_insulin_mU_min, rtol=1e-8)


def test_the_table_keeps_the_identities_of_the_paper(people):
    c, (G_b, I_b) = people.constants, (people.setpoint_mg_dl, people.constants["I_b"])
    np.testing.assert_allclose(c["m_4"], 0.4 * c["m_2"], rtol=1e-9)
    G_p = G_b * c["V_G"]
    produced = c["k_p1"] - c["k_p2"] * G_p - c["k_p3"] * I_b
    G_t = (c["F_cns"] - produced + c["k_1"] * G_p) / c["k_2"]
    np.testing.assert_allclose(c["V_m0"], (produced - c["F_cns"]) * (c["K_m0"] + G_t) / G_t, rtol=1e-8)


def test_one_person_is_chosen_by_name(people):
    one = people.patient("adult#001")
    assert float(one.basal_insulin_mU_min) * 0.06 == pytest.approx(1.26736, abs=1e-5)
    assert np.shape(people.patient("adult#001", "child#003").basal_insulin_mU_min) == (2,)
    with pytest.raises(ValueError, match="simglucose has nobody called 'adult#011'; its people are: adolescent#001"):
        people.patient("adult#011")
