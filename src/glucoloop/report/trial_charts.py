"""Charts of a trial's page over people: control-variability grid, and distributions of metrics."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from glucoloop.metrics.control_variability import (
    CELLS,
    MAXIMUM_LIMITS_MG_DL,
    MINIMUM_LIMITS_MG_DL,
    region_pct,
    zone_pct,
)
from glucoloop.parts.metrics import Result, result_named
from glucoloop.printable import percent
from glucoloop.report.charts import nice_ticks
from glucoloop.report.trial_report import CaseReport, Floats, MetricDistribution, TrialReport

_SHADES: Final = 6
"""Number of shades of the grid, on a logarithmic scale."""
_SIDE: Final = 3 * CELLS


@dataclass(frozen=True)
class VariabilityGrid:
    """The control-variability grid of a controller."""

    alt: str
    zones: Sequence[tuple[int, int, str]]
    """Corner and name of each square."""
    people: Sequence[tuple[str, str]]
    """Opacity and path of each shade."""
    across: Sequence[str]
    up: Sequence[str]
    shares: Mapping[str, str]
    """Texts of the shares of the zones."""
    side: int = _SIDE
    cells: int = CELLS


def grid_of(case: CaseReport, most: float) -> VariabilityGrid:
    """The control-variability grid of a controller; `most` people in a cell have the strongest colour."""
    counts = np.asarray(case.cvga_counts, float)
    shade = np.zeros(counts.shape, int)
    there = counts > 0
    shade[there] = 1 + np.minimum(np.log(counts[there]) / np.log(max(most, 2.0)) * _SHADES, _SHADES - 1).astype(int)
    # the least glucose rises to the left, the greatest upwards
    people = [
        (
            f"{0.3 + 0.7 * (level - 1) / (_SHADES - 1):.2f}",
            "".join(f"M{_SIDE - 1 - c} {_SIDE - 1 - r}h1v1h-1z" for c, r in np.argwhere(shade == level).tolist()),
        )
        for level in range(1, _SHADES + 1)
        if (shade == level).any()
    ]
    zones = [
        (_SIDE - CELLS * (place // 3 + 1), _SIDE - CELLS * (place % 3 + 1), region[-1])
        for place, region in enumerate(region_pct(case.cvga_counts))
    ]
    shares = {zone: percent(share) for zone, share in zone_pct(case.cvga_counts).items()}
    alt = "Control-variability grid: " + ", ".join(f"zone {zone} {share}" for zone, share in shares.items())
    return VariabilityGrid(alt, zones, people, _beyond(MINIMUM_LIMITS_MG_DL), _beyond(MAXIMUM_LIMITS_MG_DL), shares)


def _beyond(limits: tuple[float, ...]) -> list[str]:
    """Labels of the grid's limits from the greatest on; the outermost cells hold all values beyond."""
    return [f"≥ {limits[-1]:g}", *(f"{limit:g}" for limit in limits[-2:0:-1]), f"≤ {limits[0]:g}"]


@dataclass(frozen=True)
class Outline:
    """Shares of the people under a controller, or the words in their place where they would show nothing."""

    part: MetricDistribution
    words: str = ""
    path: str = ""
    places: Sequence[int] = ()
    """Places of what 5 % of the people stay below, of the median, and of what 5 % are above."""
    width: int = 1000
    height: int = 100


@dataclass(frozen=True)
class SpreadOfMetric:
    """Distributions of a metric under all controllers, on one axis."""

    told: Result
    outlines: Mapping[str, Outline]
    unit: str
    ticks: Sequence[tuple[str, str]]
    """Place in percent and text of each tick; none without an outline."""


def distribution_of(report: TrialReport, metric: str) -> SpreadOfMetric:
    """Distribution of a metric over the people."""
    told = result_named(metric)
    of_all = {label: case.metric_counts[metric] for label, case in report.cases.items()}
    occupied = np.flatnonzero(np.sum([part.counts for part in of_all.values()], axis=0))
    edges = np.asarray(next(iter(of_all.values())).edges, float) / told.divisor
    first, last = (int(occupied[0]), int(occupied[-1])) if occupied.size else (0, edges.size - 2)
    shown = edges[first : last + 2]
    alike = first == last and all(told.text(part.p5) == told.text(part.p95) for part in of_all.values())
    outlines = {
        label: _outline(part, told.divisor, np.asarray(part.counts, float)[first : last + 1], shown, alike=alike)
        for label, part in of_all.items()
    }
    zero = all(map(_all_zero, of_all.values()))
    ticks = [] if zero or alike else nice_ticks(float(shown[0]), float(shown[-1]), 5)
    places = 100.0 * (np.array(ticks) - shown[0]) / (shown[-1] - shown[0])
    marks = [(f"{place:.4g}", f"{tick:g}") for place, tick in zip(places, ticks, strict=True)]
    return SpreadOfMetric(told, outlines, "" if zero else told.unit, marks)


def _outline(part: MetricDistribution, divisor: float, counts: Floats, edges: Floats, *, alike: bool) -> Outline:
    if _all_zero(part):
        return Outline(part, "0 for everybody")
    if not counts.any():
        return Outline(part)
    if alike:
        return Outline(part, "the same for everybody")
    width, height = Outline.width, Outline.height
    x = np.rint(width * (edges - edges[0]) / (edges[-1] - edges[0])).astype(int)
    y = np.rint(height * (1.0 - 0.95 * np.sqrt(counts / counts.max()))).astype(int)
    steps = "".join(f"V{up}H{right}" for up, right in zip(y.tolist(), x[1:].tolist(), strict=True))
    places = np.interp(np.array([part.p5, part.median, part.p95]) / divisor, edges, x)
    return Outline(part, path=f"M0 {height}{steps}V{height}z", places=[round(at) for at in places])


def _all_zero(part: MetricDistribution) -> bool:
    """Whether the metric is 0 for everybody: all are in the bin of 0, and so is what 95 % stay below."""
    counts, edges = np.asarray(part.counts), np.asarray(part.edges, float)
    occupied = np.flatnonzero(counts)
    if occupied.size != 1 or part.p5 != 0.0 or part.p95 != 0.0:
        return False
    place = int(occupied[0])
    return bool(edges[place] <= 0.0 <= edges[place + 1])
