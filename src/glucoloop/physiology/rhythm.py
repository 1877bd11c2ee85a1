"""Rhythms: what the clock changes in a person's constants, minute by minute.

A rhythm is a function of the clock, a seed and a person's number, computed before a run. The patient gets its values as
inputs that are held constant over each minute, so that any family takes any rhythm, and days may differ without end.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Final, Protocol, TypeAlias

from glucoloop._lazy_jax import np, npt
from glucoloop.component.base import Component
from glucoloop.component.catalogue import Catalogue
from glucoloop.threefry import checked_counter, checked_people

Floats: TypeAlias = "npt.NDArray[np.float64]"


@dataclass(frozen=True)
class Changes:
    """Changes by a rhythm at some times, ``(n, people)`` each; None for what it leaves as it is."""

    sensitivity: Floats | None = None
    """Factor on the constants that are a person's sensitivity to insulin."""
    production_mg_kg_min: Floats | None = None
    """Production of glucose by the liver that is added, per kilogram of body weight."""


class Rhythm(Protocol):
    """Something that follows the clock; hashable, and equal to another with the same settings."""

    def changes(self, clock_min: Floats, seed: int, person: npt.NDArray[np.int64]) -> Changes:
        """Changes of people at times ``(n,)`` in minutes after the midnight before the start of a run."""


class RhythmComponent(Component):
    """A rhythm, a `Rhythm` with its settings.

    It joins every command by one class, entered in `RHYTHMS` or by the entry point of another package in the group
    ``glucoloop.rhythms``.
    """

    kind: ClassVar = "rhythm"

    def changes(self, clock_min: Floats, seed: int, person: npt.NDArray[np.int64]) -> Changes:
        """Changes of people at times ``(n,)`` in minutes after the midnight before the start of a run.

        `person` are the numbers of the people, of which, with the seed, random numbers are made.
        """
        raise NotImplementedError


RHYTHMS: Final = Catalogue(
    RhythmComponent,
    {
        "visentin-2015": "glucoloop.physiology.visentin2015:Visentin2015",
        "dawn": "glucoloop.physiology.dawn:Dawn",
        "sensitivity": "glucoloop.physiology.sensitivity:Sensitivity",
    },
    example="visentin-2015, pattern=hhl",
)


def rhythm(text: str) -> RhythmComponent:
    """Rhythm by its text, as ``"visentin-2015, pattern=hhl"`` or ``"dawn"``; ValueError for one that is unknown.

    Examples
    --------
    >>> import glucoloop as gl
    >>> gl.rhythm("dawn, rise_mg_kg_min=1").rise_mg_kg_min
    1.0
    """
    return RHYTHMS.choose(text)


def changes_of(rhythms: Sequence[Rhythm], clock_min: Floats, seed: int, person: npt.ArrayLike) -> Changes:
    """Changes by several rhythms at once: factors are multiplied, and productions added.

    Raises
    ------
    ValueError
        For a seed or a person that does not exist.
    """
    checked_counter("seed", seed)
    people = checked_people(person)
    result = [rhythm.changes(clock_min, seed, people) for rhythm in rhythms]
    factors = [some.sensitivity for some in result if some.sensitivity is not None]
    added = [some.production_mg_kg_min for some in result if some.production_mg_kg_min is not None]
    return Changes(
        sensitivity=np.prod(factors, axis=0) if factors else None,
        production_mg_kg_min=np.sum(added, axis=0) if added else None,
    )
