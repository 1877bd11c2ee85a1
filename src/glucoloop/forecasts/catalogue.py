"""Methods of forecasting by name."""

from __future__ import annotations

from typing import Final

from glucoloop.component.catalogue import Catalogue
from glucoloop.forecasts.method import ForecastMethod

METHODS: Final = Catalogue(
    ForecastMethod,
    {
        "kalman": "glucoloop.forecasts.kalman:Kalman",
        "twin": "glucoloop.twins.forecast:TwinForecast",
        "ridge": "glucoloop.forecasts.ridge:Ridge",
        "loop-like": "glucoloop.forecasts.loop_like:LoopLikeForecast",
        "time-of-day": "glucoloop.forecasts.reference:TimeOfDay",
        "mean": "glucoloop.forecasts.reference:Mean",
        "persistence": "glucoloop.forecasts.reference:Persistence",
    },
    example="ridge, penalty=.01",
)
"""Methods by name, the one that the others are compared with first."""
