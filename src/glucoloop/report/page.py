"""Self-contained page of the closed loop: one file that needs no network and can be zoomed and shared."""

from __future__ import annotations

import html
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

import numpy as np

from glucoloop.metrics import LOWEST_GLUCOSE_MG_DL, Metrics
from glucoloop.pumps.limits import PARKER_1999_LIMITS, DoseLimits
from glucoloop.report import _page
from glucoloop.report._page import FOOTER as FOOTER
from glucoloop.report._page import GREY, PALE, numbers
from glucoloop.report._runs import Run, labelled_runs, limits_passed, values_in_words
from glucoloop.report._style import OKABE_ITO, time_axis
from glucoloop.report.rows import metric_rows
from glucoloop.simulation import Trace
from glucoloop.units import MG_DL_PER_MMOL_L, MIN_PER_H, MU_PER_U

_DASHES: Final = ("solid", "dash", "dot", "dashdot", "longdash")
_PX: Final = 620
_PX_PER_RUN: Final = 24  # for the legend, on a narrow screen
_MOST_LEVEL_TEXTS: Final = 6
_MOST_TEXTS: Final = 40
_GLUCOSE_HOVER: Final = "%{y:.1f} mg/dl, %{customdata:.2f} mmol/l"
_INSULIN_HOVER: Final = "%{y:.2f} mU/min, %{customdata:.2f} U/h"


def interactive_page(
    traces: Trace | Mapping[str, Trace],
    metrics: Metrics | Mapping[str, Metrics],
    *,
    title: str = "Closed loop",
    limits: DoseLimits = PARKER_1999_LIMITS,
    lowest_glucose_mg_dl: float = LOWEST_GLUCOSE_MG_DL,
) -> str:
    """One run, or several of the same scenario, as a self-contained HTML page.

    Glucose and insulin share their time axis, which zooms by dragging and by the slider below; pointing at a moment
    tells glucose in mg/dl and mmol/l and insulin in mU/min and U/h. The metrics stand below.

    Parameters
    ----------
    traces : Trace or mapping of str to Trace
        Traces of one person each.
    metrics : Metrics or mapping of str to Metrics
        Metrics of these runs, under the same labels.
    title : str
    limits : DoseLimits
        Limits of the pump.
    lowest_glucose_mg_dl : float
        The bound on glucose.

    Returns
    -------
    str
        HTML; labels and the title are shown as they are, whatever they hold.

    Raises
    ------
    ValueError
        If there is no trace, one is of many people, the meals differ, or the labels of the metrics differ from those of
        the traces.
    """
    runs = labelled_runs(traces)
    labels = [run.label for run in runs]
    single = isinstance(traces, Trace)
    by_label = {labels[0]: metrics} if isinstance(metrics, Metrics) else dict(metrics)
    if isinstance(metrics, Metrics) != single or list(by_label) != labels:
        raise ValueError(
            f"there are traces of {labels} but metrics of {list(by_label)}; give both under the same labels, in the "
            "same order"
        )
    plot = _plot(runs, limits, lowest_glucose_mg_dl)
    table = _table(by_label, ["Value"] if single else labels)
    notes = "".join(f"<p>{html.escape(note)}</p>\n" for note in _notes(runs, single=single))
    return _page.page(title, f'{plot}\n{notes}<div class="scroll">\n{table}\n</div>')


def _notes(runs: Sequence[Run], *, single: bool) -> Iterator[str]:
    for run in runs:
        if run.validity_note is not None:
            yield run.validity_note if single else f"{run.label}: {run.validity_note}"


def _plot(runs: Sequence[Run], limits: DoseLimits, lowest_mg_dl: float) -> str:
    horizon_min = max(run.horizon_min for run in runs)
    divisor, unit, _ = time_axis(horizon_min, "double")
    return _page.picture(
        [*_levels(runs, limits, lowest_mg_dl, horizon_min / divisor), *_curves(runs, divisor)],
        _layout(runs[0].meals, divisor, unit, horizon_min / divisor),
        name="runs",
        height_px=_PX + _PX_PER_RUN * len(runs),
        buttons=["toImage", "zoom2d", "pan2d", "resetScale2d"],
    )


def _curves(runs: Sequence[Run], divisor: float) -> list[dict[str, Any]]:
    """Readings, glucose and insulin of each run; a click in the legend hides all three."""
    curves: list[dict[str, Any]] = []
    for index, run in enumerate(runs):
        line = {"color": OKABE_ITO[index % len(OKABE_ITO)], "dash": _DASHES[index % len(_DASHES)], "width": 2}
        # escaped, since plotly takes a label for a kind of HTML
        name = html.escape(run.label)
        prefix = f"{name}, " if len(runs) > 1 else ""
        fine_t = numbers(run.fine_t_min / divisor)
        # On the fine grid: pointing anywhere then tells the rate of that moment, not of the nearest sample.
        held_since = np.searchsorted(run.t_min, run.fine_t_min + 1e-9, side="right") - 1
        insulin = run.insulin_mU_min[held_since]
        of_run: list[dict[str, Any]] = [
            {
                "name": name,
                "x": fine_t,
                "y": numbers(run.fine_glucose_mg_dl),
                "mode": "lines",
                "line": line,
                "customdata": numbers(run.fine_glucose_mg_dl / MG_DL_PER_MMOL_L),
                "hovertemplate": _GLUCOSE_HOVER,
            },
            {
                "name": f"{prefix}insulin",
                "x": fine_t,
                "y": numbers(insulin),
                "yaxis": "y2",
                "mode": "lines",
                "line": line | {"shape": "hv"},
                "showlegend": False,
                "customdata": numbers(insulin * MIN_PER_H / MU_PER_U),
                "hovertemplate": _INSULIN_HOVER,
            },
        ]
        if run.reading_t_min.size:
            of_run.append(
                {
                    "name": f"{prefix}reading",
                    "x": numbers(run.reading_t_min / divisor),
                    "y": numbers(run.reading_mg_dl),
                    "mode": "markers",
                    "marker": {"color": line["color"], "size": 4, "opacity": 0.5},
                    "showlegend": False,
                    "customdata": numbers(run.reading_mg_dl / MG_DL_PER_MMOL_L),
                    "hovertemplate": _GLUCOSE_HOVER,
                }
            )
        curves += [curve | {"type": "scatter", "legendgroup": f"run {index}"} for curve in of_run]
    return curves


