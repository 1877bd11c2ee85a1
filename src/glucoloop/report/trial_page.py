"""Self-contained page of a trial: one file that needs no network and can be shared."""

from __future__ import annotations

import html
import math
from collections.abc import Callable, Mapping
from typing import Final

from glucoloop.metrics.control_variability import zone_pct
from glucoloop.report import _page
from glucoloop.report._trial_curves import BANDS, band_panels, thinned, worst_panels
from glucoloop.report._trial_panels import ZONE_COLOURS, Panel, colour, distribution_panels, grid_panels, percent
from glucoloop.report._trial_style import RANGE_COLOURS, SCRIPT, STYLE
from glucoloop.report.rows import NOT_AVAILABLE, described
from glucoloop.report.trial_report import RANGES, TrialReport

# Side by side on a wide screen; fewer on a narrow one.
_COLUMNS: Final = {1: 1, 2: 2, 3: 3, 4: 2}
_LONG: Final = ' class="long"'
_LONG_FROM: Final = 28  # characters of a fact
_LONG_LABEL: Final = 16
_GRID_COLUMNS: Final = {1: 1, 2: 2, 3: 3, 4: 4}


def trial_page(report: TrialReport) -> str:
    """A trial as a self-contained HTML page.

    The headline numbers of each controller; quantiles of glucose and insulin over time on axes that all controllers
    share and that zoom together; how the metrics are spread over the people; the control-variability grid; the time in
    each range of glucose; and the people with the worst outcomes, with their traces.

    Parameters
    ----------
    report : TrialReport

    Returns
    -------
    str
        HTML; labels and the title are shown as they are, whatever they hold.
    """
    draw = _Drawing()
    sections = [
        _lead(report),
        _headlines(report),
        _responses(report, draw),
        _distributions(report, draw),
        _ranges(report),
        _grids(report, draw),
        _worst(report, draw),
        f"<script>{SCRIPT}</script>",
    ]
    return _page.page(report.title, "\n".join(sections), STYLE)


class _Drawing:
    """Plots numbered in order; the first one includes plotly."""

    def __init__(self) -> None:
        self.drawn = 0

    def __call__(self, panel: Panel, *, zooms: bool) -> str:
        self.drawn += 1
        return _page.picture(
            panel.data,
            panel.layout,
            name=f"plot-{self.drawn}",
            height_px=panel.height_px,
            buttons=["toImage", "resetScale2d"] if zooms else [],
            library=self.drawn == 1,
        )


def count(people: int) -> str:
    """Text of a number of people, with its thousands separated."""
    return f"{people:,}".replace(",", "\u202f")


def _lead(report: TrialReport) -> str:
    people = f"{count(report.people)} virtual {'person' if report.people == 1 else 'people'}"
    if report.infeasible:
        people += (
            f", of whom {count(report.infeasible)} {'has' if report.infeasible == 1 else 'have'} no basal rate for the "
            "setpoint and so could not be tried; all that follows is of the others"
        )
    facts = {"Setpoint": f"{report.setpoint_mg_dl:g} mg/dl"} | dict(report.facts)
    told = "".join(
        f"<div{_LONG * (len(value) > _LONG_FROM)}><dt>{html.escape(name)}</dt><dd>{html.escape(value)}</dd></div>"
        for name, value in facts.items()
    )
    return f'<p class="lead">{people}.</p>\n<dl class="facts">{told}</dl>'


def _section(title: str, caption: str, body: str) -> str:
    return f'<section>\n<h2>{title}</h2>\n<p class="caption">{caption}</p>\n{body}\n</section>'


def _name(label: str, index: int) -> str:
    return f'<span class="chip" style="background: {colour(index)}"></span>{html.escape(label)}'


def _cards(report: TrialReport, columns: int, kind: str, body: Callable[[str], str]) -> str:
    cards = [
        f'<div class="card"><h3>{_name(label, index)}</h3>\n{body(label)}</div>'
        for index, label in enumerate(report.cases)
    ]
    return f'<div class="cards {kind}" style="--columns: {columns}">\n' + "\n".join(cards) + "\n</div>"


def _headlines(report: TrialReport) -> str:
    heads = "".join(
        f'<th scope="col" class="value{" long" * (len(label) > _LONG_LABEL)}">{_name(label, index)}</th>'
        for index, label in enumerate(report.cases)
    )
    rows = []
    for name in next(iter(report.cases.values())).table:
        text, unit = _unit_apart(name)
        values = [case.table[name] for case in report.cases.values()]
        cells = "".join(f'<td class="value">{html.escape(_told(value))}</td>' for value in values)
        rows.append(f'<tr><th scope="row">{html.escape(text)}</th>{cells}<td>{html.escape(unit)}</td></tr>')
    table = (
        f'<div class="scroll"><table class="headlines">\n<thead><tr><th scope="col">Over the people</th>{heads}'
        f'<th scope="col">Unit</th></tr></thead>\n<tbody>{"".join(rows)}</tbody></table></div>'
    )
    return f"<section>\n<h2>Headline numbers</h2>\n{table}\n</section>"


def _unit_apart(name: str) -> tuple[str, str]:
    """Name split from the unit at its end."""
    text, opening, unit = name.rpartition(" (")
    return (text, unit[:-1]) if opening and unit.endswith(")") else (name, "")


def _told(value: float | str) -> str:
    if isinstance(value, str):
        return value
    if not math.isfinite(value):
        return NOT_AVAILABLE
    if value == int(value):
        return f"{int(value)}"
    # as many digits as tell it: two beyond the point below ten, one above
    return f"{value:.{1 if abs(value) >= 10.0 else 2 if abs(value) >= 0.01 else 4}f}"


