"""The printed numbers, with page and place in the paper."""

from __future__ import annotations

from dataclasses import dataclass

from glucoloop.papers.entries import ComparedEntry, PaperEntry, read_entries


@dataclass(frozen=True, kw_only=True)
class PrintedEntry(PaperEntry):
    """One printed number or statement."""

    page: int
    place: str
    readings: tuple[str, ...]
    """Names in `readings.READINGS` on which the reproduced number depends."""
    input_at: tuple[str, ...] = ()
    """Operating points at which the printed number is put in, so that it cannot but agree."""


PrintedRow = ComparedEntry[PrintedEntry]


def published() -> tuple[PrintedEntry, ...]:
    """All entries, in the order of the paper's tables."""
    return read_entries(__package__, "published.toml", PrintedEntry)