def _levels(runs: Sequence[Run], limits: DoseLimits, lowest_mg_dl: float, end: float) -> list[dict[str, Any]]:
    """Setpoint, bound, basal rate and pump limits, drawn below the curves."""
    setpoints = list(dict.fromkeys(run.setpoint_mg_dl for run in runs))
    basal = list(dict.fromkeys(run.basal_insulin_mU_min for run in runs))
    bounds = [float(limits.min_mU_min), float(limits.max_mU_min)]
    passed = limits_passed(runs)
    kinds: list[tuple[str, list[float], str, str, str, bool | str]] = [
        ("setpoint", setpoints, "mg/dl", "y", "solid", True),
        ("lowest allowed", [lowest_mg_dl], "mg/dl", "y", "dash", True),
        *([("model not valid below", passed, "mg/dl", "y", "longdash", True)] if passed else []),
        ("basal", basal, "mU/min", "y2", "dot", True),
        # out of view unless asked for: seldom reached, they would squeeze the insulin
        ("pump limits", bounds, "mU/min", "y2", "dashdot", "legendonly"),
    ]
    return [
        {
            "type": "scatter",
            "mode": "lines",
            "name": f"{name} {values_in_words(values, unit)}",
            # a gap between one level and the next
            "x": [x for _ in values for x in (0.0, end, None)],
            "y": [y for value in values for y in (value, value, None)],
            "yaxis": axis,
            "line": {"color": GREY, "width": 1.5, "dash": dash},
            "visible": visible,
            "legendrank": 2000,
            "hoverinfo": "skip",
        }
        for name, values, unit, axis, dash, visible in kinds
    ]


def _layout(meals: Sequence[tuple[float, float]], divisor: float, unit: str, end: float) -> dict[str, Any]:
    grid = {"gridcolor": PALE, "zeroline": False, "linecolor": GREY}
    return _page.plain_layout() | {
        # the buttons stand in the right margin, where they cover neither legend nor curves
        "margin": {"l": 60, "r": 40, "t": 40, "b": 40},
        "hovermode": "x unified",
        "hoversubplots": "axis",
        "legend": {"orientation": "h", "x": 0.0, "y": 1.09, "yanchor": "bottom"},
        "xaxis": grid
        | {
            "title": {"text": f"Time ({unit})"},
            "anchor": "y2",
            "range": [0.0, end],
            "unifiedhovertitle": {"text": "%{x:.0f} min" if unit == "min" else "%{x:.2f} h"},
            "rangeslider": {
                "visible": True,
                "range": [0.0, end],
                "thickness": 0.08,
                "bordercolor": PALE,
                "borderwidth": 1,
            },
        },
        "yaxis": grid | {"title": {"text": "Glucose (mg/dl)"}, "domain": [0.4, 1.0]},
        "yaxis2": grid | {"title": {"text": "Insulin (mU/min)"}, "domain": [0.0, 0.34], "rangemode": "tozero"},
        "annotations": _meal_marks(meals, divisor),
    }


def _meal_marks(meals: Sequence[tuple[float, float]], divisor: float) -> list[dict[str, Any]]:
    """Carbohydrate of each meal above the panel, rotated for many meals; only the times for very many."""
    upright = len(meals) > _MOST_LEVEL_TEXTS
    return [
        {
            "x": t_min / divisor,
            "y": 1.0,
            "yref": "paper",
            "yanchor": "bottom",
            "text": "▼" if len(meals) > _MOST_TEXTS else f"◀ {carbs_g:.4g} g" if upright else f"{carbs_g:.4g} g<br>▼",
            "textangle": -90 if upright else 0,
            "showarrow": False,
        }
        for t_min, carbs_g in meals
    ]


def _table(metrics: Mapping[str, Metrics], heads: Sequence[str]) -> str:
    lines = ["<table>", "<thead><tr><th scope='col'>Metric</th>"]
    lines += [f"<th scope='col' class='value'>{html.escape(head)}</th>" for head in heads]
    lines.append("<th scope='col'>Unit</th></tr></thead>")
    section = None
    for row in metric_rows(metrics):
        if row.section != section:
            body = "" if section is None else "</tbody>"
            lines.append(f"{body}<tbody><tr><th scope='rowgroup' colspan='{len(heads) + 2}'>{row.section}</th></tr>")
            section = row.section
        cells = "".join(f"<td class='value'>{html.escape(value)}</td>" for value in row.values)
        lines.append(f"<tr><th scope='row'>{html.escape(row.name)}</th>{cells}<td>{html.escape(row.unit)}</td></tr>")
    lines.append("</tbody></table>")
    return "\n".join(lines)
