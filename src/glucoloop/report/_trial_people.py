"""Pictures of a trial's page over people: control-variability grid, and distributions of metrics."""

from __future__ import annotations

import html
from typing import Final

import numpy as np

from glucoloop.metrics.control_variability import (
    CELLS,
    MAXIMUM_LIMITS_MG_DL,
    MINIMUM_LIMITS_MG_DL,
    region_pct,
    zone_pct,
)
from glucoloop.parts.metrics import Result, described
from glucoloop.printable import percent
from glucoloop.report._page import count, either
from glucoloop.report._plot import colour, nice_ticks
from glucoloop.report._style import ZONE_COLOURS
from glucoloop.report.trial_report import CaseReport, MetricDistribution, TrialReport
from glucoloop.units import MG_DL_PER_MMOL_L

_SHADES: Final = 6
"""Number of shades of the grid, on a logarithmic scale."""
_WIDTH: Final = 1000
_HEIGHT: Final = 100


def grid_picture(case: CaseReport, index: int, most: float) -> str:
    """The control-variability grid of a controller; `most` people in a cell have the strongest colour."""
    counts = np.asarray(case.cvga_counts, float)
    side = 3 * CELLS
    zones = "".join(
        f'<rect x="{side - CELLS * (place // 3 + 1)}" y="{side - CELLS * (place % 3 + 1)}" width="{CELLS}" '
        f'height="{CELLS}" style="fill: {ZONE_COLOURS[region[-1]]}; fill-opacity: .2; stroke: var(--rule); '
        'stroke-width: .15"/>'
        for place, region in enumerate(region_pct(case.cvga_counts))
    )
    shade = np.zeros(counts.shape, int)
    there = counts > 0
    scale = np.log(max(most, 2.0))
    shade[there] = 1 + np.minimum(np.log(counts[there]) / scale * _SHADES, _SHADES - 1).astype(int)
    people = "".join(
        f'<path style="fill: {colour(index)}; fill-opacity: {0.3 + 0.7 * (level - 1) / (_SHADES - 1):.2f}; '
        f'stroke: none" d="{cells}"/>'
        for level in range(1, _SHADES + 1)
        # the least glucose rises to the left, the greatest upwards
        if (
            cells := "".join(f"M{side - 1 - c} {side - 1 - r}h1v1h-1z" for c, r in np.argwhere(shade == level).tolist())
        )
    )
    letters = "".join(
        f'<text x="{side - CELLS * (place // 3 + 1) + 0.8}" y="{side - CELLS * (place % 3 + 1) + 3.2}">'
        f"{region[-1]}</text>"
        for place, region in enumerate(region_pct(case.cvga_counts))
    )
    shares = zone_pct(case.cvga_counts)
    alt = "Control-variability grid: " + ", ".join(f"zone {zone} {percent(share)}" for zone, share in shares.items())
    across = "".join(f"<span>{text}</span>" for text in reversed(_beyond(MINIMUM_LIMITS_MG_DL)))
    up = "".join(f"<span>{text}</span>" for text in reversed(_beyond(MAXIMUM_LIMITS_MG_DL)))
    told = "".join(
        f'<span><span class="chip" style="background: {ZONE_COLOURS[zone]}"></span>{zone}<br>{percent(share)}</span>'
        for zone, share in shares.items()
    )
    return (
        f'<div class="cvga"><div class="up" aria-hidden="true">{up}</div>'
        f'<svg role="img" aria-label="{html.escape(alt)}" viewBox="0 0 {side} {side}">{zones}{people}{letters}</svg>'
        f'<div class="across" aria-hidden="true">{across}</div>'
        '<p class="time-unit">Maximum upwards, minimum falling to the right (mg/dl)</p></div>'
        f'<div class="zones">{told}</div>'
    )


def _beyond(limits: tuple[float, ...]) -> list[str]:
    """Labels of the grid's limits, whose outermost cells hold all values beyond."""
    return [f"≤ {limits[0]:g}", *(f"{limit:g}" for limit in limits[1:-1]), f"≥ {limits[-1]:g}"]


