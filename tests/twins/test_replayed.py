"""People of a replay: who they are, and that who cannot give the record is left out."""

import numpy as np
import pytest

from glucoloop import Refusal
from glucoloop.patients.catalogue import patient_entry
from glucoloop.twins import StoredTwin, explained_people, replay_people, replayed
from glucoloop.twins.extended import NOISES, WAVES, ExtendedPatient
from glucoloop.twins.prior import Prior

PATIENT = "hovorka-2004"
SENSITIVE = patient_entry(PATIENT).insulin_sensitivity[0]


def stored(patient, names):
    n = len(names)
    prior = Prior("some", patient, names, np.zeros(n), 0.3 * np.eye(n), {})
    coordinates = n + WAVES + len(NOISES)
    return StoredTwin(
        patient=ExtendedPatient(prior, 2, "plasma"),
        p=np.zeros(coordinates),
        factor=0.1 * np.eye(coordinates),
        mean_mg_dl=150.0,
        verdict="",
        predicts=True,
    )


@pytest.fixture
def twin():
    return stored(PATIENT, (SENSITIVE, "V_G"))


def test_a_replay_has_the_twin_both_ends_of_its_sensitivity_and_people_drawn(twin):
    people = list(replay_people(twin, 40, 3))
    assert [person.end for person in people] == [None, 0.5, 1.5, *[None] * 41]
    assert [person.drawn for person in people] == [False] * 4 + [True] * 40
    values = [{name: float(of[0]) for name, of in patient.values(p).items()} for patient, p, *_ in people]
    sensitivity, volume = (np.array([of[name] for of in values]) for name in (SENSITIVE, "V_G"))
    assert sensitivity[:3] == pytest.approx([0.7, 0.35, 1.05])
    assert sensitivity[3] == pytest.approx(1.0)  # the twin as it was found
    assert volume[:4] == pytest.approx(1.0)
    returns = np.array([float(patient.noises(p)["return_min"]) for patient, p, *_ in people])
    assert returns[:3] == pytest.approx(np.sqrt(120.0 * 200.0))
    assert returns[3] == pytest.approx(1e5)
    # 0.6 beside a posterior of 0.1 times 0.3 and, by the square root, of 0.1 / 2
    for drawn, median, sd in (
        (sensitivity, 0.7, np.hypot(0.6, 0.03)),
        (returns, np.sqrt(24000.0), np.hypot(0.6, 0.05)),
    ):
        logarithms = np.log(drawn[4:] / median)
        assert logarithms.mean() == pytest.approx(0.0, abs=0.02)
        assert logarithms.std() == pytest.approx(sd, rel=0.1)
    assert np.log(volume[4:]).std() == pytest.approx(0.03, rel=0.1)
    again, others = (list(replay_people(twin, 40, seed))[-1].p for seed in (3, 4))
    assert (again == people[-1].p).all()
    assert (others != people[-1].p).any()
    assert len(list(replay_people(twin, 0, 3))) == 4


def test_a_patient_without_a_declared_sensitivity_has_no_ends():
    name = sorted(patient_entry("parker-1999").nominal)[0]
    people = list(replay_people(stored("parker-1999", (name,)), 5, 0))
    assert [person.end for person in people] == [None] * 7


def test_who_cannot_give_the_record_is_left_out(twin, monkeypatch):
    people = list(replay_people(twin, 3, 0))
    unable = {1, 4}

    def explained(patient, p, record, mean_mg_dl):
        at = next(at for at, of in enumerate(people) if of.p is p)
        if at in unable:
            raise Refusal("the equations of the twin cannot give this record")
        return at

    monkeypatch.setattr(replayed, "explained", explained)
    tried = []
    given = explained_people(people, None, 150.0, tried.append)
    assert [person.explained for person in given] == [0, 2, 3, 5, 6]
    assert [person.end for person in given] == [None, 1.5, None, None, None]
    assert [person.drawn for person in given] == [False] * 3 + [True] * 2
    assert tried == [1, 2, 3, 4, 5, 6, 7]
    unable.add(0)
    with pytest.raises(Refusal, match="cannot give this record"):
        explained_people(people, None, 150.0)
