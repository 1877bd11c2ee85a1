"""Self-contained page of a trial: one file that needs no network and can be shared."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from glucoloop.cohorts.bins import GLUCOSE_BIN_MG_DL, INSULIN_BIN_MU_MIN
from glucoloop.metrics import control_variability as cvga
from glucoloop.parts.faults import FAULTS
from glucoloop.parts.metrics import result_named
from glucoloop.printable import NOT_AVAILABLE, glucose_text, percent
from glucoloop.report._style import RANGE_COLOURS, ZONE_COLOURS
from glucoloop.report.charts import INSULIN, Panel, Plot, TimeAxis, colour, extent, nice_ticks, thinned
from glucoloop.report.columns import MetricRow
from glucoloop.report.page import glucose_panel, mark_faults
from glucoloop.report.template import render
from glucoloop.report.trial_report import RANGES, CaseReport, Floats, MetricDistribution, TrialReport, WorstPerson
from glucoloop.report.validity import concentrations
from glucoloop.units import MG_DL_PER_MMOL_L

BANDS: Final = ((0.05, 0.95), (0.25, 0.75))
"""Lower and upper quantile of each band."""
_BAND_TIMES: Final = 700
_WORST_TIMES: Final = 500
"""Largest number of times, over all controllers, at which bands and curves of people are drawn: a page stays small."""
_LEAST_TIMES: Final = 40
_MOST_WORST: Final = 60
"""Largest number of people whose curves are drawn, over all controllers, but for two of each."""
_SHADES: Final = 6
"""Number of shades of the control-variability grid, on a logarithmic scale."""
_OUTLINE: Final = (1000, 100)
"""Width and height of the outline of a distribution."""


def trial_page(report: TrialReport) -> str:
    """A trial as a self-contained HTML page.

    The people who had low glucose; the headline numbers of each controller; percentiles of glucose and insulin over
    time on axes that all controllers share and that zoom together; how the metrics are spread over the people; the time
    in each range of glucose; the control-variability grid; the people with the worst outcomes, with their traces; and
    the situation.

    Returns
    -------
    str
        HTML; labels and the title are shown as they are, whatever they hold.
    """
    cases = list(report.cases.values())
    most = max(float(np.max(case.cvga_counts)) for case in cases)
    band_times, worst_times = (max(_LEAST_TIMES, times // len(cases)) for times in (_BAND_TIMES, _WORST_TIMES))
    shown = max(2, _MOST_WORST // len(cases))
    people = [person for case in cases for person in case.worst[:shown]]
    return render(
        Path(__file__).with_name("templates") / "trial.html",
        report.title,
        script=True,
        report=report,
        time=TimeAxis(report.horizon_min),
        limits=sorted({limit for case in cases for limit in case.ever_below}, reverse=True),
        headlines=_headlines(cases),
        bin_text=f"{GLUCOSE_BIN_MG_DL:g} mg/dl or {INSULIN_BIN_MU_MIN:g} mU/min",
        responses=_responses(report, band_times),
        response_thinned=any(len(case.bands_t_min) > band_times for case in cases),
        distributions=[_distribution(report, metric) for metric in cases[0].metric_counts],
        ranges={name: _in_mmol_l(name) for name in RANGES},
        range_colours=RANGE_COLOURS,
        grids=[_grid(case, most) for case in cases],
        zone_colours=ZONE_COLOURS,
        worst=_worst(report, people, shown, worst_times),
        worst_people=min(shown, max(len(case.worst) for case in cases)),
        worst_people_each=shown,
        worst_thinned=any(len(one.insulin_t_min) > worst_times for one in people),
    )


def _headlines(cases: Sequence[CaseReport]) -> list[MetricRow]:
    rows = []
    for name in cases[0].table:
        text, opening, unit = name.rpartition(" (")
        text, unit = (text, unit[:-1]) if opening and unit.endswith(")") else (name, "")
        values = [case.table[name] for case in cases]
        in_mmol_l = [value if isinstance(value, str) else value / MG_DL_PER_MMOL_L for value in values]
        rows.append(
            MetricRow(
                "", text, unit, list(map(_text, values)), list(map(_text, in_mmol_l)) if unit == "mg/dl" else None
            )
        )
    return rows


def _text(value: float | str) -> str:
    if isinstance(value, str):
        return value
    if not math.isfinite(value):
        return NOT_AVAILABLE
    if value == int(value):
        return f"{int(value)}"
    # as many digits as tell it: two beyond the point below ten, one above
    return f"{value:.{1 if abs(value) >= 10.0 else 2 if abs(value) >= 0.01 else 4}f}"


def _in_mmol_l(name: str) -> str:
    """Name of a range, with its limits in mmol/l."""
    parts = name.split()
    return " ".join(f"{float(word) / MG_DL_PER_MMOL_L:.1f}" if word.isdigit() else word for word in parts)


def _panels(report: TrialReport, glucose: list[Floats], insulin: list[Floats], alts: tuple[str, str]) -> list[Panel]:
    """Empty panels of glucose and insulin, the same for all controllers."""
    time = TimeAxis(report.horizon_min)
    marks = [(t_min, f"{carbs_g:.4g} g") for t_min, carbs_g in report.meals if t_min < time.end_min]
    levels = [report.setpoint_mg_dl], report.lowest_glucose_mg_dl
    panels = [
        glucose_panel(time, *levels, glucose, rem=13.0, alt=alts[0], marks=marks),
        Panel(INSULIN, time, 0.0, 1.05 * extent([0.0], *insulin)[1], rem=7.0, alt=alts[1]),
    ]
    mark_faults(panels, map(FAULTS.choose, report.faults))
    return panels


def _responses(report: TrialReport, most: int) -> list[Plot]:
    """Bands of each controller, at not many more times than `most`."""
    cases = report.cases.values()
    glucose = [case.glucose_quantiles[quantile] for case in cases for quantile in BANDS[0]]
    insulin = [case.insulin_quantiles[BANDS[0][1]] for case in cases]
    plots = []
    for index, (label, case) in enumerate(report.cases.items()):
        courses = ", ".join(
            _course(name, case.glucose_quantiles[quantile], case.bands_t_min, "mg/dl")
            for quantile, name in ((0.05, "5th percentile"), (0.5, "median"), (0.95, "95th percentile"))
        )
        doses = _course("median", case.insulin_quantiles[0.5], case.insulin_t_min, "mU/min")
        alts = f"Glucose under {label}: {courses}", f"Insulin under {label}: {doses}"
        panels = _panels(report, glucose, insulin, alts)
        # each rate is held until the next, the last until the end
        for panel, t_min, quantiles, held in (
            (panels[0], case.bands_t_min, case.glucose_quantiles, False),
            (panels[1], np.append(case.insulin_t_min, case.bands_t_min[-1]), case.insulin_quantiles, True),
        ):
            drawn = np.unique(np.append(np.arange(0, len(t_min), -(-len(t_min) // most)), len(t_min) - 1))
            t = t_min[drawn]
            shown = {q: np.append(values, values[-1:])[drawn] for q, values in quantiles.items()}
            for low, high in BANDS:
                name = f"{100 * (high - low):.0f} % of the people"
                panel.band(t, shown[low], shown[high], f"band {colour(index)}", name, held=held)
            (panel.steps if held else panel.line)(t, shown[0.5], colour(index), name="median")
        plots.append(Plot(label, panels))
    return plots


def _course(name: str, quantiles: Floats, t_min: Floats, unit: str) -> str:
    if not np.isfinite(quantiles).any():
        return f"{name} not known"
    least, most = int(np.nanargmin(quantiles)), int(np.nanargmax(quantiles))
    return (
        f"{name} least {quantiles[least]:.1f} {unit} at {t_min[least]:g} min, greatest {quantiles[most]:.1f} at "
        f"{t_min[most]:g} min"
    )


def _worst(report: TrialReport, people: Sequence[WorstPerson], shown: int, most: int) -> list[Plot]:
    """Courses of the people with the worst outcomes under each controller."""
    glucose, insulin = [concentrations(p.glucose_mg_dl) for p in people], [p.insulin_mU_min for p in people]
    plots = []
    for index, (label, case) in enumerate(report.cases.items()):
        worst = case.worst[:shown]
        least = ", ".join(f"person {one.person} {glucose_text(one.minimum_mg_dl)} mg/dl" for one in worst)
        alts = f"Glucose under {label} of the worst: least {least}", f"Insulin under {label}"
        above, below = panels = _panels(report, glucose, insulin, alts)
        for one in worst:
            kind = f"thin {colour(index)}"
            named: dict[str, Any] = {"name": f"person {one.person}", "person": one.person}
            above.line(*thinned(one.t_min, concentrations(one.glucose_mg_dl), most), kind, **named)
            drawn = slice(None, None, -(-len(one.insulin_t_min) // most))
            rate = one.insulin_mU_min[drawn]
            below.steps(np.append(one.insulin_t_min[drawn], one.t_min[-1]), np.append(rate, rate[-1:]), kind, **named)
        plots.append(Plot(label, panels))
    return plots


def _grid(case: CaseReport, most: float) -> dict[str, Any]:
    """Content of the macro ``grid`` for a controller; `most` people in a cell have the strongest colour."""
    side, counts = 3 * cvga.CELLS, np.asarray(case.cvga_counts, float)
    rank = np.minimum(np.log(np.maximum(counts, 1.0)) / np.log(max(most, 2.0)) * _SHADES, _SHADES - 1).astype(int)
    people = []
    for shade in range(_SHADES):
        # the least glucose rises to the left, the greatest upwards
        cells = [(side - 1 - c, side - 1 - r) for c, r in np.argwhere((counts > 0) & (rank == shade)).tolist()]
        if cells:
            path = "".join(f"M{x} {y}h1v1h-1z" for x, y in cells)
            people.append((f"{0.3 + 0.7 * shade / (_SHADES - 1):.2f}", path))
    return {
        "people": people,
        "zones": [
            (side - cvga.CELLS * (place // 3 + 1), side - cvga.CELLS * (place % 3 + 1), region[-1])
            for place, region in enumerate(cvga.region_pct(case.cvga_counts))
        ],
        "shares": {zone: percent(share) for zone, share in cvga.zone_pct(case.cvga_counts).items()},
        "limits": (cvga.MINIMUM_LIMITS_MG_DL, cvga.MAXIMUM_LIMITS_MG_DL),
        "side": side,
        "cells": cvga.CELLS,
    }


def _distribution(report: TrialReport, metric: str) -> dict[str, Any]:
    """Content of the macro ``distribution``: outlines of a metric under all controllers, on one axis."""
    result, cases = result_named(metric), {label: case.metric_counts[metric] for label, case in report.cases.items()}
    occupied = np.flatnonzero(np.sum([part.counts for part in cases.values()], axis=0))
    edges = np.asarray(next(iter(cases.values())).edges, float) / result.divisor
    first, last = (int(occupied[0]), int(occupied[-1])) if occupied.size else (0, edges.size - 2)
    shown = edges[first : last + 2]
    alike = first == last and all(result.text(part.p5) == result.text(part.p95) for part in cases.values())
    zero = all(map(_all_zero, cases.values()))
    ticks = [] if zero or alike else nice_ticks(float(shown[0]), float(shown[-1]), 5)
    width, height = _OUTLINE
    outlines = {}
    for label, part in cases.items():
        counts, note, path, places = np.asarray(part.counts, float)[first : last + 1], "", "", None
        if _all_zero(part):
            note = "0 for everybody"
        elif counts.any() and alike:
            note = "the same for everybody"
        elif counts.any():
            x = np.rint(width * (shown - shown[0]) / (shown[-1] - shown[0])).astype(int)
            y = np.rint(height * (1.0 - 0.95 * np.sqrt(counts / counts.max()))).astype(int)
            steps = "".join(f"V{up}H{right}" for up, right in zip(y.tolist(), x[1:].tolist(), strict=True))
            path = f"M0 {height}{steps}V{height}z"
            values = np.array([part.p5, part.median, part.p95]) / result.divisor
            places = np.rint(np.interp(values, shown, x)).astype(int)
        outlines[label] = {"part": part, "words": note, "path": path, "places": places}
    return {
        "result": result,
        "outlines": outlines,
        "size": _OUTLINE,
        "unit": "" if zero else result.unit,
        "ticks": [(f"{100.0 * (tick - shown[0]) / (shown[-1] - shown[0]):.4g}", f"{tick:g}") for tick in ticks],
    }


def _all_zero(part: MetricDistribution) -> bool:
    """Whether the metric is 0 for everybody: all are in the bin of 0, and so is what 95 % stay below."""
    occupied = np.flatnonzero(np.asarray(part.counts))
    if occupied.size != 1 or part.p5 != 0.0 or part.p95 != 0.0:
        return False
    low, high = np.asarray(part.edges, float)[occupied[0] : occupied[0] + 2]
    return bool(low <= 0.0 <= high)
