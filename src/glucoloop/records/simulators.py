"""CSV of the simulators simglucose and ReplayBG, which tell carbohydrate and insulin per minute of each sample.

simglucose writes Time, BG, CGM, CHO [g/min] and insulin [U/min], averages over each sample; data of ReplayBG are t,
glucose, cho [g/min], bolus and basal [U/min] of each sample, which is held over it.
"""

from __future__ import annotations

from typing import ClassVar, Final

import polars as pl

from glucoloop.records.answers import Answers
from glucoloop.records.extract import Extract, extract_frame
from glucoloop.records.file_text import FileText
from glucoloop.records.reader import TableReaderComponent
from glucoloop.records.times import TIME, times_of
from glucoloop.refusal import Refusal
from glucoloop.units import MIN_PER_H

_SIMGLUCOSE: Final = ("Time", "BG", "CGM", "CHO", "insulin")


class Simglucose(TableReaderComponent, name="simglucose"):
    """CSV of results of the simulator simglucose."""

    headers: ClassVar = (_SIMGLUCOSE,)

    def rows(self, content: FileText, answers: Answers) -> Extract:
        """Rows of a table of simglucose."""
        _, table = self.table(content)
        frame = table.frame.select(**{name: table.texts(table.column(name)) for name in _SIMGLUCOSE})
        times, notes = times_of(frame["Time"], answers)
        minutes = _sample_min(times["time"])
        notes += [
            f"Carbohydrate per min was made amounts of samples of {minutes:g} min.",
            "Basal rate and boluses are one rate in the file, which stands as the basal rate of each sample.",
        ]
        return Extract(
            frame=extract_frame(
                frame,
                times,
                table.spoilt,
                glucose=pl.col("CGM"),
                carbs=_amounts("CHO", minutes),
                basal=_amounts("insulin", MIN_PER_H),
                device=pl.lit("simulated"),
                kind=pl.lit("samples without a reading"),
            ),
            glucose_unit="mg/dl",
            largest_basal_U_h=100.0,
            notes=(*table.notes, *notes),
        )


_REPLAYBG: Final = ("t", "glucose", "cho", "bolus", "basal")


class ReplayBG(TableReaderComponent, name="replaybg"):
    """CSV of data of ReplayBG."""

    headers: ClassVar = (_REPLAYBG,)

    def rows(self, content: FileText, answers: Answers) -> Extract:
        """Rows of a table of ReplayBG."""
        _, table = self.table(content)
        names = {name.casefold(): name for name in table.frame.columns}
        frame = table.frame.select(**{name: table.texts(names[name]) for name in _REPLAYBG})
        times, notes = times_of(frame["t"], answers)
        minutes = _sample_min(times["time"])
        notes.append(f"Carbohydrate and boluses per min were made amounts of samples of {minutes:g} min.")
        return Extract(
            frame=extract_frame(
                frame,
                times,
                table.spoilt,
                glucose=pl.col("glucose"),
                carbs=_amounts("cho", minutes),
                bolus=_amounts("bolus", minutes),
                basal=_amounts("basal", MIN_PER_H),
                kind=pl.lit("samples without a reading"),
            ),
            glucose_unit="mg/dl",
            largest_basal_U_h=100.0,
            notes=(*table.notes, *notes),
        )


def _sample_min(times: pl.Series) -> float:
    """Time between two samples [min]; Refusal if there are fewer than two samples."""
    steps = times.drop_nulls().cast(TIME).sort().diff().drop_nulls().dt.total_seconds() / 60
    step = steps.filter(steps > 0).median()
    if step is None:
        raise Refusal("it has fewer than two samples, so its rates per minute cannot be made amounts; give more")
    return float(step)  # type: ignore[arg-type]


def _amounts(name: str, factor: float) -> pl.Expr:
    """Numbers of a column times a factor, as texts; what is no number is passed on, and told later."""
    number = pl.col(name).cast(pl.Float64, strict=False) * factor
    return pl.coalesce(number.cast(pl.String), pl.col(name))
