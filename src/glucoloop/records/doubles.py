"""Doses and meals that two apps log: each counts once."""

from __future__ import annotations

from typing import Final

import polars as pl

from glucoloop.records.account import Account

TOGETHER_S: Final = 120.0
"""Longest time between the same amount in two apps."""

_AMOUNTS: Final = {
    "bolus_U": "boluses that another app has within 2 min",
    "long_acting_U": "doses of long-acting insulin that another app has within 2 min",
    "carbs_g": "carbohydrate that another app has within 2 min",
}


def source_of() -> pl.Expr:
    """Device or app of each row; the file itself where that does not tell it."""
    return pl.coalesce("source", pl.format("file {}", "file"))


def each_dose_once(frame: pl.DataFrame, account: Account) -> pl.DataFrame:
    """Rows in which an amount that a second app, or a second kind of entry, has too is left out.

    The same amount within two minutes from another source is the same dose; the same source may give it twice.
    """
    for name, words in _AMOUNTS.items():
        if frame.filter(pl.col(name).is_not_null()).height > 1:
            frame = account.without_value(frame, _repeated(frame, name), name, words)
    return frame


def _repeated(frame: pl.DataFrame, name: str) -> pl.Series:
    """Whether the amount of each row is that of an earlier row from another source."""
    own = frame.with_row_index("_place").filter(pl.col(name).is_not_null()).sort(name, "at", maintain_order=True)
    own = own.with_columns(source=source_of())
    amounts, sources = own[name].to_list(), own["source"].to_list()
    seconds = (own["at"].to_physical() / 1e6).to_list()
    counted: list[tuple[int, set[str]]] = []
    places: list[int] = []
    for row in range(own.height):
        same = [
            known
            for first, known in counted[-4:]
            if amounts[first] == amounts[row]
            and seconds[row] - seconds[first] <= TOGETHER_S
            and sources[row] not in known
        ]
        if same:
            same[-1].add(sources[row])
            places.append(own["_place"][row])
        else:
            counted.append((row, {sources[row]}))
    second = pl.Series(places, dtype=pl.UInt32)
    return frame.select(pl.int_range(pl.len(), dtype=pl.UInt32).is_in(second.implode())).to_series()
