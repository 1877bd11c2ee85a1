"""Self-contained page of a trial: one file that needs no network and can be shared."""

from __future__ import annotations

import html
import math
from collections.abc import Callable, Sequence
from typing import Final

import numpy as np

from glucoloop.cohorts.bins import GLUCOSE_BIN_MG_DL, INSULIN_BIN_MU_MIN
from glucoloop.parts.metrics import described
from glucoloop.printable import NOT_AVAILABLE, glucose_text, how_many, percent
from glucoloop.report import _page
from glucoloop.report._page import count, either, in_both_units, scrolling
from glucoloop.report._plot import GLUCOSE, INSULIN, Panel, colour, extent, linked, plot, thinned
from glucoloop.report._style import RANGE_COLOURS
from glucoloop.report._trial_people import distribution_picture, grid_picture
from glucoloop.report.page import TARGET_MG_DL, mark_faults
from glucoloop.report.trial_report import RANGES, CaseReport, Floats, TrialReport, WorstPerson
from glucoloop.report.validity import concentrations
from glucoloop.units import MG_DL_PER_MMOL_L

BANDS: Final = ((0.05, 0.95), (0.25, 0.75))
"""Lower and upper quantile of each band."""
_COLUMNS: Final = {1: 1, 2: 2, 3: 3, 4: 2}
"""Number of controllers beside each other on a wide screen."""
_GRID_COLUMNS: Final = {1: 1, 2: 2, 3: 3, 4: 4}
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
    sections = [
        _lead(report),
        _page.units(),
        _harm(report),
        _headlines(report),
        _responses(report),
        _distributions(report),
        _ranges(report),
        _grids(report),
        _worst(report),
        _page.situation({"Setpoint": f"{report.setpoint_mg_dl:g} mg/dl"} | dict(report.facts), report.repeat),
    ]
    return _page.page(report.title, "\n".join(section for section in sections if section), STYLE, script=True)


def _lead(report: TrialReport) -> str:
    people = f"{count(report.people)} virtual {'person' if report.people == 1 else 'people'}"
    if report.infeasible:
        people += (
            f", of whom {count(report.infeasible)} {'has' if report.infeasible == 1 else 'have'} no basal rate for the "
            "setpoint and so could not be tried; all that follows is of the others"
        )
    return f'<p class="lead">{people}.</p>'


def _name(label: str, index: int) -> str:
    return f'<span class="chip" style="background: {colour(index)}"></span>{html.escape(label)}'


def _names(report: TrialReport) -> list[str]:
    return [_name(label, index) for index, label in enumerate(report.cases)]


def _cards(report: TrialReport, columns: int, kind: str, body: Callable[[str, int], str]) -> str:
    bodies = {_name(label, index): body(label, index) for index, label in enumerate(report.cases)}
    return _page.cards(bodies, columns, kind)


def _harm(report: TrialReport) -> str:
    """Numbers of people who were ever below each low glucose, and the one who fell lowest."""
    limits = sorted({limit for case in report.cases.values() for limit in case.ever_below}, reverse=True)
    rows = [
        [
            in_both_units(f"Ever below {limit:g} mg/dl"),
            *(_people(*case.ever_below[limit]) for case in report.cases.values()),
        ]
        for limit in limits
    ]
    rows.append(["Lowest glucose of all", *(_lowest(case) for case in report.cases.values())])
    if any(case.not_finite for case in report.cases.values()):
        cells = (count(case.not_finite) if case.not_finite else "nobody" for case in report.cases.values())
        rows.append(["Glucose did not stay finite; in no other number", *cells])
    table = _page.table(["People", *_names(report)], rows, kind="headlines")
    return _page.section("Who was harmed", "", scrolling(table, "People with low glucose"))


def _people(number: int, share_pct: float) -> str:
    return "nobody" if number == 0 else f"{count(number)} ({percent(share_pct)})"


def _lowest(case: CaseReport) -> str:
    if not case.worst:
        return NOT_AVAILABLE
    worst = case.worst[0]
    return f"{_page.glucose(worst.minimum_mg_dl)}, person {worst.person}"


