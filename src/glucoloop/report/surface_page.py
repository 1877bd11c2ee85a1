"""Page of a search over tunings: the surface as coloured tables, and the tunings in order."""

from __future__ import annotations

import html
from collections.abc import Collection, Mapping, Sequence
from typing import Final

import numpy as np

from glucoloop.control.settings import MPCTuning
from glucoloop.refusal import Refusal
from glucoloop.report import _page
from glucoloop.report._page import Repeat
from glucoloop.report._surface_layout import Cell, SurfaceLayout, layout, texts
from glucoloop.report.tuning_rows import heads, remarks, tuning_rows
from glucoloop.tuning.surface import TuningRank, TuningSurface, tuning_text

MOST_ROWS: Final = 200
"""Largest number of tunings in the list; all are in ``surface.csv``."""
_NAMES: Final = {
    "prediction_horizon": "p",
    "reference_filter": "φ_r",
    "move_horizon": "m",
    "move_weight": "Γ_u",
    "output_weight": "Γ_y",
}
_LONG_NAMES: Final = {
    "prediction_horizon": "prediction horizon p, samples",
    "reference_filter": "reference filter φ_r",
    "move_horizon": "move horizon m",
    "move_weight": "move weight Γ_u",
    "output_weight": "output weight Γ_y",
}
_WITHOUT_NUMBER: Final = {
    "impossible": "p < m, no such tuning",
    "refused": "no controller can be designed",
    "not tried": "not tried",
}
_MARKS: Final = {"best": "★", "printed": "◆"}
_DARK: Final = 0.45  # a ground of less luminance than this has white letters


def surface_page(
    surface: TuningSurface,
    printed: TuningRank,
    *,
    title: str,
    grid: Collection[MPCTuning] | None = None,
    notes: Sequence[str] = (),
    facts: Mapping[str, str] | None = None,
    repeat: Repeat | None = None,
) -> str:
    """Write a search over tunings as one self-contained HTML page.

    Parameters
    ----------
    surface : TuningSurface
    printed : TuningRank
        The paper's tuning, as `TuningSurface.rank_of` finds it.
    title : str
    grid : collection of MPCTuning, optional
        Tunings in the coloured surface; all by default. The list shows all of them.
    notes : sequence of str
        Sentences below the title.
    facts : mapping, optional
        Settings of the search by name.
    repeat : Repeat, optional
        Command and configuration that repeat it.

    Returns
    -------
    str
        HTML without scripts. Every cell of the grid holds its sum of squared errors, or says why it has none; the list
        below gives the first `MOST_ROWS` tunings. A surface of too many panels is left out, and the page says so.
    """
    parts = [f"<p>{html.escape(note)}</p>" for note in notes]
    shown = surface if grid is None else surface.only(grid)
    try:
        places = layout(shown)
    except Refusal as error:
        parts.append(f"<p>The surface is not shown: {html.escape(str(error))}.</p>")
    else:
        parts += _surface(shown, printed, places)
    parts.append(_list(surface, printed))
    if facts or repeat:
        parts.append(_page.situation(facts or {}, repeat))
    return _page.page(title, "\n".join(parts), _STYLE)


def _surface(surface: TuningSurface, printed: TuningRank, places: SurfaceLayout) -> list[str]:
    colours = _colours(surface)
    best = surface.best() if surface.acceptable.any() else None
    beside = (
        ""
        if printed.tuning in surface.tunings
        else f" The {printed.called} tuning {tuning_text(printed.tuning)} is not on it."
    )
    parts = [
        "<h2>Sum of squared errors, (mg/dl)²</h2>",
        f"<p>Across: {_LONG_NAMES[places.x]}. Upwards: {_LONG_NAMES[places.y]}. "
        f"Dark is large, on a logarithmic scale.{beside}</p>",
        _legend(),
        '<div class="panels">',
    ]
    for combination in places.combinations():
        lines = []
        for value, row in reversed(list(zip(places.levels[places.y], places.rows(combination), strict=True))):
            cells = "".join(
                _cell(surface, {_MARKS["best"]: best, _MARKS["printed"]: printed.tuning}, colours, cell) for cell in row
            )
            lines.append(f"<tr><th scope='row'>{value:g}</th>{cells}</tr>")
        foot = "".join(f"<th scope='col'>{value:g}</th>" for value in places.levels[places.x])
        corner = f"{_NAMES[places.y]} \\ {_NAMES[places.x]}"
        caption = texts(places.panels, _NAMES, combination)
        parts.append(
            f"<table class='cells'><caption>{html.escape(caption)}</caption><tbody>{''.join(lines)}"
            f"<tr><th>{html.escape(corner)}</th>{foot}</tr></tbody></table>"
        )
    return [*parts, "</div>"]


def _colours(surface: TuningSurface) -> list[tuple[str, str]]:
    """Background and text colour of each point."""
    from matplotlib import colormaps

    logarithm = np.log(np.maximum(surface.sse, 1e-12))
    finite = logarithm[np.isfinite(logarithm)]
    low, high = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 1.0)
    shares = (np.nan_to_num(logarithm, nan=high, posinf=high) - low) / max(high - low, 1e-9)
    grounds = colormaps["viridis_r"](shares)[:, :3]
    luminance = grounds @ np.array([0.2126, 0.7152, 0.0722])
    return [
        (f"rgb({', '.join(f'{255 * part:.0f}' for part in ground)})", "#fff" if light < _DARK else "#000")
        for ground, light in zip(grounds, luminance, strict=True)
    ]


