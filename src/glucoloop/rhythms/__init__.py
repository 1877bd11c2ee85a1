"""Rhythms: sensitivity to insulin and production of glucose that follow the time of day and differ from day to day."""

from __future__ import annotations

from typing import TYPE_CHECKING

from glucoloop.rhythms.catalogue import RHYTHMS

if TYPE_CHECKING:
    from glucoloop.rhythms.protocol import Rhythm


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
