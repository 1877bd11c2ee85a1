"""What can be set about a guard is what a guard has."""

import dataclasses

import pytest

from glucoloop.control import Guard, GuardSettings, design_open_loop
from glucoloop.experiments.designs import with_guard
from glucoloop.parts.guard import GUARD, OF_ROUTE, complete_guard
from glucoloop.parts.patients import patient_entry
from glucoloop.parts.routes import SUBCUTANEOUS
from glucoloop.pumps import PARKER_1999_LIMITS


def test_every_limit_can_be_set_and_has_the_guards_default():
    assert GuardSettings(**{key.removeprefix("guard_"): limit for key, limit in complete_guard({}).items()}) == (
        GuardSettings()
    )
    assert set(OF_ROUTE[SUBCUTANEOUS]) <= {field.name for field in dataclasses.fields(GuardSettings)}


def test_usual_limits_are_those_of_the_route_and_of_the_patient():
    assert complete_guard({}) == {name: setting.default.noise_free for name, setting in GUARD.items()}
    entry = patient_entry("hovorka-2004")
    of_route = {f"guard_{name}": value for name, value in OF_ROUTE[SUBCUTANEOUS].items()}
    assert complete_guard({}, entry) == {**complete_guard({}), **of_route}
    own = dataclasses.replace(entry, guard={"guard_max_hour": 7.0})
    assert complete_guard({}, own)["guard_max_hour"] == 7.0
    assert complete_guard({"guard_max_hour": 3}, own)["guard_max_hour"] == 3.0
    with pytest.raises(ValueError, match="by the route 'nasal'; the known ones are: intravenous, subcutaneous"):
        dataclasses.replace(entry, insulin_route="nasal")


def test_a_limit_reaches_the_guard():
    guard = with_guard(design_open_loop(), complete_guard({"guard_gap_min": 35}), PARKER_1999_LIMITS)
    assert isinstance(guard, Guard)
    assert guard.settings == GuardSettings(gap_min=35.0)
    assert with_guard(guard, None, PARKER_1999_LIMITS) is guard


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        ({"guard_gap": 35}, "a guard has no limit 'guard_gap'"),
        ({"guard_gap_min": "long"}, "guard_gap_min is 'long'; give a number"),
    ],
)
def test_what_is_no_limit_is_refused(given, sentence):
    with pytest.raises(ValueError, match="guard") as refused:
        complete_guard(given)
    assert sentence in str(refused.value)
