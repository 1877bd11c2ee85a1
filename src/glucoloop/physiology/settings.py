"""Rhythms of a person: name and settings of each, and the place of its class.

A rhythm joins every command by one class, entered in `RHYTHMS` or by the entry point of another package in the group
``glucoloop.physiology``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, ClassVar, Final, Literal

from glucoloop.component.base import MadeComponent
from glucoloop.component.catalogue import Catalogue
from glucoloop.component.setting import About
from glucoloop.refusal import Refusal
from glucoloop.units import MIN_PER_DAY

if TYPE_CHECKING:
    from glucoloop.physiology.protocol import Rhythm


class RhythmComponent(MadeComponent):
    """Declaration of a rhythm, a `physiology.protocol.Rhythm`."""

    kind: ClassVar = "rhythm"


class Visentin2015Settings(RhythmComponent, name="visentin-2015"):
    """Sensitivity to insulin in one of seven patterns over the day, of Visentin et al. (2015), and daily noise."""

    sources = ("visentin2015",)
    make: ClassVar = "glucoloop.physiology.visentin2015:Visentin2015"
    pattern: Annotated[
        Literal["drawn", "hhh", "hhl", "hlh", "hll", "lhh", "lhl", "llh"],
        About(
            "Sensitivity in the morning, the afternoon and the evening, high or low; drawn: by the published "
            "probabilities for each person."
        ),
    ] = "drawn"
    day_spread_pct: Annotated[
        float,
        About("Standard deviation of sensitivity from day to day, drawn for each period.", at_least=0.0, at_most=30.0),
    ] = 20.0


class DawnSettings(RhythmComponent, name="dawn"):
    """Production of glucose by the liver that rises before dawn, of Mallad et al. (2015)."""

    sources = ("mallad2015", "visentin2018")
    make: ClassVar = "glucoloop.physiology.dawn:Dawn"
    rise_mg_kg_min: Annotated[float, About("Rise of production at its end, in mg/kg/min.", above=0.0, at_most=10.0)] = (
        1.5
    )
    from_min: Annotated[float, About("Time of day at which it begins to rise.", at_least=0.0, below=MIN_PER_DAY)] = (
        180.0
    )
    to_min: Annotated[float, About("Time of day at which it stops rising.", above=0.0, below=MIN_PER_DAY)] = 420.0
    fall_min: Annotated[float, About("Time in which it falls back afterwards.", at_least=1.0, at_most=720.0)] = 120.0

    def __post_init__(self) -> None:
        if not self.from_min < self.to_min or not self.to_min + self.fall_min <= MIN_PER_DAY:
            raise Refusal(
                f"a dawn from {self.from_min:g} to {self.to_min:g} min that falls for {self.fall_min:g} min is not "
                f"possible; give times in their order, of which the last is at most {MIN_PER_DAY:g} min"
            )


RHYTHMS: Final = Catalogue(
    RhythmComponent,
    {
        "visentin-2015": "glucoloop.physiology.settings:Visentin2015Settings",
        "dawn": "glucoloop.physiology.settings:DawnSettings",
    },
    example="visentin-2015, pattern=hhl",
)


def rhythm(text: str) -> Rhythm:
    """Rhythm by its text, as ``"visentin-2015, pattern=hhl"`` or ``"dawn"``; ValueError for one that is unknown.

    Examples
    --------
    >>> import glucoloop as gl
    >>> gl.rhythm("dawn, rise_mg_kg_min=1").rise_mg_kg_min
    1.0
    """
    made: Rhythm = RHYTHMS.choose(text).made()
    return made
