"""Pump therapy and predictive control by a profile on the page: announced meals, boluses, and the guard around them."""

import numpy as np
import pytest

from glucoloop.build.assemble import close_loop
from glucoloop.build.designs import controller_of
from glucoloop.build.surroundings import surroundings_of
from glucoloop.lab.patient_functions import people_of
from glucoloop.patients import virtual_people
from glucoloop.patients.population import of_people
from glucoloop.simulation import simulate
from glucoloop.therapy import given_profile
from page_loops import run_of

THERAPY = "#patient=hovorka-2004&controller=basal-bolus&meals=60g@60min&announce_meals=true"
PREDICTIVE = THERAPY.replace("basal-bolus", "profile-mpc")
MONITOR = "&sensor=dexcom-g6,+worn_min=1440&duration_min=720"
LINKS = {
    "told late, with a blocked line": (
        "#patient=wilinska-2010&controller=basal-bolus,+carb_ratio_g_U=12&meals=60g@2h&meals=30g@301min"
        "&announce_meals=true&habits=announced-late,+minutes=20&sensor=white-noise,+variance=1.45"
        "&faults=occlusion,+start_min=100,+duration_min=60"
    ),
    "daily dose of the profile, told before the start": (
        "#patient=kanderian-2009&controller=basal-bolus&guard=usual,+max_on_board=3&meals=80g@10min&announce_meals=true"
        "&habits=announced-late,+minutes=-30"
    ),
    "predictive, in a guard": f"{PREDICTIVE}&guard=usual{MONITOR}",
    "predictive, told before eating": f"{PREDICTIVE}&announce_before_min=15{MONITOR}",
    "predictive, in a guard, told before eating and late": (
        f"{PREDICTIVE}&meals=40g@91min&guard=usual&announce_before_min=45&habits=announced-late,+minutes=10{MONITOR}"
    ),
    "predictive, by therapy settings alone": (
        f"{PREDICTIVE.replace('profile', 'therapy').replace('hovorka-2004', 'wilinska-2010')}{MONITOR}"
    ),
    "predictive, by therapy settings alone, in a guard": (
        f"{PREDICTIVE.replace('profile', 'therapy').replace('hovorka-2004', 'uva-padova-2008')}&guard=usual{MONITOR}"
    ),
}
"""Loops whose traces are compared with those of glucoloop."""
CLOSE_MG_DL = 0.02


@pytest.mark.long
@pytest.mark.parametrize("which", LINKS)
def test_a_run_with_boluses_is_that_of_glucoloop(which, in_node):
    [answer] = in_node([LINKS[which]])
    assert "refused" not in answer, answer["refused"]
    run = run_of(answer["toml"])
    controller = controller_of(run, run.case)
    trace = close_loop(run, controller, run.as_scenario(), surroundings=surroundings_of(run))
    found = answer["trace"]
    np.testing.assert_allclose(found["fine_glucose_mg_dl"], trace.fine_glucose_mg_dl, rtol=0.0, atol=CLOSE_MG_DL)
    # Boluses are whole steps of 50 mU: a dose at the border of two may differ by one of them.
    np.testing.assert_allclose(found["bolus_mU"], trace.bolus_mU, rtol=0.0, atol=50.1)
    assert sum(found["bolus_mU"]) == pytest.approx(float(np.sum(trace.bolus_mU)), abs=100.0)
    assert max(found["bolus_mU"]) > 500.0


