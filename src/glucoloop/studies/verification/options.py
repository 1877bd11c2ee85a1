"""Keys of a campaign of random loops."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Annotated, Final

from glucoloop.config.key import Key
from glucoloop.config.options.situation import PatientKey
from glucoloop.control.catalogue import CONTROLLERS
from glucoloop.parts.patients import USUAL_PATIENT

CAMPAIGN_PANEL = "Campaign"
_ONE_OF: Final = f"One of {', '.join(CONTROLLERS)}, or one of another package, or module:attribute; repeat it for more."
_campaign = functools.partial(Key, panel=CAMPAIGN_PANEL)


@dataclass(frozen=True, kw_only=True)
class CampaignKeys:
    """Keys of a campaign."""

    loops: Annotated[
        int, _campaign("Smallest number of loops; each controller has as many with a guard as without.")
    ] = 100_000
    seed: Annotated[int, _campaign("The same seed gives the same loops.")] = 1
    controllers: Annotated[
        tuple[str, ...],
        _campaign(_ONE_OF, flag="--controller", told="all"),
    ] = tuple(CONTROLLERS)
    patient: PatientKey = USUAL_PATIENT.name
    person: Annotated[int | None, _campaign("Only the loops of this person, with their faults.")] = None
