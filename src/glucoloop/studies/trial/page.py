"""Self-contained page of a trial: one file that needs no network and can be shared."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from glucoloop.display_units import OTHERS, other_value, shown_unit
from glucoloop.faults import FAULTS
from glucoloop.metrics import control_variability as cvga
from glucoloop.metrics.metric import result_named
from glucoloop.reporting._style import RANGE_COLOURS, ZONE_COLOURS
from glucoloop.reporting.charts import INSULIN, TIME_IN_RANGE, Panel, Plot, extent, thinned
from glucoloop.reporting.columns import MetricRow
from glucoloop.reporting.labelled_traces import concentrations, exercise_in_words
from glucoloop.reporting.page import glucose_panel, mark_faults
from glucoloop.reporting.template import render
from glucoloop.studies.trial.report import RANGES, CaseReport, Floats, MetricDistribution, TrialReport, WorstPerson
from glucoloop.text import NOT_AVAILABLE, percent
from glucoloop.trials.statistics import FEWEST_DIFFERENT, GLUCOSE_BIN_MG_DL, INSULIN_BIN_MU_MIN
from glucoloop.units import MIN_PER_WEEK

BANDS: Final = ((0.05, 0.95), (0.25, 0.75))
"""Lower and upper quantile of each band."""
_BAND_TIMES: Final = 700
_WORST_TIMES: Final = 500
"""Largest number of times, over all controllers, at which bands and curves of people are drawn: a page stays small."""
_MIN_TIMES: Final = 40
_MAX_WORST: Final = 60
"""Largest number of people whose curves are drawn, over all controllers, but for two of each."""


def trial_page(report: TrialReport) -> str:
    """A trial as a self-contained HTML page.

    The people who had low glucose; the headline numbers of each controller; percentiles of glucose and insulin over
    time on axes that all controllers share and that zoom together, and of a long run by week; how the metrics are
    spread over the people; the time in each range of glucose; the control-variability grid; the people with the worst
    outcomes, with their traces; and the situation.

    Returns
    -------
    str
        HTML; labels and the title are shown as they are, whatever they hold.
    """
    cases = list(report.cases.values())
    most = max(float(np.max(case.cvga_counts)) for case in cases)
    band_times, worst_times = (max(_MIN_TIMES, times // len(cases)) for times in (_BAND_TIMES, _WORST_TIMES))
    shown = max(2, _MAX_WORST // len(cases))
    people = [person for case in cases for person in case.worst[:shown]]
    return render(
        Path(__file__).with_name("page.html"),
        report.title,
        script=True,
        report=report,
        limits=sorted({limit for case in cases for limit in case.ever_below}, reverse=True),
        headlines=list(_headlines(cases)),
        fewest_different=FEWEST_DIFFERENT,
        bin_text=f"{GLUCOSE_BIN_MG_DL:g} mg/dl or {INSULIN_BIN_MU_MIN:g} mU/min",
        responses=_responses(report, band_times),
        response_thinned=any(len(case.bands_t_min) > band_times for case in cases),
        weeks=list(_weeks(report)),
        distributions=[_distribution(report, metric) for metric in cases[0].metric_counts],
        ranges=RANGES,
        range_colours=RANGE_COLOURS,
        grids=[_grid(case, most) for case in cases],
        zone_colours=ZONE_COLOURS,
        worst=_worst(report, people, shown, worst_times),
        worst_people=min(shown, max(len(case.worst) for case in cases)),
        worst_people_each=shown,
        worst_thinned=any(len(one.insulin_t_min) > worst_times for one in people),
    )


def _headlines(cases: Sequence[CaseReport]) -> Iterator[MetricRow]:
    for name, unit in cases[0].table:
        values = [case.table[name, unit] for case in cases]
        others = [
            _text(value if isinstance(value, str) else other_value(value, unit)) for value in values if unit in OTHERS
        ]
        yield MetricRow("", name, unit, list(map(_text, values)), others or None)


def _text(value: float | str) -> str:
    if isinstance(value, str):
        return value
    if not math.isfinite(value):
        return NOT_AVAILABLE
    if value == int(value):
        return f"{int(value)}"
    # as many digits as tell it: two beyond the point below ten, one above
    return f"{value:.{1 if abs(value) >= 10.0 else 2 if abs(value) >= 0.01 else 4}f}"


def _panels(report: TrialReport, glucose: list[Floats], insulin: list[Floats]) -> tuple[Panel, Panel]:
    """Empty panels of glucose and insulin, the same for all controllers."""
    marks = [(t_min, f"{carbs_g:.4g} g") for t_min, carbs_g in report.meals if t_min < report.horizon_min]
    marks += [(bout.t_min, exercise_in_words(bout)) for bout in report.exercise]
    above = glucose_panel([report.setpoint_mg_dl], report.lowest_glucose_mg_dl, glucose, height=240, marks=marks)
    below = Panel(INSULIN, (0.0, 1.05 * extent([0.0], *insulin)[1]), height=150)
    mark_faults((above, below), map(FAULTS.choose, report.faults), report.horizon_min)
    return above, below


def _responses(report: TrialReport, most: int) -> list[Plot]:
    """Bands of each controller, at not many more times than `most`."""
    cases = report.cases.values()
    glucose = [case.glucose_quantiles[quantile] for case in cases for quantile in BANDS[0]]
    insulin = [case.insulin_quantiles[BANDS[0][1]] for case in cases]
    plots = []
    for index, (label, case) in enumerate(report.cases.items()):
        panels, whose = _panels(report, glucose, insulin), "people's days" if case.weeks else "people"
        # each rate is held until the next, the last until the end
        steps_t = np.append(case.insulin_t_min, case.bands_t_min[-1])
        for panel, t_min, quantiles in (
            (panels[0], case.bands_t_min, case.glucose_quantiles),
            (panels[1], steps_t, case.insulin_quantiles),
        ):
            drawn = np.unique(np.append(np.arange(0, len(t_min), -(-len(t_min) // most)), len(t_min) - 1))
            shown = {q: values[drawn[drawn < len(values)]] for q, values in quantiles.items()}
            for low, high in BANDS:
                panel.area(t_min[drawn], shown[low], shown[high], index, f"{100 * (high - low):.0f} % of the {whose}")
            panel.line(t_min[drawn], shown[0.5], index, name="median")
        plots.append(Plot(label, report.horizon_min, panels, start_min=report.start_min))
    return plots


def _weeks(report: TrialReport) -> Iterator[Plot]:
    """Glucose and time in range of each controller by week, if they are told."""
    ends = [[week[quantile] for week in case.weeks] for case in report.cases.values() for quantile in ("p5", "p95")]
    for index, (label, case) in enumerate(report.cases.items()):
        if not case.weeks:
            continue
        t_min = np.minimum(MIN_PER_WEEK * np.arange(len(case.weeks) + 1), report.length_min)
        of = {name: np.array([week[name] for week in case.weeks]) for name in case.weeks[0]}
        panels = (
            glucose_panel([report.setpoint_mg_dl], report.lowest_glucose_mg_dl, list(map(np.array, ends)), height=240),
            Panel(TIME_IN_RANGE, (0.0, 105.0), height=120),
        )
        for low, high in BANDS:
            edges = of[f"p{100 * low:.0f}"], of[f"p{100 * high:.0f}"]
            panels[0].area(t_min, *edges, index, f"{100 * (high - low):.0f} % of the time")
        panels[0].line(t_min, of["p50"], index, name="median")
        panels[1].line(t_min, of["time_70_180_pct"], index, name="70 to 180 mg/dl")
        panels[1].line(t_min, of["time_below_70_pct"], index, dash=1, name="below 70 mg/dl")
        yield Plot(label, report.length_min, panels, start_min=report.start_min)


def _worst(report: TrialReport, people: Sequence[WorstPerson], shown: int, most: int) -> list[Plot]:
    """Courses of the people with the worst outcomes under each controller."""
    glucose, insulin = [concentrations(p.glucose_mg_dl) for p in people], [p.insulin_mU_min for p in people]
    plots = []
    for index, (label, case) in enumerate(report.cases.items()):
        above, below = _panels(report, glucose, insulin)
        horizon_min = max((float(one.t_min[-1]) for one in case.worst[:shown]), default=report.horizon_min)
        for one in case.worst[:shown]:
            whose: dict[str, Any] = {"kind": "thin", "name": f"person {one.person}", "person": one.person}
            above.line(*thinned(one.t_min, concentrations(one.glucose_mg_dl), most), index, **whose)
            every = slice(None, None, -(-len(one.insulin_t_min) // most))
            t_min = np.append(one.insulin_t_min[every], one.t_min[-1])
            below.line(t_min, one.insulin_mU_min[every], index, **whose)
        plots.append(Plot(label, horizon_min, (above, below), start_min=report.start_min))
    return plots


def _grid(case: CaseReport, most: float) -> dict[str, Any]:
    """Content of the macro ``grid`` for a controller; `most` people in a cell have the strongest colour."""
    counts = np.asarray(case.cvga_counts)
    zones = [region[-1] for region in cvga.region_pct(counts)]
    people = [[c, r, int(counts[c, r])] for c, r in np.argwhere(counts > 0).tolist()]
    return {
        "drawn": {"cells": cvga.CELLS, "most": most, "people": people, "zones": [[z, ZONE_COLOURS[z]] for z in zones]},
        "shares": {zone: percent(share) for zone, share in cvga.zone_pct(case.cvga_counts).items()},
        "limits": (cvga.MINIMUM_LIMITS_MG_DL, cvga.MAXIMUM_LIMITS_MG_DL),
    }


def _distribution(report: TrialReport, metric: str) -> dict[str, Any]:
    """Content of the macro ``distribution``: outlines of a metric under all controllers, on one axis."""
    result, cases = result_named(metric), {label: case.metric_counts[metric] for label, case in report.cases.items()}
    occupied = np.flatnonzero(np.sum([part.counts for part in cases.values()], axis=0))
    first, last = (int(occupied[0]), int(occupied[-1])) if occupied.size else (0, 0)
    unit = shown_unit(result.unit)
    scale = (1.0 if unit == result.unit else other_value(1.0, result.unit)) / result.divisor
    shown = scale * np.asarray(next(iter(cases.values())).edges, float)[first : last + 2]
    alike = first == last and all(result.text(part.p5) == result.text(part.p95) for part in cases.values())
    zero = all(map(_all_zero, cases.values()))
    notes, outlines = {}, []
    for label, part in cases.items():
        counts = np.asarray(part.counts)[first : last + 1]
        notes[label] = "0 for everybody" if _all_zero(part) else "the same for everybody" if alike else ""
        there = counts.any() and not notes[label]
        values = [scale * part.p5, scale * part.median, scale * part.p95]
        outlines.append({"counts": counts.tolist(), "values": values} if there else None)
    axis = [] if zero or alike else [float(f"{edge:.6g}") for edge in shown]
    return {
        "result": result,
        "parts": cases,
        "notes": notes,
        "drawn": {"edges": axis, "outlines": outlines},
        "unit": "" if zero else unit,
    }


def _all_zero(part: MetricDistribution) -> bool:
    """Whether the metric is 0 for everybody: all are in the bin of 0, and so is what 95 % stay below."""
    occupied = np.flatnonzero(np.asarray(part.counts))
    if occupied.size != 1 or part.p5 != 0.0 or part.p95 != 0.0:
        return False
    low, high = np.asarray(part.edges, float)[occupied[0] : occupied[0] + 2]
    return bool(low <= 0.0 <= high)
