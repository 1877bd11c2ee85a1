"""Rows that are left out of a record, by reason, and notes on what was changed."""

from __future__ import annotations

from dataclasses import dataclass, field

import polars as pl


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
