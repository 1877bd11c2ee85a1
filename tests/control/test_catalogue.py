"""The catalogue of controllers: names, settings, defaults, and a controller behind every name."""

from typing import ClassVar

import pytest

import glucoloop as gl
from glucoloop.build.designs import SituationDesignCase
from glucoloop.component.request import Request, completed
from glucoloop.component.setting import Default
from glucoloop.control.catalogue import CONTROLLERS, controller_entry
from glucoloop.control.protocol import gives_boluses
from glucoloop.control.tuning import DEFAULT_FLOOR_WEIGHT
from glucoloop.models.step_response import StepResponseModel
from glucoloop.patients.catalogue import DEFAULT_PATIENT
from glucoloop.patients.component import OperatingPoint, PatientComponent
from glucoloop.pumps import PARKER_1999_LIMITS

SLOW_ARE_LONG = [pytest.param(name, marks=pytest.mark.long) if of.slow else name for name, of in CONTROLLERS.items()]


@pytest.mark.parametrize("operating_point", ["setpoint-81", "nominal-22"])
@pytest.mark.parametrize("noisy", [False, True])
@pytest.mark.parametrize("name", SLOW_ARE_LONG)
def test_every_controller_is_designed_with_its_defaults(name, noisy, operating_point):
    case = SituationDesignCase(
        patient=gl.patient(operating_point=operating_point),
        model=StepResponseModel.from_impulse_response([-0.1, -0.3, -0.2, -0.1, -0.05] + [0.0] * 10, 5.0),
        limits=PARKER_1999_LIMITS,
        sample_time_min=5.0,
        noise_variance=1.45 if noisy else 0.0,
        dead_time_samples=0,
    )
    entry = controller_entry(name)
    usual = DEFAULT_PATIENT(operating_point=operating_point).controller_defaults(name)
    controller = completed(entry(), usual, noisy=noisy).designed(case)
    assert controller.sample_time_min == 5.0
    assert gives_boluses(controller) == entry.gives_boluses


@pytest.mark.parametrize("name", ["mpc", "mpc-se", "nlqdmc-se"])
def test_the_floor_reaches_the_design_and_is_none_by_default(name):
    case = SituationDesignCase(
        patient=gl.patient(),
        model=StepResponseModel.from_impulse_response([-0.1, -0.3, -0.2, -0.1, -0.05] + [0.0] * 10, 5.0),
        limits=PARKER_1999_LIMITS,
        sample_time_min=5.0,
        noise_variance=0.0,
        dead_time_samples=0,
    )
    for given in ({}, {"glucose_floor_mg_dl": 65.0}, {"glucose_floor_mg_dl": 65.0, "floor_weight": 4.0}):
        request = Request(controller_entry(name), given)
        controller = completed(request, DEFAULT_PATIENT().controller_defaults(name)).designed(case)
        floor = controller.floor if name == "nlqdmc-se" else controller.plan.floor
        if given:
            assert (floor.glucose_mg_dl, floor.weight) == (65.0, given.get("floor_weight", DEFAULT_FLOOR_WEIGHT))
        else:
            assert floor is None


def test_a_name_has_one_type_in_all_controllers():
    found = {}
    for controller in CONTROLLERS.values():
        for name, setting in controller.settings().items():
            assert found.setdefault(name, (setting.kind, setting.choices)) == (setting.kind, setting.choices), name


class _Somebody(PatientComponent, name="somebody"):
    """Somebody."""

    operating_points = (OperatingPoint("here", "", {"pid": {"gain": Default(3.0)}}), OperatingPoint("there", ""))
    pulse_mU_min = 1.0
    tunings: ClassVar = {"pid": {"gain": Default(2.0), "closed_loop_min": Default(9.0)}}


def test_usual_settings_are_those_of_the_operating_point_before_those_of_the_patient():
    pid = CONTROLLERS["pid"]
    here, there = (_Somebody(operating_point=name).controller_defaults("pid") for name in ("here", "there"))
    assert completed(Request(pid), here).gain == 3.0
    assert completed(Request(pid), there).gain == 2.0
    assert completed(Request(pid), here).closed_loop_min == 9.0
    assert completed(Request(pid, {"gain": 1.0}), here).gain == 1.0
    with pytest.raises(ValueError, match=r"unknown operating point 'her' of somebody; did you mean 'here'\?"):
        _Somebody(operating_point="her")


def test_unknown_names_are_answered():
    with pytest.raises(ValueError, match=r"unknown controller 'mcp'; did you mean 'mpc'\? the known ones are: mpc"):
        controller_entry("mcp")
    with pytest.raises(ValueError, match="controller mpc has no setting 'gain'; the known ones are: move_horizon"):
        controller_entry("mpc").setting("gain")


def test_design_that_needs_a_model_says_so():
    case = SituationDesignCase(
        patient=gl.patient(), model=None, limits=PARKER_1999_LIMITS, sample_time_min=5.0, noise_variance=0.0,
        dead_time_samples=0,
    )  # fmt: skip
    with pytest.raises(TypeError, match="uses no model"):
        _ = case.identified
