"""Panels of a trial's page over people: control-variability grid, and distributions of metrics."""

from __future__ import annotations

import html
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from glucoloop.metrics.control_variability import (
    CELLS,
    MAXIMUM_EDGES_MG_DL,
    MAXIMUM_LIMITS_MG_DL,
    MINIMUM_EDGES_MG_DL,
    MINIMUM_LIMITS_MG_DL,
    region_pct,
)
from glucoloop.report._page import GREY, PALE, TRANSPARENT, numbers, plain_layout, tinted
from glucoloop.report._style import OKABE_ITO
from glucoloop.report.rows import NOT_AVAILABLE, described
from glucoloop.report.trial_report import CaseReport, TrialReport

ZONE_COLOURS: Final = {"A": "#009E73", "B": "#56B4E9", "C": "#F0E442", "D": "#E69F00", "E": "#D55E00"}

_GRID_PX: Final = 330
_ROW_PX: Final = 66
_LONGEST_NAME: Final = 24


@dataclass(frozen=True)
class Panel:
    """Data and layout of a plotly plot."""

    data: list[dict[str, Any]]
    layout: dict[str, Any]
    height_px: float


def colour(index: int) -> str:
    """Colour of a controller in all panels."""
    return OKABE_ITO[index % len(OKABE_ITO)]


def grid_panels(report: TrialReport) -> dict[str, Panel]:
    """The control-variability grid, by label."""
    most = max(float(np.max(case.cvga_counts)) for case in report.cases.values())
    return {
        label: Panel(_grid_people(case, colour(index), most), _grid_layout(case), _GRID_PX)
        for index, (label, case) in enumerate(report.cases.items())
    }


def _grid_people(case: CaseReport, of_case: str, most: float) -> list[dict[str, Any]]:
    # with the rising minimum to the left; only the part where people are is written
    counts = np.asarray(case.cvga_counts, float)
    columns, rows = (np.flatnonzero(counts.any(axis=axis)) for axis in (1, 0))
    first_column, first_row = (int(places[0]) if places.size else 0 for places in (columns, rows))
    counts = counts[first_column : columns[-1] + 1, first_row : rows[-1] + 1] if columns.size else counts[:1, :1]
    low, high = MINIMUM_EDGES_MG_DL[first_column:], MAXIMUM_EDGES_MG_DL[first_row:]
    said = [
        [
            f"minimum {low[c]:g} – {low[c + 1]:g} mg/dl<br>maximum {high[r]:g} – {high[r + 1]:g} mg/dl<br>"
            f"{counts[c, r]:,.0f} people"
            if counts[c, r]
            else ""
            for c in range(counts.shape[0])
        ]
        for r in range(counts.shape[1])
    ]
    with np.errstate(divide="ignore"):
        strength = np.log10(counts.T)
    return [
        {
            "type": "heatmap",
            "x0": first_column + 0.5,
            "dx": 1.0,
            "y0": first_row + 0.5,
            "dy": 1.0,
            "z": [numbers(line) for line in strength],
            "zmin": 0.0,
            "zmax": max(1.0, float(np.log10(max(most, 1.0)))),
            "text": said,
            "hovertemplate": "%{text}<extra></extra>",
            "hoverongaps": False,
            "colorscale": [[0.0, tinted(of_case, 0.3)], [1.0, of_case]],
            "showscale": False,
        }
    ]


