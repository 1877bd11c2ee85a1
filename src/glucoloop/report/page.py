"""The closed loop on a page of its own: one file that needs no network, to zoom into and to pass on."""

from __future__ import annotations

import html
from collections.abc import Mapping, Sequence
from string import Template
from typing import Any, Final

import numpy as np

from glucoloop.metrics import LOWEST_GLUCOSE_MG_DL, Metrics
from glucoloop.pumps.limits import PARKER_1999_LIMITS, DoseLimits
from glucoloop.report._runs import Floats, Run, labelled_runs, values_in_words
from glucoloop.report._style import OKABE_ITO, time_axis
from glucoloop.report.rows import metric_rows
from glucoloop.simulation import Trace
from glucoloop.units import MG_DL_PER_MMOL_L, MIN_PER_H, MU_PER_U

FOOTER: Final = "Research software, not a medical device."

_DASHES: Final = ("solid", "dash", "dot", "dashdot", "longdash")
_GREY: Final = "#808080"  # seen on white and on black
_PALE: Final = "rgba(128, 128, 128, 0.25)"
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
        Of one person each.
    metrics : Metrics or mapping of str to Metrics
        Of these runs, under the same labels.
    title : str
    limits : DoseLimits
        Of the pump.
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
    return _PAGE.substitute(
        title=html.escape(title),
        plot=_plot(runs, limits, lowest_glucose_mg_dl),
        table=_table(by_label, ["Value"] if single else labels),
        footer=FOOTER,
    )


def _plot(runs: Sequence[Run], limits: DoseLimits, lowest_mg_dl: float) -> str:
    import plotly.io

    horizon_min = max(run.horizon_min for run in runs)
    divisor, unit, _ = time_axis(horizon_min, "double")
    drawn: str = plotly.io.to_html(
        {
            "data": [*_levels(runs, limits, lowest_mg_dl, horizon_min / divisor), *_curves(runs, divisor)],
            "layout": _layout(runs[0].meals, divisor, unit, horizon_min / divisor),
        },
        config={
            "responsive": True,
            "displaylogo": False,
            # named one by one: plotly's own choice includes sending the data away
            "modeBarButtons": [["toImage", "zoom2d", "pan2d", "resetScale2d"]],
            "toImageButtonOptions": {"format": "svg", "filename": "glucoloop"},
        },
        include_plotlyjs=True,
        full_html=False,
        default_height=f"{_PX + _PX_PER_RUN * len(runs)}px",
        validate=False,  # an attribute that an older plotly does not know is passed over
        div_id="runs",
        post_script=_FOLLOW_THEME,
    )
    return drawn


def _numbers(values: Floats, digits: int = 3) -> list[float | None]:
    """For JSON, which knows no NaN."""
    return [round(value, digits) if np.isfinite(value) else None for value in values.tolist()]


