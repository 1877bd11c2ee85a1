"""Courses of simulated people from the folders of runs and trials, as readings that begin at 0 h."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import polars as pl

from glucoloop.metrics.readings.series import Readings
from glucoloop.refusal import Refusal
from glucoloop.storage.tables import refusing_damage

_OF_RUN: Final = "glucose_1min.parquet"
_OF_TRIAL: Final = "shards/*/traces.parquet"
_NAMES: Final = ("case", "controller", "person")


def simulated_courses(folder: Path) -> dict[str, Readings]:
    """Courses of a folder by name: of a run, of each case of a comparison, or of each person of a trial with traces."""
    places = [folder / _OF_RUN] if (folder / _OF_RUN).is_file() else sorted(folder.glob(_OF_TRIAL))
    if not places:
        raise Refusal(
            f"{folder} holds no course of glucose; give the folder of `glucoloop run`, `compare`, or `trial --traces`"
        )
    with refusing_damage(folder):
        table = pl.concat(pl.read_parquet(place) for place in places).with_columns(
            pl.col("t_min", "glucose_mg_dl").cast(pl.Float64)
        )
    names = [name for name in _NAMES if name in table.columns]
    parts = table.partition_by(names, as_dict=True, maintain_order=True) if names else {("the run",): table}
    return {
        " ".join(f"person {value}" if isinstance(value, int) else str(value) for value in name): Readings.of(
            part["t_min"].to_numpy(), part["glucose_mg_dl"].to_numpy()
        )
        for name, part in parts.items()
    }