def _grid_layout(case: CaseReport) -> dict[str, Any]:
    shapes, notes = [], []
    for place, (region, share) in enumerate(region_pct(case.cvga_counts).items()):
        column, row = CELLS * (place // 3), CELLS * (place % 3)
        shapes.append(
            {
                "type": "rect",
                "layer": "below",
                "x0": column,
                "x1": column + CELLS,
                "y0": row,
                "y1": row + CELLS,
                "line": {"color": GREY, "width": 0.8},
                "fillcolor": tinted(ZONE_COLOURS[region[-1]], 0.16),
            }
        )
        notes.append(
            {
                "x": column + CELLS - 1.0,
                "y": row + CELLS - 1.0,
                "xanchor": "left",
                "yanchor": "top",
                "text": f"<b>{region[-1]}</b>",
                "hovertext": f"{region[0].upper()}{region[1:]}: {percent(share)}",
                "showarrow": False,
            }
        )
    axis = {"showgrid": False, "zeroline": False, "fixedrange": True, "tickvals": [0, CELLS, 2 * CELLS, 3 * CELLS]}
    return plain_layout(
        margin={"l": 58, "r": 24, "t": 8, "b": 44},
        dragmode=False,
        shapes=shapes,
        annotations=notes,
        xaxis=axis
        | {
            "title": {"text": "Minimum (mg/dl)", "standoff": 6, "font": {"size": 13}},
            "range": [3 * CELLS, 0],
            "ticktext": _beyond(MINIMUM_LIMITS_MG_DL),
        },
        yaxis=axis
        | {
            "title": {"text": "Maximum (mg/dl)", "standoff": 0, "font": {"size": 13}},
            "range": [0, 3 * CELLS],
            "ticktext": _beyond(MAXIMUM_LIMITS_MG_DL),
        },
    )


def _beyond(limits: tuple[float, ...]) -> list[str]:
    """Labels of the grid's limits, whose outermost cells hold all values beyond."""
    return [f"≤ {limits[0]:g}", *(f"{limit:g}" for limit in limits[1:-1]), f"≥ {limits[-1]:g}"]


def percent(share: float) -> str:
    """Shortest text of a percentage that does not round a few to none."""
    if not np.isfinite(share):
        return NOT_AVAILABLE
    if 0.0 < share < 0.01:
        return "< 0.01 %"
    if 99.99 < share < 100.0:
        return "> 99.99 %"
    digits = 2 if 0.0 < share < 1.0 or 99.0 < share < 100.0 else 1
    return f"{share:.{digits}f} %" if share not in (0.0, 100.0) else f"{share:.0f} %"


def distribution_panels(report: TrialReport) -> dict[str, Panel]:
    """Distribution of each metric over the people, one row per controller, by the metric's name."""
    first = next(iter(report.cases.values()))
    return {metric: _distribution_panel(report, metric) for metric in first.metric_counts}


def _distribution_panel(report: TrialReport, metric: str) -> Panel:
    told = described(metric)
    of_all = [case.metric_counts[metric] for case in report.cases.values()]
    occupied = np.flatnonzero(np.sum([part.counts for part in of_all], axis=0))
    edges = np.asarray(of_all[0].edges, float) / told.divisor
    first, last = (int(occupied[0]), int(occupied[-1])) if occupied.size else (0, edges.size - 2)
    span = (float(edges[first]), float(edges[last + 1]))
    rows = len(of_all)
    data: list[dict[str, Any]] = []
    notes: list[dict[str, Any]] = []
    for index, (label, part) in enumerate(zip(report.cases, of_all, strict=True)):
        base = float(rows - 1 - index)
        of_case = colour(index)
        counts = np.asarray(part.counts, float)[first : last + 1]
        shares = 100.0 * counts / max(counts.sum(), 1.0)
        heights = base + 0.56 * np.sqrt(shares / max(float(shares.max()), 1e-300))
        line = {"type": "scatter", "mode": "lines", "hoverinfo": "skip"}
        steps = {"shape": "hv", "color": of_case, "width": 1.5}
        at = edges[first : last + 2]
        data += [
            line | {"x": [*span], "y": [base, base], "line": {"color": PALE, "width": 1}},
            line
            | {
                "x": numbers(at, 6),
                "y": numbers(np.append(heights, heights[-1:]), 4),
                "line": steps,
                "fill": "tonexty",
                "fillcolor": tinted(of_case, 0.25),
            },
            {
                "type": "scatter",
                "mode": "markers",
                "x": numbers((at[:-1] + at[1:]) / 2.0, 6),
                "y": numbers(heights, 4),
                "marker": {"color": TRANSPARENT, "size": 6},
                "customdata": [
                    [f"{low:.6g} – {high:.6g}", percent(share), f"{count:,.0f}"]
                    for low, high, share, count in zip(at[:-1], at[1:], shares, counts, strict=True)
                ],
                "hovertemplate": f"%{{customdata[0]}} {told.unit}: %{{customdata[1]}}, %{{customdata[2]}} people"
                f"<extra>{html.escape(label)}</extra>",
            },
            # 5 to 95 %, and the median
            line
            | {
                "x": numbers(np.array([part.p5, part.p95]) / told.divisor, 6),
                "y": [base, base],
                "line": {"color": of_case, "width": 4},
            },
            {
                "type": "scatter",
                "mode": "markers",
                "x": numbers([part.median / told.divisor], 6),
                "y": [base],
                "marker": {"color": of_case, "size": 9, "line": {"color": "white", "width": 1.5}},
                "hoverinfo": "skip",
            },
        ]
        words = {"y": base + 0.6, "yanchor": "bottom", "xref": "paper", "showarrow": False, "font": {"size": 12}}
        numbers_told = f"<b>{told.value(part.median)}</b>  ({told.value(part.p5)} – {told.value(part.p95)})"
        notes += [
            words | {"x": 0.0, "xanchor": "left", "text": _short(label)},
            words | {"x": 1.0, "xanchor": "right", "text": numbers_told},
        ]
    layout = plain_layout(
        margin={"l": 12, "r": 12, "t": 4, "b": 42},
        dragmode=False,
        hovermode="closest",
        showlegend=False,
        annotations=notes,
        xaxis={
            "range": [span[0] - 0.02 * (span[1] - span[0]), span[1] + 0.02 * (span[1] - span[0])],
            "gridcolor": PALE,
            "zeroline": False,
            "fixedrange": True,
            "nticks": 7,
            "title": {"text": told.unit, "standoff": 6, "font": {"size": 13}},
        },
        yaxis={"visible": False, "fixedrange": True, "range": [-0.1, rows]},
    )
    return Panel(data, layout, 46 + _ROW_PX * rows)


def _short(label: str) -> str:
    return html.escape(label if len(label) <= _LONGEST_NAME else label[: _LONGEST_NAME - 1] + "…")
