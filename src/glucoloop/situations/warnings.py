"""Sentences on requests that are possible and hardly meant, for the notes of every command that takes them."""

from __future__ import annotations

from typing import Final

from glucoloop.situations.run import ControlledSituation

BOLUS_INTO_A_VEIN: Final = (
    "This patient gets insulin into a vein, where a bolus acts for minutes and a meal lasts for hours; boluses are "
    "meant for insulin under the skin, as of hovorka-2004."
)


def boluses_into_a_vein(asked: ControlledSituation) -> tuple[str, ...]:
    """The sentence above if any of the controllers gives boluses to a patient with insulin into a vein."""
    if asked.patient.under_the_skin or not any(case.controller.gives_boluses for case in asked.cases):
        return ()
    return (BOLUS_INTO_A_VEIN,)