def _headlines(report: TrialReport) -> str:
    rows = []
    for name in next(iter(report.cases.values())).table:
        text, unit = _unit_apart(name)
        values = [_told(case.table[name], unit) for case in report.cases.values()]
        shown_unit = either(unit, "mmol/l") if unit == "mg/dl" else html.escape(unit)
        rows.append([in_both_units(html.escape(text)), *values, shown_unit])
    table = _page.table(["Over the people", *_names(report), "Unit"], rows, kind="headlines")
    return _page.section("Headline numbers", "", scrolling(table, "Headline numbers"))


def _unit_apart(name: str) -> tuple[str, str]:
    """Name split from the unit at its end."""
    text, opening, unit = name.rpartition(" (")
    return (text, unit[:-1]) if opening and unit.endswith(")") else (name, "")


def _told(value: float | str, unit: str) -> str:
    if isinstance(value, str):
        return html.escape(value)
    if not math.isfinite(value):
        return NOT_AVAILABLE
    if unit == "mg/dl":
        return either(_digits(value), _digits(value / MG_DL_PER_MMOL_L))
    return _digits(value)


def _digits(value: float) -> str:
    if value == int(value):
        return f"{int(value)}"
    # as many digits as tell it: two beyond the point below ten, one above
    return f"{value:.{1 if abs(value) >= 10.0 else 2 if abs(value) >= 0.01 else 4}f}"


def _frame(
    report: TrialReport, quantity_low: list[Floats], insulin: list[Floats], alts: tuple[str, str]
) -> list[Panel]:
    """Empty panels of glucose and insulin, the same for all controllers."""
    end_min = report.horizon_min
    low, high = extent([report.setpoint_mg_dl, report.lowest_glucose_mg_dl], *quantity_low)
    margin = 0.05 * (high - low)
    marks = [(t_min, f"{carbs_g:.4g} g") for t_min, carbs_g in report.meals if t_min < end_min]
    glucose = Panel(GLUCOSE, low - margin, high + margin, 13.0, alts[0], marks=marks)
    glucose.area("target", (0.0, end_min), TARGET_MG_DL)
    glucose.level(report.setpoint_mg_dl, end_min)
    glucose.level(report.lowest_glucose_mg_dl, end_min, "level dash-1")
    panels = [glucose, Panel(INSULIN, 0.0, 1.05 * extent([0.0], *insulin)[1], 7.0, alts[1])]
    mark_faults(panels, report.faults, end_min)
    return panels


