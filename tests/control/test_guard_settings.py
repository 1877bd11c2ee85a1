"""What can be set about a guard is what a guard has."""

import dataclasses

import pytest

from glucoloop.build.designs import with_guard
from glucoloop.component.routes import SUBCUTANEOUS
from glucoloop.control import Guard, GuardSettings, design_open_loop
from glucoloop.control.guard_settings import GUARDS, OF_ROUTE, guard_of
from glucoloop.patients.catalogue import DEFAULT_PATIENT, patient_entry
from glucoloop.patients.component import PatientComponent
from glucoloop.pumps import PARKER_1999_LIMITS


def test_usual_limits_are_those_of_the_route_and_of_the_patient():
    assert set(OF_ROUTE[SUBCUTANEOUS]) <= set(GuardSettings.settings())
    assert guard_of(DEFAULT_PATIENT) == GuardSettings()
    subcutaneous = patient_entry("hovorka-2004")
    assert guard_of(subcutaneous) == GuardSettings(**OF_ROUTE[SUBCUTANEOUS])

    class Own(subcutaneous, name="own"):
        """Somebody with a limit of their own."""

        guard = {"max_hour": 7.0}  # noqa: RUF012

    assert guard_of(Own) == dataclasses.replace(guard_of(subcutaneous), max_hour=7.0)
    assert guard_of(Own, GUARDS.parse("max_hour=3")).max_hour == 3.0
    with pytest.raises(
        ValueError, match="unknown route of insulin 'nasal'; the known ones are: intravenous, subcutaneous"
    ):

        class Nasal(PatientComponent, name="nasal"):
            """Somebody with insulin through the nose."""

            insulin_route = "nasal"


def test_a_limit_reaches_the_guard():
    guard = with_guard(design_open_loop(), guard_of(DEFAULT_PATIENT, GUARDS.parse("gap_min=35")), PARKER_1999_LIMITS)
    assert isinstance(guard, Guard)
    assert guard.settings == GuardSettings(gap_min=35.0)
    assert with_guard(guard, None, PARKER_1999_LIMITS) is guard


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("gap_mi=35", "--guard: the guard usual has no setting 'gap_mi'; did you mean 'gap_min'?"),
        ("gap_min=long", "--guard: gap_min is 'long'; give a number from 0 to 10000 min"),
        ("usual, gap_min=-1", "--guard: usual: gap_min is -1 min; give a number from 0 to 10000 min"),
    ],
)
def test_what_is_no_limit_is_refused(text, sentence):
    with pytest.raises(ValueError, match="guard") as refused:
        GUARDS.parse(text, "--guard")
    assert sentence in str(refused.value)