def distribution_picture(report: TrialReport, metric: str) -> str:
    """Distribution of a metric over the people, one row per controller, on one axis."""
    told = described(metric)
    of_all = {label: case.metric_counts[metric] for label, case in report.cases.items()}
    occupied = np.flatnonzero(np.sum([part.counts for part in of_all.values()], axis=0))
    edges = np.asarray(next(iter(of_all.values())).edges, float) / told.divisor
    first, last = (int(occupied[0]), int(occupied[-1])) if occupied.size else (0, edges.size - 2)
    shown = slice(first, last + 1)
    span = (float(edges[first]), float(edges[last + 1]))
    alike = first == last and all(told.text(part.p5) == told.text(part.p95) for part in of_all.values())
    rows = "".join(
        _row(told, label, part, np.asarray(part.counts, float)[shown], edges[first : last + 2], index, alike=alike)
        for index, (label, part) in enumerate(of_all.items())
    )
    unit = f'<p class="time-unit">{html.escape(told.unit)}</p>'
    if all(map(_all_zero, of_all.values())):
        return rows
    if alike:
        return f"{rows}{unit}"
    ticks = "".join(
        f'<span style="left: {100.0 * (tick - span[0]) / (span[1] - span[0]):.4g}%">{tick:g}</span>'
        for tick in nice_ticks(*span, 5)
    )
    return f'{rows}<div class="below" aria-hidden="true">{ticks}</div>{unit}'


def _row(
    told: Result,
    label: str,
    part: MetricDistribution,
    counts: np.ndarray,
    edges: np.ndarray,
    index: int,
    *,
    alike: bool,
) -> str:
    """One controller: its name and numbers, and the shares of the people as an outline unless all are alike."""
    numbers = _in_unit(told, f"<b>{told.text(part.median)}</b> ({told.text(part.p5)} – {told.text(part.p95)})", part)
    head = (
        f'<div class="row"><span><span class="chip" style="background: {colour(index)}"></span>{html.escape(label)}'
        f"</span><span>{numbers}</span></div>"
    )
    if _all_zero(part):
        return f'{head}<p class="none">0 for everybody</p>'
    people = counts.sum()
    if not people:
        return head
    if alike:
        return f'{head}<p class="none">the same for everybody</p>'
    x = np.rint(_WIDTH * (edges - edges[0]) / (edges[-1] - edges[0])).astype(int)
    height = np.rint(_HEIGHT * (1.0 - 0.95 * np.sqrt(counts / counts.max()))).astype(int)
    steps = "".join(f"V{y}H{right}" for y, right in zip(height.tolist(), x[1:].tolist(), strict=True))
    place = np.interp(np.array([part.p5, part.median, part.p95]) / told.divisor, edges, x)
    whom = f"{count(int(people))} {'person' if people == 1 else 'people'}"
    alt = (
        f"{told.title.strip()} under {label}, of {whom}: median {told.text(part.median)}, "
        f"5 % below {told.text(part.p5)}, 5 % above {told.text(part.p95)} {told.unit}"
    )
    return (
        f'{head}<svg class="outline" role="img" aria-label="{html.escape(alt)}" viewBox="0 0 {_WIDTH} {_HEIGHT + 12}" '
        f'preserveAspectRatio="none"><path style="fill: {colour(index)}; fill-opacity: .25; stroke: none" '
        f'd="M0 {_HEIGHT}{steps}V{_HEIGHT}z"/><path style="stroke: {colour(index)}; stroke-width: 4" '
        f'd="M{place[0]:.0f} {_HEIGHT + 5}H{place[2]:.0f}"/><path class="median" '
        f'd="M{place[1]:.0f} {_HEIGHT + 5}h0"/></svg>'
    )


def _in_unit(told: Result, text: str, part: MetricDistribution) -> str:
    if told.unit != "mg/dl":
        return text
    low, middle, high = (f"{value / MG_DL_PER_MMOL_L:.2f}" for value in (part.p5, part.median, part.p95))
    return either(f"{text} mg/dl", f"<b>{middle}</b> ({low} – {high}) mmol/l")


def _all_zero(part: MetricDistribution) -> bool:
    """Whether the metric is 0 for everybody: all are in the bin of 0, and so is what 95 % stay below."""
    counts, edges = np.asarray(part.counts), np.asarray(part.edges, float)
    occupied = np.flatnonzero(counts)
    if occupied.size != 1 or part.p5 != 0.0 or part.p95 != 0.0:
        return False
    place = int(occupied[0])
    return bool(edges[place] <= 0.0 <= edges[place + 1])
