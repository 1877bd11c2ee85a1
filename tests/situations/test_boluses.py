"""Limits of a bolus are settings of the pump, and a bolus into a vein is doubted."""

import pytest

from glucoloop.build.designs import controller_of
from glucoloop.build.surroundings import surroundings_of
from glucoloop.pumps import bolus_limits
from glucoloop.situations.run import INTRAVENOUS_BOLUS, Run, intravenous_boluses
from glucoloop.situations.situation import configured

KEYS = {"patient": "hovorka-2004", "controller": "basal-bolus"}


def test_limits_of_a_bolus_reach_the_pump_and_the_controller():
    run = configured(Run, KEYS, pump="max_bolus_U=3, min_bolus_U=0.1, bolus_step_U=0.025")
    wanted = bolus_limits(max_U=3.0, min_U=0.1, step_U=0.025)
    assert surroundings_of(run).pump.bolus == wanted
    assert controller_of(run, run.case).bolus == wanted


@pytest.mark.parametrize("given", ["max_bolus_U=0", "bolus_step_U=-0.1", "min_bolus_U=-1"])
def test_impossible_limits_are_refused_by_name(given):
    with pytest.raises(ValueError, match=given.partition("=")[0]):
        configured(Run, KEYS, pump=given)


def test_limits_that_exclude_one_another_are_refused():
    with pytest.raises(ValueError, match="boluses in steps of 2 U up to 1 U are not possible"):
        configured(Run, KEYS, pump="max_bolus_U=1, bolus_step_U=2")


def test_boluses_into_a_vein_are_noted_and_under_the_skin_are_not():
    assert intravenous_boluses(configured(Run, KEYS)) == ()
    assert intravenous_boluses(configured(Run, controller=["mpc", "pid"])) == ()
    assert intravenous_boluses(configured(Run, controller=["mpc", "basal-bolus"])) == (INTRAVENOUS_BOLUS,)
