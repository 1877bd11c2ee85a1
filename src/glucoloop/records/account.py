"""Rows that are left out of a record, by reason, and notes on what was changed."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

import polars as pl

from glucoloop.text import how_many

_VALUES: Final = ("glucose_mg_dl", "carbs_g", "bolus_U", "long_acting_U", "basal_U_h")
_ABOUT: Final = {"glucose_mg_dl": ("out_of_range",), "bolus_U": ("bolus_min", "bolus_type")}
"""Columns that tell more of a value."""


@dataclass
class Account:
    """Rows that were left out, by reason, and notes on what was changed."""

    files: int = 0
    rows: int = 0
    """Number of rows of the files."""
    left_out: dict[str, int] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)

    def without(self, frame: pl.DataFrame, gone: pl.Expr, reason: str) -> pl.DataFrame:
        """Rows without some; a row of the file of which none is left is counted as left out."""
        mask = frame.select(gone.fill_null(False)).to_series()
        if not mask.any():
            return frame
        lost, kept = frame.filter(mask).select("file", "row").unique(), frame.filter(~mask)
        lost = lost.join(kept.select("file", "row"), on=["file", "row"], how="anti")
        if lost.height:
            self.left_out[reason] = self.left_out.get(reason, 0) + lost.height
        return kept

    def without_value(self, frame: pl.DataFrame, gone: pl.Series, name: str, reason: str) -> pl.DataFrame:
        """Rows of which some have lost one value; those with no other one are left out, as rows of the reason."""
        if not gone.any():
            return frame
        bare = pl.all_horizontal(pl.col(other).is_null() for other in _VALUES if other != name)
        frame = frame.with_columns(_gone=gone)
        beside = frame.filter(pl.col("_gone") & ~bare).height
        if beside:
            self.notes.append(f"{how_many(beside, 'row')} lost a value and kept another one: {reason}.")
        frame = self.without(frame, pl.col("_gone") & bare, reason)
        names = (name, *_ABOUT.get(name, ()))
        return frame.with_columns(pl.when(~pl.col("_gone")).then(one).alias(one) for one in names).drop("_gone")