def _curves(runs: Sequence[Run], divisor: float) -> list[dict[str, Any]]:
    """Readings, glucose and insulin of each run; a click in the legend hides all three."""
    curves: list[dict[str, Any]] = []
    for index, run in enumerate(runs):
        line = {"color": OKABE_ITO[index % len(OKABE_ITO)], "dash": _DASHES[index % len(_DASHES)], "width": 2}
        # escaped, since plotly takes a label for a kind of HTML
        name = html.escape(run.label)
        prefix = f"{name}, " if len(runs) > 1 else ""
        fine_t = _numbers(run.fine_t_min / divisor)
        # On the fine grid: pointing anywhere then tells the rate of that moment, not of the nearest sample.
        held_since = np.searchsorted(run.t_min, run.fine_t_min + 1e-9, side="right") - 1
        insulin = run.insulin_mU_min[held_since]
        of_run: list[dict[str, Any]] = [
            {
                "name": name,
                "x": fine_t,
                "y": _numbers(run.fine_glucose_mg_dl),
                "mode": "lines",
                "line": line,
                "customdata": _numbers(run.fine_glucose_mg_dl / MG_DL_PER_MMOL_L),
                "hovertemplate": _GLUCOSE_HOVER,
            },
            {
                "name": f"{prefix}insulin",
                "x": fine_t,
                "y": _numbers(insulin),
                "yaxis": "y2",
                "mode": "lines",
                "line": line | {"shape": "hv"},
                "showlegend": False,
                "customdata": _numbers(insulin * MIN_PER_H / MU_PER_U),
                "hovertemplate": _INSULIN_HOVER,
            },
        ]
        if run.reading_t_min.size:
            of_run.append(
                {
                    "name": f"{prefix}reading",
                    "x": _numbers(run.reading_t_min / divisor),
                    "y": _numbers(run.reading_mg_dl),
                    "mode": "markers",
                    "marker": {"color": line["color"], "size": 4, "opacity": 0.5},
                    "showlegend": False,
                    "customdata": _numbers(run.reading_mg_dl / MG_DL_PER_MMOL_L),
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
    kinds = [
        ("setpoint", setpoints, "mg/dl", "y", "solid", True),
        ("lowest allowed", [lowest_mg_dl], "mg/dl", "y", "dash", True),
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
            "line": {"color": _GREY, "width": 1.5, "dash": dash},
            "visible": visible,
            "legendrank": 2000,
            "hoverinfo": "skip",
        }
        for name, values, unit, axis, dash, visible in kinds
    ]


def _layout(meals: Sequence[tuple[float, float]], divisor: float, unit: str, end: float) -> dict[str, Any]:
    grid = {"gridcolor": _PALE, "zeroline": False, "linecolor": _GREY}
    return {
        "autosize": True,
        "margin": {"l": 60, "r": 40, "t": 40, "b": 40},
        "paper_bgcolor": "rgba(0, 0, 0, 0)",
        "plot_bgcolor": "rgba(0, 0, 0, 0)",
        "font": {"family": "system-ui, sans-serif", "size": 13, "color": _GREY},
        "hovermode": "x unified",
        "hoversubplots": "axis",
        # upright in the right margin, where it covers neither legend nor curves
        "modebar": {"orientation": "v", "bgcolor": "rgba(0, 0, 0, 0)", "color": _GREY, "activecolor": OKABE_ITO[0]},
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
                "bordercolor": _PALE,
                "borderwidth": 1,
            },
        },
        "yaxis": grid | {"title": {"text": "Glucose (mg/dl)"}, "domain": [0.4, 1.0]},
        "yaxis2": grid | {"title": {"text": "Insulin (mU/min)"}, "domain": [0.0, 0.34], "rangemode": "tozero"},
        "annotations": _meal_marks(meals, divisor),
    }


def _meal_marks(meals: Sequence[tuple[float, float]], divisor: float) -> list[dict[str, Any]]:
    """Carbohydrate above the panel; of many meals upright, and of very many only the moment."""
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


# Plotly draws in fixed colours; these follow the page's, which follow the reader's.
_FOLLOW_THEME: Final = """
const dark = window.matchMedia("(prefers-color-scheme: dark)");
const follow = () => {
  const style = getComputedStyle(document.body);
  Plotly.relayout("{plot_id}", {
    "font.color": style.color,
    "hoverlabel.bgcolor": style.backgroundColor,
    "hoverlabel.font.color": style.color
  });
};
follow();
dark.addEventListener("change", follow);
"""

_PAGE: Final = Template("""<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>$title</title>
<style>
:root { color-scheme: light dark; --ink: #222; --paper: #fff; --rule: rgba(128, 128, 128, 0.35); }
@media (prefers-color-scheme: dark) { :root { --ink: #ddd; --paper: #181818; } }
body { margin: 0 auto; padding: 1rem; max-width: 70rem; color: var(--ink); background: var(--paper);
       font: 1rem/1.45 system-ui, sans-serif; }
h1 { font-size: 1.4rem; font-weight: 600; margin: 0.5rem 0 1rem; overflow-wrap: anywhere; }
.scroll { overflow-x: auto; margin-top: 1.5rem; }
table { border-collapse: collapse; font-size: 0.9rem; font-variant-numeric: tabular-nums; }
th, td { padding: 0.2rem 0.9rem 0.2rem 0; text-align: left; font-weight: normal; vertical-align: bottom; }
thead th, th[scope=rowgroup] { font-weight: 600; }
thead th { border-bottom: 1px solid var(--rule); }
th[scope=rowgroup] { padding-top: 0.9rem; }
th[scope=row] { padding-left: 0.9rem; white-space: pre; }
.value { text-align: right; }
td.value { white-space: nowrap; }
footer { margin: 2rem 0 1rem; padding-top: 0.6rem; border-top: 1px solid var(--rule); font-size: 0.85rem; }
</style>
</head>
<body>
<h1>$title</h1>
<main>
$plot
<div class="scroll">
$table
</div>
</main>
<footer>$footer</footer>
</body>
</html>
""")
