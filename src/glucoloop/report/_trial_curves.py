"""Panels of a trial's page over time: response bands, and the people who fared worst."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from glucoloop.report._page import GREY, PALE, numbers, plain_layout, tinted
from glucoloop.report._style import time_axis
from glucoloop.report._trial_panels import Panel, colour
from glucoloop.report.trial_report import CaseReport, Floats, TrialReport

BANDS: Final = ((0.01, 0.99, 0.13), (0.05, 0.95, 0.22), (0.25, 0.75, 0.36))
"""Lower and upper quantile of each band, and its opacity."""

_MOST_POINTS: Final = 500  # of a curve; more would hardly be seen
_TIME_PX: Final = 370
_INSULIN_TOP: Final = 0.34  # of the height


@dataclass(frozen=True)
class TimeFrame:
    """Axes that all controllers share, so that they can be compared."""

    divisor: float
    unit: str
    tick: float
    end: float
    glucose: tuple[float, float]
    insulin: tuple[float, float]


def shared_frame(report: TrialReport) -> TimeFrame:
    """Axes that the bands of all controllers fit into."""
    cases = report.cases.values()
    return _frame(
        report,
        [case.glucose_quantiles[quantile] for case in cases for quantile in (0.01, 0.99)],
        [case.insulin_quantiles[0.99] for case in cases],
    )


def _frame(report: TrialReport, glucose: list[Floats], insulin: list[Floats]) -> TimeFrame:
    divisor, unit, tick = time_axis(report.horizon_min, "single")
    levels = np.array([report.setpoint_mg_dl, report.lowest_glucose_mg_dl])
    low, high = _extent([levels, *glucose])
    return TimeFrame(
        divisor=divisor,
        unit=unit,
        tick=tick,
        end=report.horizon_min / divisor,
        glucose=(low - 0.05 * (high - low), high + 0.05 * (high - low)),
        insulin=(0.0, 1.05 * _extent([np.array([0.0, 1.0]), *insulin])[1]),
    )


def _extent(shown: list[Floats]) -> tuple[float, float]:
    values = np.concatenate([np.asarray(part, float) for part in shown])
    values = values[np.isfinite(values)]
    return float(values.min()), float(values.max())


def _thin(size: int) -> slice:
    return slice(None, None, -(-size // _MOST_POINTS))


def _times(t_min: Floats, divisor: float) -> dict[str, Any]:
    """Times for plotly: a first time and a distance for evenly spaced points, otherwise all times."""
    times = np.asarray(t_min, float) / divisor
    apart = np.diff(times)
    if apart.size and np.allclose(apart, apart[0], rtol=1e-9, atol=0.0):
        return {"x0": float(times[0]), "dx": float(apart.mean())}
    return {"x": numbers(times)}


def _levels(report: TrialReport, frame: TimeFrame) -> list[dict[str, Any]]:
    return [
        {
            "type": "scatter",
            "mode": "lines",
            "x": [0.0, frame.end],
            "y": [level, level],
            "line": {"color": GREY, "width": 1.2, "dash": dash},
            "hoverinfo": "skip",
        }
        for level, dash in ((report.setpoint_mg_dl, "solid"), (report.lowest_glucose_mg_dl, "dash"))
    ]


def _time_layout(frame: TimeFrame, hovermode: str) -> dict[str, Any]:
    grid = {"gridcolor": PALE, "zeroline": False, "linecolor": GREY}
    above = {"xref": "paper", "yref": "paper", "x": 0.0, "xanchor": "left", "yanchor": "bottom", "showarrow": False}
    return plain_layout(
        # the buttons stand in the right margin
        margin={"l": 40, "r": 34, "t": 24, "b": 44},
        showlegend=False,
        hovermode=hovermode,
        hoversubplots="axis",
        annotations=[
            above | {"y": 1.0, "text": "Glucose (mg/dl)"},
            above | {"y": _INSULIN_TOP, "text": "Insulin (mU/min)"},
        ],
        xaxis=grid
        | {
            "title": {"text": f"Time ({frame.unit})", "standoff": 6, "font": {"size": 13}},
            "anchor": "y2",
            "range": [0.0, frame.end],
            "dtick": frame.tick,
            "unifiedhovertitle": {"text": "%{x:.0f} min" if frame.unit == "min" else "%{x:.2f} h"},
        },
        yaxis=grid | {"domain": [_INSULIN_TOP + 0.1, 1.0], "range": list(frame.glucose), "nticks": 6},
        yaxis2=grid | {"domain": [0.0, _INSULIN_TOP], "range": list(frame.insulin), "nticks": 5},
    )


def band_panels(report: TrialReport) -> dict[str, Panel]:
    """Quantiles of glucose and of insulin over time, by label."""
    frame = shared_frame(report)
    return {
        label: Panel(
            [*_bands(case, frame, colour(index)), *_levels(report, frame)], _time_layout(frame, "x unified"), _TIME_PX
        )
        for index, (label, case) in enumerate(report.cases.items())
    }


def _bands(case: CaseReport, frame: TimeFrame, of_case: str) -> list[dict[str, Any]]:
    # each rate is held until the next, the last until the end
    insulin = {quantile: np.append(values, values[-1:]) for quantile, values in case.insulin_quantiles.items()}
    insulin_t = np.append(case.insulin_t_min, case.bands_t_min[-1])
    curves: list[dict[str, Any]] = []
    for t_min, quantiles, axis, shape, digits, unit in (
        (case.bands_t_min, case.glucose_quantiles, "y", "linear", 1, "mg/dl"),
        (insulin_t, insulin, "y2", "hv", 2, "mU/min"),
    ):
        thin = _thin(len(t_min))
        of_all = {"type": "scatter", "mode": "lines", "yaxis": axis} | _times(t_min[thin], frame.divisor)
        shown = {quantile: numbers(np.asarray(values)[thin], digits) for quantile, values in quantiles.items()}
        for low, high, opacity in BANDS:
            edge = {"line": {"width": 0, "shape": shape}, "hoverinfo": "skip"}
            fill = {"fill": "tonexty", "fillcolor": tinted(of_case, opacity)}
            curves += [of_all | edge | {"y": shown[low]}, of_all | edge | fill | {"y": shown[high]}]
        curves.append(
            of_all
            | {
                "y": shown[0.5],
                "line": {"color": of_case, "width": 2, "shape": shape},
                "customdata": list(zip(*(shown[edge] for low, high, _ in BANDS for edge in (low, high)), strict=True)),
                "hovertemplate": f"<b>%{{y}}</b> {unit}<br>50 %: %{{customdata[4]}} – %{{customdata[5]}}"
                "<br>90 %: %{customdata[2]} – %{customdata[3]}<br>98 %: %{customdata[0]} – %{customdata[1]}"
                "<extra></extra>",
            }
        )
    return curves


def worst_panels(report: TrialReport) -> dict[str, Panel]:
    """Glucose and insulin of the people with the worst outcomes, by label; two curves per person, in their order."""
    people = [person for case in report.cases.values() for person in case.worst]
    frame = _frame(report, [p.glucose_mg_dl for p in people], [p.insulin_mU_min for p in people])
    panels = {}
    for index, (label, case) in enumerate(report.cases.items()):
        curves: list[dict[str, Any]] = []
        for place, person in enumerate(case.worst):
            line = {"color": tinted(colour(index), max(0.35, 1.0 - 0.08 * place)), "width": 1.5}
            insulin_t = np.append(person.insulin_t_min, person.t_min[-1:])
            insulin = np.append(person.insulin_mU_min, person.insulin_mU_min[-1:])
            for t_min, values, axis, shape, digits, unit in (
                (person.t_min, person.glucose_mg_dl, "y", "linear", 1, "mg/dl"),
                (insulin_t, insulin, "y2", "hv", 2, "mU/min"),
            ):
                thin = _thin(len(t_min))
                curves.append(
                    {
                        "type": "scatter",
                        "mode": "lines",
                        "y": numbers(np.asarray(values)[thin], digits),
                        "yaxis": axis,
                        "line": line | {"shape": shape},
                        "hovertemplate": f"person {person.person}: %{{y}} {unit} at %{{x:.4g}} {frame.unit}"
                        "<extra></extra>",
                    }
                    | _times(t_min[thin], frame.divisor)
                )
        panels[label] = Panel([*curves, *_levels(report, frame)], _time_layout(frame, "closest"), _TIME_PX)
    return panels


def thinned(report: TrialReport) -> bool:
    """Whether curves have more points than are drawn."""
    return any(len(case.bands_t_min) > _MOST_POINTS for case in report.cases.values())
