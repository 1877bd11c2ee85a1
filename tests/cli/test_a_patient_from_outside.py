"""A patient that another package brings is at home in every command."""

import json
import shlex
from pathlib import Path

import numpy as np
import pytest

from glucoloop.component.code import entry_points
from glucoloop.component.routes import PUMP_OF_1999
from glucoloop.patients import patient, population, virtual_people
from glucoloop.patients.catalogue import PATIENTS

EXAMPLE = Path(__file__).parents[2] / "examples" / "bergman.py"
NAME = "bergman:Minimal"


@pytest.fixture
def outside(install, tmp_path):
    """A folder with the module, and an entry point that names it."""
    install("bergman", "patients", "minimal", "Minimal")
    return tmp_path


def test_it_is_found_by_its_entry_point_and_by_its_place(outside):
    assert "minimal" in entry_points("patients")
    assert "minimal" in PATIENTS.names()
    for name in ("minimal", NAME):
        person = patient(name)
        # p_1 (G_0 - 90) / 90 is the effect of insulin, p_2 / p_3 times it insulin, and V_I n times that the rate
        by_hand = 12.0 * 0.09 * 0.025 / 1.3e-5 * 0.02 * (150.0 - 90.0) / 90.0
        assert float(person.basal_insulin_mU_min) == pytest.approx(by_hand, rel=1e-12)
        assert float(person.glucose_mg_dl(person.steady_state(person.basal_insulin_mU_min))) == pytest.approx(90.0)


def test_its_people_rest_where_they_are_to(outside):
    people = virtual_people(population("varied", patient="minimal"), 1, np.arange(40))
    assert set(people.draw.values) == {"p_1", "p_3", "n"}
    held = people.feasible
    assert held.all()
    still = people.patient.derivative(0.0, people.rest, _fasting(people.basal_insulin_mU_min))
    np.testing.assert_allclose(np.asarray(still)[:, held], 0.0, atol=1e-12)
    np.testing.assert_allclose(people.rest[0, held], 90.0)


def _fasting(insulin):
    from glucoloop.patients import Inputs

    return Inputs(insulin_mU_min=insulin, meal_mg_min=0.0 * insulin)


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("nobody", "unknown patient 'nobody'; the known ones are: parker-1999, hovorka-2004"),
        ("no_such_module:X", "no_such_module cannot be imported: ModuleNotFoundError"),
        ("bergman:NOBODY", "bergman has no NOBODY; name what it defines, like bergman:NAME"),
        ("bergman:Variation", "bergman:Variation is no patient: make it a class of PatientComponent"),
    ],
)
def test_what_cannot_be_found_is_told(outside, glucoloop, name, told):
    answer = glucoloop("run", "--patient", name)
    assert answer.code == 2
    assert told in answer.err


def test_another_operating_point_than_the_patients_is_refused(outside, glucoloop):
    answer = glucoloop("run", "--patient", f"{NAME}, operating_point=setpoint-81")
    assert answer.code == 2
    assert "unknown operating point 'setpoint-81' of bergman:Minimal; the known ones are: at-90" in answer.err


def test_a_population_of_another_patient_is_refused(outside, glucoloop):
    answer = glucoloop("trial", "--patient", NAME, "--population", "parker2000", "--out", "t")
    assert answer.code == 2
    assert "unknown population 'parker2000' of bergman:Minimal; the known ones are: nominal, varied" in answer.err


@pytest.mark.long
def test_a_run_and_its_repetition(outside, glucoloop):
    first = glucoloop("run", "--patient", NAME, "--controller", "pid", "--out", "a", "--json")
    assert first.code == 0
    told = json.loads(first.out)
    assert told["config"]["patient"]["name"] == NAME
    assert told["config"]["pump"]["max_insulin_mU_min"] == PUMP_OF_1999.max_mU_min
    again = glucoloop("run", "--config", "a/run.toml", "--allow-code", "--out", "b")
    assert again.code == 0
    assert Path("a/trace.csv").read_bytes() == Path("b/trace.csv").read_bytes()


COMMANDS = {
    "identify": "",
    "compare": "--controller pid --controller mpc-se",
    "bound": "--duration 300",
    "tune": "--controller 'mpc, move_horizon=1:2, prediction_horizon=24'",
    "trial": "--people 4 --controller mpc --duration 600 --meal 50g@50min",
    "stress": "--people 4 --controller pid --fault 'missing, start_min=60, duration_min=30'",
    "verify": "--loops 4 --controller pid",
    "detect": "--days 1 --estimator kalman",
    "robust": "--people 2 --seeds 1 --check-people 2 --check-seeds 1 --rounds 1 --batch 2",
    "adversary": "--controller pid --people 2 --generations 2 --error 10",
}
WITH_FOLDER = ("trial", "stress", "robust", "adversary")
SLOW = ("detect", "robust", "verify")
PEOPLE = (NAME, "kanderian-2009, person=3", "kanderian-2009", "hovorka-2004, person=17")


@pytest.mark.long
@pytest.mark.parametrize(
    ("command", "patient"),
    [(command, patient) for command in COMMANDS for patient in PEOPLE[: 2 if command in SLOW else None]],
)
def test_every_command_takes_it(outside, glucoloop, command, patient):
    folder = ("--out", "out") if command in WITH_FOLDER else ()
    answer = glucoloop(command, *shlex.split(COMMANDS[command]), *folder, "--patient", patient)
    assert answer.code == 0, answer.err
