"""Forecasts of the readings of records by several methods, on days that were held out."""

from __future__ import annotations

import functools
from typing import Annotated, ClassVar, Final

from glucoloop.component.setting import Option
from glucoloop.forecasts.method import METHODS, ForecastMethod
from glucoloop.refusal import Refusal
from glucoloop.studies.record_report import RecordRequest
from glucoloop.studies.study import PlainStudy

_forecast = functools.partial(Option, panel="Forecasts")
_SAMPLE_MIN: Final = 5


class ForecastRequest(RecordRequest):
    """Records, methods, and the days and horizons by which they are judged."""

    kind: ClassVar = "forecast"
    refused: ClassVar[tuple[str, ...]] = ("periods", "goals")

    methods: Annotated[
        tuple[ForecastMethod, ...],
        _forecast(
            "Method with its settings, like 'loop-like, fitted=true'; repeat it for more. The others are compared with "
            "the first one. `glucoloop list` has all.",
            flag="--method",
            default="every method",
        ),
    ] = tuple(map(METHODS.by_default, METHODS))
    horizons_min: Annotated[
        tuple[int, ...],
        _forecast(
            "Time from the forecast to the reading, a multiple of 5 min; repeat it for more. The day from midnight is "
            "always forecast too.",
            flag="--horizon",
            metavar="MIN",
            at_least=_SAMPLE_MIN,
            at_most=1440,
        ),
    ] = (30, 60, 120, 240)
    held_out_days: Annotated[
        int | None,
        _forecast(
            "Last days whose readings are forecast; the methods are fitted to those before.",
            at_least=1,
            at_most=60,
            default="a third of the days, at most 8",
        ),
    ] = None
    most_days: Annotated[
        int,
        _forecast("Days at most; of a longer record the last ones are used.", flag="--days", at_least=6, at_most=120),
    ] = 28

    def __post_init__(self) -> None:
        super().__post_init__()
        texts = [method.text for method in self.methods]
        if not self.methods:
            raise Refusal(f"no --method is given; give one of {', '.join(METHODS.names())}")
        if len(set(texts)) < len(texts):
            raise Refusal("a --method is given twice with the same settings; give each once")
        if len(set(self.horizons_min)) < len(self.horizons_min):
            raise Refusal("a --horizon is given twice; give each once")
        if not self.horizons_min:
            raise Refusal("no --horizon is given; give one, like 60")
        for horizon_min in self.horizons_min:
            if horizon_min % _SAMPLE_MIN:
                raise Refusal(f"--horizon is {horizon_min} min; give a multiple of {_SAMPLE_MIN} min, like 60")


FORECAST: Final = PlainStudy(
    name="forecast",
    what="forecasts",
    help=(
        "Forecast the readings of a sensor by several methods: 30, 60, 120 and 240 min ahead, and whole days from "
        "midnight. The last days are held out and forecast, once with the meals and the boluses of the user known, and "
        "once with nothing to come known.\n\n"
        "It says how large the errors are, for each person and over all, how many readings the bands of 90 % hold, and "
        "how the methods differ, with intervals. What automation doses is never known to a forecast: it follows "
        "glucose, which could be read off it.\n\n"
        "  glucoloop forecast export.csv --out forecasts\n\n"
        "  glucoloop forecast people --method kalman --method ridge --held-out-days 8 --out forecasts"
    ),
    module="glucoloop.studies.forecast.study",
    request=ForecastRequest,
    option_texts={
        "panel": {"labels": "Reading", "file_names": "Reading"},
        "help": {
            "files": "Records of a monitor with insulin and meals, in any format that can be read; tables of several "
            "people, or folders with a file or a folder for each person."
        },
    },
    files=("page.html", "people.csv", "pooled.csv", "differences.csv", "forecasts.parquet"),
    summary="forecast.json",
    unit="records",
)
