"""Sentences on requests that are possible and hardly meant, for the notes of every command that takes them."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

from glucoloop.control.catalogue import controller_entry
from glucoloop.parts.patients import patient_entry

BOLUS_INTO_A_VEIN: Final = (
    "This patient gets insulin into a vein, where a bolus acts for minutes and a meal lasts for hours; boluses are "
    "meant for insulin under the skin, as of hovorka-2004."
)


def boluses_into_a_vein(patient: str, controllers: Iterable[str]) -> tuple[str, ...]:
    """The sentence above if any of the controllers gives boluses to a patient with insulin into a vein.

    Raises
    ------
    ValueError
        For an unknown patient or controller.
    """
    if patient_entry(patient).under_the_skin:
        return ()
    return (BOLUS_INTO_A_VEIN,) if any(controller_entry(name).gives_boluses for name in controllers) else ()
