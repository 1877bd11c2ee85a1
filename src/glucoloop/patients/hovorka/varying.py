"""Constants that can vary from person to person, their bounds, and the parameters that result.

Varied are the constants of the patient by name, body weight among them. Absorption of insulin can be varied by its rate
as well, ``absorption_rate = 1 / t_maxI``, since that is the quantity whose distribution is published.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any, Final

from glucoloop.patients.hovorka.equations import HovorkaParameters
from glucoloop.patients.hovorka.parameters.hovorka2004 import CONSTANTS, HOVORKA_2004
from glucoloop.patients.variation import Distribution

ABSORPTION_TIME: Final = "t_maxI"
ABSORPTION_RATE: Final = "absorption_rate"
UPTAKE_THRESHOLD: Final = "uptake_threshold"
RENAL_THRESHOLD: Final = "renal_threshold"

_PUBLISHED: Final = {constant.name: constant.value for constant in CONSTANTS}
NOMINAL: Final[dict[str, float]] = {**_PUBLISHED, ABSORPTION_RATE: 1.0 / _PUBLISHED[ABSORPTION_TIME]}
"""All constants that can vary, with the value of the nominal patient."""
MEANINGS: Final[dict[str, str]] = {
    **{constant.name: constant.meaning.partition(";")[0] for constant in CONSTANTS},
    ABSORPTION_RATE: "rate of insulin absorption",
}
"""Meaning of what can vary, in words."""


def refuse_impossible(varied: Mapping[str, Distribution]) -> None:
    """Refuse distributions that can make an impossible person.

    Raises
    ------
    ValueError
        If a constant can be 0 or less, the kidney could excrete glucose while the uptake without insulin is
        reduced for lack of it, or absorption of insulin is given both by its time and by its rate.
    """
    for name, distribution in varied.items():
        if not distribution.lower > 0.0:
            raise ValueError(
                f"{name} can vary from {distribution.lower:g} to {distribution.upper:g} but must stay above 0; "
                "narrow its spread, or give lower and upper"
            )
    if ABSORPTION_TIME in varied and ABSORPTION_RATE in varied:
        raise ValueError(f"{ABSORPTION_RATE} is 1 / {ABSORPTION_TIME}; vary one of the two")
    uptake, renal = (varied.get(name) for name in (UPTAKE_THRESHOLD, RENAL_THRESHOLD))
    most = NOMINAL[UPTAKE_THRESHOLD] if uptake is None else uptake.upper
    least = NOMINAL[RENAL_THRESHOLD] if renal is None else renal.lower
    if most > least:
        raise ValueError(
            f"{UPTAKE_THRESHOLD} can be {most:g} mmol/l and {RENAL_THRESHOLD} {least:g} mmol/l, but the first must not "
            "exceed the second; narrow their spreads"
        )


def with_values(values: Mapping[str, Any]) -> HovorkaParameters:
    """Constants of the person or people with these values, and nominal ones otherwise.

    Parameters
    ----------
    values : mapping
        Values by names in `NOMINAL`: floats or arrays ``(people,)``.

    Returns
    -------
    HovorkaParameters
        Constants, an array for each one that varies.
    """
    constants = dict(values)
    if ABSORPTION_RATE in constants:
        constants[ABSORPTION_TIME] = 1.0 / constants.pop(ABSORPTION_RATE)
    return dataclasses.replace(HOVORKA_2004, **constants)