def test_a_bolus_comes_when_the_controller_is_told(in_node):
    links = [THERAPY, f"{THERAPY}&announce_before_min=15", f"{THERAPY}&habits=announced-late,+minutes=20"]
    with_meal, before, after = in_node([*links])
    missed = in_node([THERAPY.replace("&announce_meals=true", "")])[0]
    first = [np.flatnonzero(answer["trace"]["bolus_mU"])[0] for answer in (with_meal, before, after)]
    assert first == [12, 9, 16]
    peaks = [answer["summary"]["peak_mg_dl"] for answer in (before, with_meal, after, missed)]
    assert peaks == sorted(peaks)
    assert peaks[1] - peaks[0] > 5.0
    basal = with_meal["trace"]["insulin_mU_min"][0]
    boluses_U = sum(with_meal["trace"]["bolus_mU"]) / 1000.0
    assert with_meal["summary"]["insulin_total_mU"] == pytest.approx(1000.0 * boluses_U + 600.0 * basal)


def test_a_model_lets_a_meal_begin_when_it_is_eaten(in_node):
    told, early, at_once = in_node(
        [f"{PREDICTIVE}&announce_before_min=30", f"{PREDICTIVE}&habits=announced-late,+minutes=-30", PREDICTIVE]
    )
    boluses = [np.array(answer["trace"]["bolus_mU"]) for answer in (told, early, at_once)]
    assert [np.flatnonzero(of > 500.0)[0] for of in boluses] == [6, 6, 12]
    # a meal that is taken for eaten at once, and does not appear, is accepted to be a smaller one
    peaks = [answer["summary"]["peak_mg_dl"] for answer in (told, early, at_once)]
    assert peaks[0] + 5.0 < peaks[1] < peaks[2] - 5.0


def test_what_is_announced_is_in_links_files_and_commands(in_node):
    link = f"{THERAPY}&announce_before_min=30&habits=announced-late,+minutes=20&habits=announced-late,+minutes=-5"
    [answer] = in_node([link])
    assert answer["unlike"] == []
    assert answer["again"]["situation"] == answer["situation"]
    assert "--announce-meals --announce-before 30 --habit 'announced-late, minutes=15'" in answer["command"]
    assert "announce_meals=True," in answer["python"]
    run = run_of(answer["toml"])
    assert run.announce_meals
    assert run.announce_before_min == 30.0
    assert [habit.minutes for habit in run.habits] == [15.0]
    assert [answer["situation"][name] for name in ("announce_before_min", "announced_late_min")] == [30, 15]


def test_what_the_page_does_not_have_is_refused(in_node):
    links = {
        "#patient=parker-1999&controller=basal-bolus": "the controller is 'basal-bolus'; the known ones are: pid",
        "#patient=wilinska-2010&controller=profile-mpc": "the controller is 'profile-mpc'; the known ones are: pid",
        f"{THERAPY}&habits=skipped,+probability=0.2": "it has the habit skipped, probability=0.2, which this page",
        f"{THERAPY}&habits=announced-late,+minutes=-300": "give a whole number from -120 to 120 min",
        f"{THERAPY}&announce_before_min=-15": "announced is -15 min; give a whole number from 0 to 120 min",
        f"{PREDICTIVE}&follow=3": "nobody is drawn around hovorka-2004 at fasting-120 under profile-mpc",
    }
    for answer, sentence in zip(in_node(list(links)), links.values(), strict=True):
        assert sentence in answer["refused"]


@pytest.mark.long
def test_people_under_pump_therapy_have_their_own_profile(in_node):
    people = virtual_people(people_of("hovorka-2004"), 0, [3])
    [answer] = in_node([{"link": THERAPY, "person": 3}])
    [nominal] = in_node([THERAPY])
    run = run_of(nominal["toml"])
    controller = given_profile(controller_of(run, run.case), of_people(people.profile, 0))
    trace = simulate(of_people(people.patient, 0), controller, scenario=run.as_scenario())
    found = answer["trace"]
    np.testing.assert_allclose(found["fine_glucose_mg_dl"], trace.fine_glucose_mg_dl, rtol=0.0, atol=CLOSE_MG_DL)
    for whose, profile in ((found, of_people(people.profile, 0)), (nominal["trace"], run.profile)):
        assert max(whose["bolus_mU"]) == pytest.approx(60_000.0 / float(profile.carb_ratio()), abs=50.1)
