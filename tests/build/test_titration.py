"""Carbohydrate ratio and correction factor that are titrated on people."""

import dataclasses

import numpy as np
import pytest
import scipy.integrate

import glucoloop as gl
from glucoloop.build.titration import MEAL_G, Titration, profile_of, with_profiles
from glucoloop.control import BasalBolus
from glucoloop.meals import Meal, Scenario
from glucoloop.patients import PeopleTable, Population, patient, population, virtual_people
from glucoloop.patients.population import of_people
from glucoloop.pumps.limits import BolusLimits
from glucoloop.simulation import Adaptive
from glucoloop.situations.run import Run
from glucoloop.situations.situation import configured

TEN = population("kanderian2009", patient="kanderian-2009")
FINE = BolusLimits(max_mU=1e9, min_mU=0.0, step_mU=1e-6)
WIDE = gl.dose_limits(max_mU_min=1e3, max_change_mU_min=1e3, allow_unusual=True)


@pytest.fixture(scope="module")
def ten():
    people = virtual_people(TEN, 0, np.arange(10))
    titration = Titration(patient("kanderian-2009"), people.at(np.arange(1)).patient)
    return people, titration, titration.profile(people)


@pytest.mark.long
@pytest.mark.parametrize("name", ["1", "2", "9"])
def test_glucose_is_back_where_it_was_when_the_action_ends(ten, name):
    people, _, profile = ten
    row = TEN.table.names.index(name)
    who, own = of_people(people.patient, row), of_people(profile, row)
    controller = BasalBolus(carb_ratio_g_U=float(own.carb_ratio_g_U)).of_person(
        own, WIDE, bolus=FINE, allow_unusual=True
    )
    meal = Scenario([Meal(MEAL_G, 0.0)], 300.0, announced=True)
    pump = gl.LimitedPump(limits=WIDE, bolus=FINE)
    glucose = np.asarray(
        gl.simulate(who, controller, pump=pump, scenario=meal, integrator=Adaptive()).fine_glucose_mg_dl
    )
    assert np.ptp(glucose) > 5.0
    assert glucose[-1] == pytest.approx(120.0, abs=0.05)


@pytest.mark.long
def test_correction_factor_is_the_fall_that_scipy_finds(ten):
    people, _, profile = ten
    for row in (0, 3, 5):
        c = {name: values[row] for name, values in TEN.table.values.items()}
        basal = people.basal_insulin_mU_min[row]

        def rates(t_min, x, c=c, basal=basal):
            # as in every loop, a bolus reaches the person evenly within a sample
            infused = 1e3 * (basal + (60.0 * basal / 5.0 if t_min < 5.0 else 0.0)) / c["C_I"]
            return [
                (infused - x[0]) / c["tau_1"],
                (x[0] - x[1]) / c["tau_2"],
                c["p_2"] * (c["S_I"] * x[1] - x[2]),
                c["EGP"] - (c["GEZI"] + x[2]) * x[3],
            ]

        def solved(x, since, until):
            times = np.arange(since, until + 0.1, 5.0)
            inside = (since + 1e-9, until - 1e-9)
            return scipy.integrate.solve_ivp(
                rates, inside, x, "DOP853", np.clip(times, *inside), rtol=1e-10, atol=1e-12
            ).y

        first = solved(people.rest[:4, row], 0.0, 5.0)
        lowest = min(first[3].min(), solved(first[:, -1], 5.0, 300.0)[3].min())
        assert profile.correction_mg_dl_U[row] == pytest.approx((120.0 - lowest) / (60e-3 * basal), rel=1e-6)


@pytest.mark.long
def test_a_person_is_the_same_whoever_else_is_titrated(ten):
    people, titration, profile = ten
    some = titration.profile(people.at(np.array([7, 2, 2])))
    assert some.carb_ratio_g_U.tolist() == profile.carb_ratio_g_U[[7, 2, 2]].tolist()
    assert some.correction_mg_dl_U.tolist() == profile.correction_mg_dl_U[[7, 2, 2]].tolist()
    assert titration.profile(people.at(np.zeros(0, np.intp))).carb_ratio_g_U.shape == (0,)


@pytest.mark.long
def test_who_needs_no_bolus_has_no_ratio():
    """A person whose glucose falls back within the hour, whatever the insulin."""
    row = {name: (values[0],) for name, values in TEN.table.values.items()}
    quick = PeopleTable(names=("quick",), values={**row, "GEZI": (0.05,), "EGP": (7.0,), "tau_m": (10.0,)})
    people = virtual_people(Population("one", (), "", "kanderian-2009", quick), 0, [0])
    profile = Titration(patient("kanderian-2009"), people.patient).profile(people)
    assert people.feasible.all()
    assert np.isnan(profile.carb_ratio_g_U).all()
    assert (profile.correction_mg_dl_U > 0.0).all()


@pytest.mark.long
def test_a_run_of_one_person_and_people_have_the_same_profile(ten):
    _, _, profile = ten
    run = configured(Run, patient="kanderian-2009, person=3", profile_by="titration")
    own = profile_of(run)
    assert float(own.carb_ratio_g_U) == pytest.approx(profile.carb_ratio_g_U[2], rel=1e-9)
    assert float(own.total_daily_dose_U) == 30.0
    people = virtual_people(TEN, 0, np.arange(10))
    assert with_profiles(dataclasses.replace(run, profile_by="table"), people) is people