def _every(size: int, most: int) -> slice:
    return slice(None, None, -(-size // most))


def _responses(report: TrialReport) -> str:
    cases = report.cases.values()
    glucose = [case.glucose_quantiles[quantile] for case in cases for quantile in BANDS[0]]
    insulin = [case.insulin_quantiles[BANDS[0][1]] for case in cases]
    most = max(_LEAST_TIMES, _BAND_TIMES // len(report.cases))

    def body(label: str, index: int) -> str:
        case = report.cases[label]
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
                style = f'class="band" style="fill: {colour(index)}" data-name="{name}"'
                panel.band(t, shown[low], shown[high], style, held=held)
            style = f'style="stroke: {colour(index)}" data-name="median"'
            (panel.steps if held else panel.line)(t, shown[0.5], style)
        return plot(panels, report.horizon_min, name=label)

    drawn = _cards(report, _COLUMNS.get(len(report.cases), 3), "", body)
    caption = (
        "Glucose free of noise, and delivered insulin, over the people: the line is the median, the darker band holds "
        "the middle half of the people at each moment (25 to 75 %), the paler one 90 % of them (5 to 95 %). "
        "A percentile is of all people at a moment, and no person's course; it is read from counts, and off by less "
        f"than {GLUCOSE_BIN_MG_DL:g} mg/dl or {INSULIN_BIN_MU_MIN:g} mU/min. The green band is 70 to 180 mg/dl, the "
        f"solid grey line the setpoint, the dashed one {report.lowest_glucose_mg_dl:g} mg/dl."
    )
    if report.meals:
        caption += " Meals stand above the picture, at the times at which they are planned."
    if report.faults:
        caption += " The times at which a fault can be present are shaded."
    if any(len(case.bands_t_min) > most for case in cases):
        caption += " Not every sample is drawn."
    return _page.section(
        "Response of the population", in_both_units(caption), linked(drawn, report.horizon_min, "response")
    )


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


def _distributions(report: TrialReport) -> str:
    first = next(iter(report.cases.values()))
    bodies = {
        in_both_units(html.escape(described(metric).title.strip())): distribution_picture(report, metric)
        for metric in first.metric_counts
    }
    caption = (
        "How each metric is spread. The dot and the bold number are the median; the line and the numbers in "
        "parentheses run from 5 to 95 % of the people. Heights are square roots of shares, so that the few at the ends "
        "can be seen."
    )
    return _page.section("Spread of the metrics", caption, _page.cards(bodies, min(3, max(1, len(bodies)))))


def _ranges(report: TrialReport) -> str:
    heads = [f'<span class="chip" style="background: {RANGE_COLOURS[name]}"></span>{_range(name)}' for name in RANGES]
    rows, bars = [], []
    for index, (label, case) in enumerate(report.cases.items()):
        times = {name: float(case.time_in_range_pct[name]) for name in RANGES}
        rows.append([_name(label, index), *map(percent, times.values())])
        parts = "".join(
            f'<span style="flex-grow: {time:.6g}; background: {RANGE_COLOURS[name]}"></span>'
            for name, time in times.items()
            if time > 0.0
        )
        bars.append(f'<div class="range"><span>{_name(label, index)}</span><span class="bar">{parts}</span></div>')
    table = _page.table(["Controller", *heads], rows, kind="headlines")
    caption = "Mean over the people of the time that glucose spends in each range."
    body = f'<div aria-hidden="true">{"".join(bars)}</div>\n{scrolling(table, "Time in range")}'
    return _page.section("Time in range", caption, body)


def _range(name: str) -> str:
    """Name of a range in either unit."""
    short = name.replace("below ", "&lt; ").replace("above ", "&gt; ").replace(" to ", "–")
    mmol = " ".join(
        f"{float(word) / MG_DL_PER_MMOL_L:.1f}" if word.replace(".", "").isdigit() else word
        for word in short.replace("–", " – ").split()
    )
    return either(f"{short} mg/dl", f"{mmol.replace(' – ', '–')} mmol/l")


def _grids(report: TrialReport) -> str:
    caption = (
        "Each person is counted at the least and the greatest glucose of the run; the stronger the colour, the more "
        "people (on a logarithmic scale), and those beyond the grid stand on its border. The nearer to the lower left, "
        "the better."
    )
    if report.setpoint_mg_dl < 90.0:
        caption += (
            f" At a setpoint of {report.setpoint_mg_dl:g} mg/dl nobody's minimum can be above 90 mg/dl, so that the "
            "best zone within reach is lower B."
        )
    caption += " Zones after Magni et al., J. Diabetes Sci. Technol. 2(4), 2008."
    most = max(float(np.max(case.cvga_counts)) for case in report.cases.values())
    body = _cards(
        report,
        _GRID_COLUMNS.get(len(report.cases), 3),
        "grids",
        lambda label, index: grid_picture(report.cases[label], index, most),
    )
    return _page.section("Control-variability grid", in_both_units(caption), body)


def _worst(report: TrialReport) -> str:
    shown = max(2, _MOST_WORST // len(report.cases))
    people = [person for case in report.cases.values() for person in case.worst[:shown]]
    if not people:
        return ""
    glucose, insulin = [concentrations(p.glucose_mg_dl) for p in people], [p.insulin_mU_min for p in people]
    most = max(_LEAST_TIMES, _WORST_TIMES // len(report.cases))

    def body(label: str, index: int) -> str:
        worst = report.cases[label].worst[:shown]
        alt = ", ".join(f"person {one.person} {glucose_text(one.minimum_mg_dl)} mg/dl" for one in worst)
        panels = _frame(
            report, glucose, insulin, (f"Glucose under {label} of the worst: least {alt}", f"Insulin under {label}")
        )
        for one in worst:
            style = (
                f'class="thin" style="stroke: {colour(index)}" data-person="{one.person}" '
                f'data-name="person {one.person}"'
            )
            panels[0].line(*thinned(one.t_min, concentrations(one.glucose_mg_dl), most), style)
            kept = _every(len(one.insulin_t_min), most)
            rate = one.insulin_mU_min[kept]
            panels[1].steps(np.append(one.insulin_t_min[kept], one.t_min[-1]), np.append(rate, rate[-1:]), style)
        return f"{plot(panels, report.horizon_min, name=label)}\n{_worst_table(label, worst)}"

    most_worst = min(shown, max(len(case.worst) for case in report.cases.values()))
    caption = (
        f"The {how_many(most_worst, 'person', 'people')} with the least glucose under each "
        "controller, and what is different about each of them: the basal rate, and the parameters that are farthest "
        "from the middle of their range. A person's button shows that person alone."
    )
    if any(len(one.insulin_t_min) > most for one in people):
        caption += " Not every sample is drawn, but each least and greatest glucose."
    drawn = _cards(report, min(2, len(report.cases)), "worst", body)
    return _page.section("People with the worst outcomes", caption, linked(drawn, report.horizon_min, "worst"))


def _worst_table(label: str, worst: Sequence[WorstPerson]) -> str:
    rows = [
        [
            f'<button type="button" data-person="{one.person}" aria-pressed="false">{one.person}</button>',
            _page.glucose(one.minimum_mg_dl),
            html.escape(one.note),
        ]
        for one in worst
    ]
    table = _page.table(["Person", "Minimum", "What is different"], rows, kind="persons", values_from=9)
    return scrolling(table, f"The worst under {label}")


STYLE: Final = """
.headlines th, .headlines td { padding: 0.3rem 1.4rem 0.3rem 0; }
.headlines th[scope=row] { padding-left: 0; }
.headlines th:first-child { position: sticky; left: 0; background: var(--paper); }
.headlines tbody tr + tr > * { border-top: 1px solid var(--rule); }
.row { display: flex; flex-wrap: wrap; justify-content: space-between; gap: 0 1rem; font-size: 0.85rem;
       margin-top: 0.5rem; font-variant-numeric: tabular-nums; overflow-wrap: anywhere; }
.outline { display: block; width: 100%; height: 3rem; overflow: visible; }
svg .median { stroke: var(--ink); stroke-width: 8; stroke-linecap: round; }
.none { color: var(--faint); font-size: 0.85rem; margin: 0; }
.below { position: relative; height: 1.2rem; border-top: 1px solid var(--rule); margin: 0.2rem 0.4rem 0;
         font-size: 0.75rem; color: var(--faint); }
.below span { position: absolute; transform: translateX(-50%); }
.cvga { display: grid; grid-template-columns: 2.6rem minmax(0, 1fr); column-gap: 0.3rem; max-width: 27rem; }
.cvga svg { width: 100%; aspect-ratio: 1; font-size: 3px; fill: var(--ink); }
.cvga .up, .cvga .across { display: flex; justify-content: space-between; font-size: 0.75rem; color: var(--faint); }
.cvga .up { flex-direction: column; text-align: right; white-space: nowrap; }
.cvga :is(.across, p) { grid-column: 2; }
.zones { display: grid; grid-template-columns: repeat(5, minmax(0, 1fr)); gap: 0.3rem; margin-top: 0.3rem;
         font-size: 0.8rem; text-align: center; max-width: 27rem; font-variant-numeric: tabular-nums; }
.zones .chip { margin-right: 0.3rem; }
.worst :is(td, th[scope=row]) { vertical-align: top; }
.worst th[scope=row] { padding-left: 0; }
.worst td:last-child { min-width: 11rem; }
.range { display: grid; grid-template-columns: minmax(6rem, 14rem) minmax(0, 1fr); gap: 0.3rem 0.8rem;
         align-items: center; margin-top: 0.5rem; overflow-wrap: anywhere; }
.bar { display: flex; height: 1.5rem; border-radius: 0.25rem; overflow: hidden; gap: 1px; }
.bar > span { flex-basis: 0; min-width: 2px; print-color-adjust: exact; }
"""
