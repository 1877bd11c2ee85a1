"""Limits of a bolus are keys of the pump, and a bolus into a vein is doubted."""

import pytest

from glucoloop.cli.telling import note_on_boluses
from glucoloop.config.run import read_run
from glucoloop.experiments.designs import controller_of
from glucoloop.experiments.surroundings import surroundings_of
from glucoloop.pumps import bolus_limits

KEYS = {"patient": "hovorka-2004", "controller": "basal-bolus"}


def test_limits_of_a_bolus_reach_the_pump_and_the_controller():
    run = read_run({**KEYS, "max_bolus_U": 3.0, "min_bolus_U": 0.1, "bolus_step_U": 0.025})
    wanted = bolus_limits(max_U=3.0, min_U=0.1, step_U=0.025)
    situation = run.situation.situation()
    assert surroundings_of(situation).pump.bolus == wanted
    assert controller_of(situation, run.case.case()).bolus == wanted


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ({"max_bolus_U": 0.0}, "max_bolus_U"),
        ({"bolus_step_U": -0.1}, "bolus_step_U"),
        ({"min_bolus_U": -1.0}, "min_bolus_U"),
    ],
)
def test_impossible_limits_are_refused_by_name(given, told):
    with pytest.raises(ValueError, match=told):
        read_run({**KEYS, **given})


def test_limits_that_exclude_one_another_are_refused():
    with pytest.raises(ValueError, match="boluses in steps of 2 U up to 1 U are not possible"):
        read_run({**KEYS, "max_bolus_U": 1.0, "bolus_step_U": 2.0})


def test_boluses_into_a_vein_are_noted_and_under_the_skin_are_not(capsys):
    note_on_boluses("hovorka-2004", ["basal-bolus", "mpc"])
    note_on_boluses("parker-1999", ["mpc", "pid"])
    assert capsys.readouterr().err == ""
    note_on_boluses("parker-1999", ["mpc", "basal-bolus"])
    assert "insulin into a vein, where a bolus acts for minutes" in capsys.readouterr().err
