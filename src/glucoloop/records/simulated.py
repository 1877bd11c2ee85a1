"""Rates of simulators, which tell carbohydrate and insulin per minute of each sample."""

from __future__ import annotations

import polars as pl

from glucoloop.records.times import TIME
from glucoloop.refusal import Refusal


def sample_min(times: pl.Series) -> float:
    """Time between two samples [min]; Refusal if there are fewer than two samples."""
    steps = times.drop_nulls().cast(TIME).sort().diff().drop_nulls().dt.total_seconds() / 60
    step = steps.filter(steps > 0).median()
    if step is None:
        raise Refusal("it has fewer than two samples, so its rates per minute cannot be made amounts; give more")
    return float(step)  # type: ignore[arg-type]


def amounts(name: str, factor: float) -> pl.Expr:
    """Numbers of a column times a factor, as texts; what is no number is passed on, and told later."""
    number = pl.col(name).cast(pl.Float64, strict=False) * factor
    return pl.coalesce(number.cast(pl.String), pl.col(name))
