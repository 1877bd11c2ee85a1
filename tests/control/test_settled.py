"""A controller tells the settings that were settled when it was designed, through whatever is put around it."""

import pytest

from glucoloop.control import (
    BasalBolus,
    GuardSettings,
    PIDTuning,
    design_imc,
    design_open_loop,
    design_pid,
    guarded,
)
from glucoloop.control.protocol import computed_settings
from glucoloop.therapy import Profile


@pytest.mark.parametrize("wrapped", [False, True])
def test_pid_and_imc_tell_what_they_were_designed_with(wrapped):
    def around(controller):
        return guarded(controller, GuardSettings()) if wrapped else controller

    pid = around(design_pid(PIDTuning(0.8, 91.5, 2.4), sample_time_min=4.0))
    assert computed_settings(pid) == pytest.approx({"gain": 0.8, "integral_time_min": 91.5, "derivative_time_min": 2.4})
    imc = around(design_imc(-3.45, 89.1, 10.0, filter_min=20.0))
    assert computed_settings(imc) == pytest.approx(
        {"gain": -3.45, "tau_min": 89.1, "delay_min": 10.0, "filter_min": 20.0}
    )


def test_rules_of_a_basal_bolus_controller_are_told_as_numbers():
    told = computed_settings(BasalBolus().of_person(Profile(basal_mU_min=10.0, setpoint_mg_dl=110.0)))
    daily_U = 2.0 * 10.0 * 1.44  # half of a daily dose is basal
    assert told == pytest.approx(
        {"basal_mU_min": 10.0, "carb_ratio_g_U": 500.0 / daily_U, "correction_mg_dl_U": 1800.0 / daily_U}
    )


def test_controller_without_anything_settled():
    assert computed_settings(design_open_loop()) == {}
    assert computed_settings(object()) == {}
