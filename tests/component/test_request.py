"""What was requested and what was made of it are two values: neither is ever incomplete, and neither changes."""

import dataclasses
import pickle

import jax
import jax.numpy as jnp
import pytest

from glucoloop.component.catalogue import catalogues
from glucoloop.component.grammar import as_tree
from glucoloop.component.request import Request, completed, read, request_of, requested
from glucoloop.control.catalogue import CONTROLLERS
from glucoloop.patients import PATIENTS
from glucoloop.pumps import PUMPS
from glucoloop.refusal import Refusal
from glucoloop.sensors import WhiteNoise
from glucoloop.situations.case import Case, completed_case
from glucoloop.situations.run import Run
from glucoloop.situations.situation import Situation, configured
from glucoloop.studies.league import League
from glucoloop.trials.trial import Trial


def test_one_request_is_completed_for_each_patient_with_its_own_defaults():
    request = PUMPS.parse("limited, max_bolus_U=3")
    limits = {}
    for name in ("parker-1999", "uva-padova-2008"):
        pump = Situation(patient=PATIENTS.choose(name), pump=request).pump
        limits[name] = pump.max_insulin_mU_min
        assert (pump.max_bolus_U, pump.explicit) == (3.0, {"max_bolus_U": 3.0})
        again = Situation(patient=PATIENTS.choose("parker-1999"), pump=pump).pump  # which is made anew from its request
        assert again.max_insulin_mU_min == limits["parker-1999"]
    assert len(set(limits.values())) == 2
    assert request == PUMPS.parse("limited, max_bolus_U=3")
    assert request.explicit == {"max_bolus_U": 3.0}


def test_neither_a_request_nor_what_is_made_of_it_can_be_changed():
    run = configured(Run, controller="mpc-se, move_horizon=2", guard="usual")
    for part in (run, run.request, run.patient, run.case, run.case.controller, run.case.request):
        field = dataclasses.fields(part)[0].name
        with pytest.raises(dataclasses.FrozenInstanceError):
            setattr(part, field, None)


def test_every_component_of_the_package_knows_its_request():
    for kind, catalogue in catalogues().items():
        for name, component in catalogue.items():
            whole = component()
            assert whole.request == Request(component), (kind, name)
            assert completed(whole) == completed(Request(component)), (kind, name)
            assert request_of(whole).text == name


def test_a_component_that_jax_has_taken_apart_is_one_that_was_not_requested():
    noise = WhiteNoise(variance=jnp.asarray(2.0))
    again = jax.tree.map(lambda leaf: leaf, noise)
    assert noise.explicit.keys() == {"variance"}
    assert again.explicit == {}
    assert again.display_name == "white-noise"
    assert noise.replaced(variance=3.0).explicit.keys() == {"variance"}


def test_another_component_made_of_all_settings_has_them_all_in_its_request():
    noise = dataclasses.replace(WhiteNoise(variance=2.0), bound_mg_dl=4.0)
    assert noise.explicit == {"variance": 2.0, "bound_mg_dl": 4.0}
    assert pickle.loads(pickle.dumps(noise)) == noise
    assert pickle.loads(pickle.dumps(noise)).explicit == noise.explicit


def test_controllers_are_completed_in_their_situation_and_not_before():
    """36 samples ahead are the default of the patient; the controller alone has fewer than the moves here."""
    text = "mpc, move_horizon=20"
    with pytest.raises(Refusal, match="a prediction horizon of 8 is not possible with a move horizon of 20"):
        CONTROLLERS.choose(text)
    run = configured(Run, patient="hovorka-2004", controller=text)
    assert run.case.controller.prediction_horizon == 36
    assert run.controller[0].explicit["controller"].explicit == {"move_horizon": 20}
    league = configured(League, families=["hovorka-2004"], controllers=[text])
    assert league.tree()["controllers"] == [{"name": "mpc", "move_horizon": 20}]


def test_cases_of_a_trial_keep_the_models_that_they_were_completed_with():
    trial = configured(Trial, controller=["mpc", "basal"], model="memory=48", people=3)
    assert [case.model and case.model.memory for case in trial.cases] == [48, None]
    again = trial.with_cases(trial.cases)
    assert [str(case) for case in again.cases] == [str(case) for case in trial.cases]
    assert again.people_a_shard == trial.people_a_shard


def test_a_case_of_python_is_completed_in_each_situation_anew():
    situations = [configured(Situation, sensor=[f"white-noise, variance={variance}"]) for variance in (1, 4)]
    case = Case(controller=CONTROLLERS.choose("mpc"), label="mine")
    whole = [completed_case(request_of(case), situation) for situation in situations]
    assert [one.model.noise_variance for one in whole] == [1.0, 4.0]
    assert [completed_case(Request(Case, {"label": "mine"}), situation) for situation in situations] == whole


def test_a_request_is_refused_where_a_value_is_not_possible_and_says_where_it_stood():
    with pytest.raises(Refusal, match=r"^a\.toml: variance is -1"):
        requested(WhiteNoise, {"variance": -1.0}, source="a.toml")
    with pytest.raises(Refusal, match="has no setting 'loudness'"):
        requested(WhiteNoise, {"loudness": 1.0})
    request = read(WhiteNoise, as_tree({"name": "mine:Noise", "variance": 2}, "a.toml"))
    assert (request.source, request.display_name, request.explicit) == ("a.toml", "mine:Noise", {"variance": 2.0})
    assert completed(request).tree() == {"name": "mine:Noise", "variance": 2.0}
