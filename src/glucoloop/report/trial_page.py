"""Self-contained page of a trial: one file that needs no network and can be shared."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from glucoloop.cohorts.bins import GLUCOSE_BIN_MG_DL, INSULIN_BIN_MU_MIN
from glucoloop.printable import NOT_AVAILABLE, glucose_text
from glucoloop.report._style import RANGE_COLOURS, ZONE_COLOURS
from glucoloop.report.charts import GLUCOSE, INSULIN, Panel, Plot, TimeAxis, colour, extent, thinned
from glucoloop.report.page import TARGET_MG_DL, mark_faults
from glucoloop.report.table import Row
from glucoloop.report.template import render
from glucoloop.report.trial_charts import distribution_of, grid_of
from glucoloop.report.trial_report import RANGES, CaseReport, Floats, TrialReport, WorstPerson
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


def trial_page(report: TrialReport) -> str:
    """A trial as a self-contained HTML page.

    The people who had low glucose; the headline numbers of each controller; percentiles of glucose and insulin over
    time on axes that all controllers share and that zoom together; how the metrics are spread over the people; the time
    in each range of glucose; the control-variability grid; the people with the worst outcomes, with their traces; and
    the situation.

    Parameters
    ----------
    report : TrialReport

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
        distributions=[distribution_of(report, metric) for metric in cases[0].metric_counts],
        ranges={name: _in_mmol_l(name) for name in RANGES},
        range_colours=RANGE_COLOURS,
        grids=[grid_of(case, most) for case in cases],
        zone_colours=ZONE_COLOURS,
        worst=_worst(report, people, shown, worst_times),
        worst_people=min(shown, max(len(case.worst) for case in cases)),
        worst_people_each=shown,
        worst_thinned=any(len(one.insulin_t_min) > worst_times for one in people),
    )


def _headlines(cases: Sequence[CaseReport]) -> list[Row]:
    rows = []
    for name in cases[0].table:
        text, opening, unit = name.rpartition(" (")
        text, unit = (text, unit[:-1]) if opening and unit.endswith(")") else (name, "")
        values = [case.table[name] for case in cases]
        mmol_l = None
        if unit == "mg/dl":
            mmol_l = tuple(_text(v if isinstance(v, str) else v / MG_DL_PER_MMOL_L) for v in values)
        rows.append(Row("", text, unit, tuple(map(_text, values)), mmol_l))
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
    words = name.split()
    return " ".join(f"{float(word) / MG_DL_PER_MMOL_L:.1f}" if word.isdigit() else word for word in words)


def _frame(report: TrialReport, glucose: list[Floats], insulin: list[Floats], alts: tuple[str, str]) -> list[Panel]:
    """Empty panels of glucose and insulin, the same for all controllers."""
    time = TimeAxis(report.horizon_min)
    low, high = extent([report.setpoint_mg_dl, report.lowest_glucose_mg_dl], *glucose)
    margin = 0.05 * (high - low)
    marks = [(t_min, f"{carbs_g:.4g} g") for t_min, carbs_g in report.meals if t_min < time.end_min]
    above = Panel(GLUCOSE, time, low - margin, high + margin, rem=13.0, alt=alts[0], marks=marks)
    above.area("target", (0.0, time.end_min), TARGET_MG_DL)
    above.level([report.setpoint_mg_dl], "level")
    above.level([report.lowest_glucose_mg_dl], "level dash-1")
    panels = [above, Panel(INSULIN, time, 0.0, 1.05 * extent([0.0], *insulin)[1], rem=7.0, alt=alts[1])]
    mark_faults(panels, report.faults)
    return panels


def _responses(report: TrialReport, most: int) -> list[Plot]:
    """Bands of each controller, at not many more times than `most`."""
    cases = report.cases.values()
    glucose = [case.glucose_quantiles[quantile] for case in cases for quantile in BANDS[0]]
    insulin = [case.insulin_quantiles[BANDS[0][1]] for case in cases]
    plots = []
    for index, (label, case) in enumerate(report.cases.items()):
        panels = _frame(report, glucose, insulin, _alts(label, case))
        # each rate is held until the next, the last until the end
        for panel, t_min, quantiles, held in (
            (panels[0], case.bands_t_min, case.glucose_quantiles, False),
            (panels[1], np.append(case.insulin_t_min, case.bands_t_min[-1]), case.insulin_quantiles, True),
        ):
            kept = np.unique(np.append(np.arange(0, len(t_min), -(-len(t_min) // most)), len(t_min) - 1))
            t = t_min[kept]
            shown = {
                quantile: np.append(values, values[-1:])[: len(t_min)][kept] for quantile, values in quantiles.items()
            }
            for low, high in BANDS:
                name = f"{100 * (high - low):.0f} % of the people"
                panel.band(t, shown[low], shown[high], f"band {colour(index)}", name, held=held)
            (panel.steps if held else panel.line)(t, shown[0.5], colour(index), name="median")
        plots.append(Plot(label, panels))
    return plots


def _alts(label: str, case: CaseReport) -> tuple[str, str]:
    def course(quantiles: Floats, t_min: Floats, unit: str) -> str:
        if not np.isfinite(quantiles).any():
            return "not known"
        least, most = int(np.nanargmin(quantiles)), int(np.nanargmax(quantiles))
        return (
            f"least {quantiles[least]:.1f} {unit} at {t_min[least]:g} min, greatest {quantiles[most]:.1f} at "
            f"{t_min[most]:g} min"
        )

    glucose = ", ".join(
        f"{name} {course(np.asarray(case.glucose_quantiles[q]), case.bands_t_min, 'mg/dl')}"
        for q, name in ((0.05, "5th percentile"), (0.5, "median"), (0.95, "95th percentile"))
    )
    insulin = course(np.asarray(case.insulin_quantiles[0.5]), case.insulin_t_min, "mU/min")
    return f"Glucose under {label}: {glucose}", f"Insulin under {label}: median {insulin}"


def _worst(report: TrialReport, people: Sequence[WorstPerson], shown: int, most: int) -> list[Plot]:
    """Courses of the people with the worst outcomes under each controller."""
    glucose, insulin = [concentrations(p.glucose_mg_dl) for p in people], [p.insulin_mU_min for p in people]
    plots = []
    for index, (label, case) in enumerate(report.cases.items()):
        worst = case.worst[:shown]
        least = ", ".join(f"person {one.person} {glucose_text(one.minimum_mg_dl)} mg/dl" for one in worst)
        alts = f"Glucose under {label} of the worst: least {least}", f"Insulin under {label}"
        above, below = panels = _frame(report, glucose, insulin, alts)
        for one in worst:
            kind = f"thin {colour(index)}"
            named: dict[str, Any] = {"name": f"person {one.person}", "person": one.person}
            above.line(*thinned(one.t_min, concentrations(one.glucose_mg_dl), most), kind, **named)
            kept = slice(None, None, -(-len(one.insulin_t_min) // most))
            rate = one.insulin_mU_min[kept]
            below.steps(np.append(one.insulin_t_min[kept], one.t_min[-1]), np.append(rate, rate[-1:]), kind, **named)
        plots.append(Plot(label, panels))
    return plots