def _cell(
    surface: TuningSurface, marks: Mapping[str, MPCTuning | None], colours: Sequence[tuple[str, str]], cell: Cell
) -> str:
    if cell.point is None:
        told = _WITHOUT_NUMBER[cell.kind] + (f": {cell.reason}" if cell.reason else "")
        return f"<td class='{cell.kind.replace(' ', '-')}' title='{html.escape(told)}'></td>"
    point, tuning = cell.point, surface.tunings[cell.point]
    if not np.isfinite(surface.sse[point]):
        return f"<td class='refused' title='{tuning_text(tuning)}: glucose left the finite numbers'></td>"
    kind = "breaks" if not surface.feasible[point] else "oscillates" if surface.oscillates[point] else "kept"
    ground, ink = colours[point]
    told = ", ".join(
        [
            f"{tuning_text(tuning)}: SSE {surface.sse[point]:.4g} (mg/dl)²",
            f"undershoot {surface.undershoot_mg_dl[point]:.1f} mg/dl",
            f"settling {surface.settling_2pct_min[point]:.0f}{'' if surface.settled_2pct[point] else '+'} min",
            *remarks(surface, point),
        ]
    )
    shown = "".join(f"<b>{mark}</b>" for mark, of in marks.items() if of == tuning)
    return (
        f"<td class='{kind}' style='background-color: {ground}; color: {ink}' title='{html.escape(told)}'>"
        f"{_short(float(surface.sse[point]))}{shown}</td>"
    )


def _short(value: float) -> str:
    """Text of a number with three significant digits, without an exponent in the usual range."""
    return f"{value:.0f}" if 100.0 <= value < 1e7 else f"{value:.3g}"


def _legend() -> str:
    swatches = {
        "breaks": "breaks a constraint",
        "oscillates": "oscillates",
        "refused": "no controller, or no finite number",
        "impossible": _WITHOUT_NUMBER["impossible"],
    }
    items = [f"<span><i class='{kind}'></i>{html.escape(text)}</span>" for kind, text in swatches.items()]
    items += [f"<span><b>{mark}</b> {name}</span>" for name, mark in _MARKS.items()]
    return f"<p class='marks'>{''.join(items)}</p>"


def _list(surface: TuningSurface, printed: TuningRank) -> str:
    columns = "".join(
        f"<th scope='col' class='value'>{html.escape(name)}{'<br>' * bool(unit)}{html.escape(unit)}</th>"
        if name
        else "<th scope='col'>Remarks</th>"
        for name, unit in heads(surface)
    )
    lines = []
    for row in tuning_rows(surface, printed, MOST_ROWS):
        *numbers, remark = row.cells
        cells = "".join(f"<td class='value'>{html.escape(cell)}</td>" for cell in numbers)
        mark = " class='printed'" if surface.tunings[row.point] == printed.tuning else ""
        lines.append(f"<tr{mark}>{cells}<td>{html.escape(remark)}</td></tr>")
    points = len(surface.tunings)
    shown = f"The first {MOST_ROWS} of {points} tunings" if points > MOST_ROWS else f"All {points} tunings"
    return (
        f"<h2>Tunings</h2><p>{shown}, acceptable ones first, from the least sum of squared errors on. "
        "Settling with a plus: not settled at the end.</p>"
        + _page.scrolling(
            f'<table class="list"><thead><tr>{columns}</tr></thead><tbody>{"".join(lines)}</tbody></table>', "Tunings"
        )
    )


_STYLE: Final = """
h2 { margin-top: 1.8rem; }
.marks span { display: inline-block; margin-right: 1.2rem; }
.marks i { display: inline-block; width: 1.1em; height: 1.1em; margin-right: 0.4em; vertical-align: -0.2em; }
.panels { display: flex; flex-wrap: wrap; gap: 1rem 2rem; }
.cells { border-collapse: separate; border-spacing: 1px; font-size: 0.75rem; }
.cells caption { text-align: left; padding: 0.2rem 0; font-weight: 600; }
.cells th { padding: 0.1rem 0.3rem; text-align: center; color: inherit; white-space: nowrap; }
.cells td { padding: 0.25rem 0.2rem; min-width: 2.4rem; text-align: center; white-space: nowrap; }
.cells b, .marks b { font-weight: normal; margin-left: 0.15em; }
td.breaks, i.breaks { background-image:
  repeating-linear-gradient(45deg, transparent 0 4px, rgba(0, 0, 0, 0.45) 4px 5px),
  repeating-linear-gradient(-45deg, transparent 0 4px, rgba(0, 0, 0, 0.45) 4px 5px); }
td.oscillates, i.oscillates { background-image:
  repeating-linear-gradient(-45deg, transparent 0 4px, rgba(0, 0, 0, 0.45) 4px 5px); }
i.breaks, i.oscillates { background-color: #9bbf6a; }
td.refused, i.refused, td.not-tried { background: radial-gradient(#555 1px, #bbb 1.5px) 0 0 / 6px 6px; }
td.impossible, i.impossible { background: rgba(128, 128, 128, 0.2); }
.list td, .list th { padding-right: 1.1rem; }
.list td { white-space: nowrap; }
.list tr.printed td { font-weight: 600; }
@media (max-width: 44rem) { /* colours alone; the numbers are in the list below */
  .cells { width: 100%; table-layout: fixed; }
  .cells td { min-width: 0; padding: 0; height: 1.4rem; font-size: 0; }
  .cells td b { font-size: 0.8rem; }
  .cells th { font-size: 0.65rem; padding: 0; overflow: hidden; }
  .list { font-size: 0.7rem; } .list td, .list th { padding-right: 0.35rem; } .list th { font-size: 0.62rem; }
}
"""