def _responses(report: TrialReport, draw: _Drawing) -> str:
    panels = band_panels(report)
    caption = (
        f"Glucose free of noise, and delivered insulin, over the people. The line is the median. {_legend()} A solid "
        f"grey line marks the setpoint, a dashed one {report.lowest_glucose_mg_dl:g} mg/dl, below which glucose should "
        "never be. Drag to zoom into all panels, double-click to return."
    )
    if thinned(report):
        caption += " Of this long run, not every sample is drawn."
    body = _cards(report, _columns(_COLUMNS, report), "linked", lambda label: draw(panels[label], zooms=True))
    return _section("Response of the population", caption, body)


def _legend() -> str:
    shares = [f"{100 * (high - low):.0f} %" for low, high, _ in reversed(BANDS)]
    swatches = [
        f'<span class="band"><span class="swatch" style="opacity: {opacity}"></span>{share}</span>'
        for share, opacity in zip(shares, (0.75, 0.45, 0.2), strict=True)
    ]
    return f"Bands hold the middle {', '.join(swatches)} of the people at each moment."


def _columns(table: Mapping[int, int], report: TrialReport) -> int:
    return table.get(len(report.cases), 3)


def _distributions(report: TrialReport, draw: _Drawing) -> str:
    panels = distribution_panels(report)
    caption = (
        "How each metric is spread. The dot is the median, the thick line runs from 5 to 95 % of the people, as the "
        "numbers on the right do. Heights are square roots of shares, so that the few at the ends can be seen."
    )
    cards = [
        f'<div class="card"><h3>{html.escape(described(metric).name.strip())}</h3>\n{draw(panel, zooms=False)}</div>'
        for metric, panel in panels.items()
    ]
    columns = min(3, max(1, len(cards)))
    body = f'<div class="cards" style="--columns: {columns}">\n' + "\n".join(cards) + "\n</div>"
    return _section("Spread of the metrics", caption, body)


def _ranges(report: TrialReport) -> str:
    heads = "".join(
        f'<span class="share"><span class="chip" style="background: {RANGE_COLOURS[name]}"></span>{_range(name)}</span>'
        for name in RANGES
    )
    rows = [f'<div class="range heads"><span class="who"></span><span class="bar empty"></span>{heads}</div>']
    for index, (label, case) in enumerate(report.cases.items()):
        times = {name: float(case.time_in_range_pct[name]) for name in RANGES}
        parts = "".join(
            f'<span style="flex-grow: {time:.6g}; background: {RANGE_COLOURS[name]}" title="{name} mg/dl: '
            f'{percent(time)}"></span>'
            for name, time in times.items()
            if time > 0.0
        )
        shares = "".join(f'<span class="share">{percent(time)}</span>' for time in times.values())
        rows.append(
            f'<div class="range"><span class="who">{_name(label, index)}</span><span class="bar">{parts}</span>'
            f"{shares}</div>"
        )
    caption = "Mean over the people of the time that glucose spends in each range, in mg/dl."
    return _section("Time in range", caption, '<div class="ranges">\n' + "\n".join(rows) + "\n</div>")


def _range(name: str) -> str:
    return name.replace("below ", "&lt; ").replace("above ", "&gt; ").replace(" to ", "–")


def _grids(report: TrialReport, draw: _Drawing) -> str:
    panels = grid_panels(report)
    caption = (
        "Each person is counted at the least and the greatest glucose of the run; the stronger the colour, the more "
        "people (on a "
        "logarithmic scale), and those beyond the grid stand on its border. The nearer to the lower left, the better."
    )
    if report.setpoint_mg_dl < 90.0:
        caption += (
            f" At a setpoint of {report.setpoint_mg_dl:g} mg/dl nobody's minimum can be above 90 mg/dl, so that the "
            "best zone within reach is lower B."
        )
    caption += " Zones after Magni et al., J. Diabetes Sci. Technol. 2(4), 2008."

    def card(label: str) -> str:
        return draw(panels[label], zooms=False) + _zones(zone_pct(report.cases[label].cvga_counts))

    body = _cards(report, _columns(_GRID_COLUMNS, report), "grids", card)
    return _section("Control-variability grid", caption, body)


def _zones(shares: Mapping[str, float]) -> str:
    told = "".join(
        f'<span><span class="chip" style="background: {ZONE_COLOURS[zone]}"></span>{zone}<br>{percent(share)}</span>'
        for zone, share in shares.items()
    )
    return f'\n<div class="zones">{told}</div>'


def _worst(report: TrialReport, draw: _Drawing) -> str:
    panels = worst_panels(report)

    def card(label: str) -> str:
        rows = "".join(
            f'<tr tabindex="0"><td class="value">{person.person}</td><td class="value">{person.minimum_mg_dl:.1f}</td>'
            f"<td>{html.escape(person.note)}</td></tr>"
            for person in report.cases[label].worst
        )
        return (
            f"{draw(panels[label], zooms=True)}\n"
            '<div class="scroll"><table><thead><tr><th scope="col" class="value">Person</th>'
            '<th scope="col" class="value">Minimum (mg/dl)</th><th scope="col">Distinctive parameters</th></tr></thead>'
            f"<tbody>{rows}</tbody></table></div>"
        )

    most = max(len(case.worst) for case in report.cases.values())
    caption = f"The {most} people with the least glucose under each controller. Point at a row to single out a person."
    body = _cards(report, min(2, len(report.cases)), "linked worst", card)
    return _section("People with the worst outcomes", caption, body)
