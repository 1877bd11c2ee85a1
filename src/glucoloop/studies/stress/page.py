"""Self-contained page of a stress test: one file that needs neither network nor script."""

from __future__ import annotations

import html
from typing import Final

from glucoloop.parts.faults import FAULTS
from glucoloop.report import _page
from glucoloop.report._page import Repeat, count, scrolling, section
from glucoloop.report.fault_words import settings_in_words, when_in_words
from glucoloop.studies.stress._cells import QUANTITIES, Shade, grouped, legend_shades, shade_of, short_pct
from glucoloop.studies.stress._grid import GUARDS, Grid, grid_of, people_of
from glucoloop.studies.stress._style import STYLE
from glucoloop.studies.stress._words import failing, left_out, numbers_told, verdict, worse_told
from glucoloop.studies.stress.stress import MOST_MORE_PCT, StressResult, StressRow

_FILES: Final = {"stress.csv": "all numbers of each cell", "summary.json": "the same, with the reasons"}
"""Files with the data of a test, beside its page."""


def stress_page(result: StressResult, *, title: str = "Stress test") -> str:
    """A stress test as a self-contained HTML page.

    The page holds the conclusions in words; a map of faults and controllers, without and with the guard; for each
    failed cell the person and the reason; all numbers; a description of each fault; and the command that repeats the
    test.

    Parameters
    ----------
    result : StressResult
    title : str

    Returns
    -------
    str
        HTML; labels and the title are shown as they are, whatever they hold.

    Raises
    ------
    ValueError
        If there are no rows, or they do not make a grid.
    """
    grid = grid_of(result)
    sections = [
        _lead(result, grid),
        section("Conclusions", "", _paragraphs([*left_out(result), *verdict(grid)]), "verdict"),
        _map(grid),
        _why(result, grid),
        _all(grid),
        _faults(grid),
        _page.situation(result.facts, Repeat(result.repeat, result.keys, _FILES, given=result.given)),
    ]
    return _page.page(title, "\n".join(part for part in sections if part), STYLE)


def _text(told: str) -> str:
    return html.escape(told)


def _paragraphs(texts: list[str]) -> str:
    return "\n".join(f"<p>{_text(told)}</p>" for told in texts)


def _lead(result: StressResult, grid: Grid) -> str:
    people, faults = people_of(result), len(grid.faults) - 1
    controllers = len(grid.controllers)
    told = (
        f"{controllers} {'controller' if controllers == 1 else 'controllers'}, "
        f"{' and '.join(GUARDS[guarded] for guarded in grid.guards)}, under {faults} "
        f"{'fault' if faults == 1 else 'faults'}, each alone, on the same {count(people)} virtual "
        f"{'person' if people == 1 else 'people'}."
    )
    return f'<p class="lead">{told}</p>'


def _map(grid: Grid) -> str:
    caption = (
        "Each cell shows the percentage of the time below 60 mg/dl of the person with the longest such time. A "
        "triangle with a number shows how many people were worse off: with the fault, they spent over "
        f"{MOST_MORE_PCT:g} % more of the time below 60 mg/dl than without it, with the same controller."
    )
    across = len(grid.controllers)
    gap = '<col class="gap">'
    columns = gap.join([f'<col span="{across}">'] * len(grid.guards))
    guards = '<td class="gap" rowspan="2"></td>'.join(
        f'<th scope="colgroup" class="guard" colspan="{across}">{GUARDS[guarded].capitalize()}</th>'
        for guarded in grid.guards
    )
    heads = "".join(f'<th scope="col">{_text(controller)}</th>' for controller in grid.controllers) * len(grid.guards)
    lines = []
    for fault in grid.faults:
        cells = '<td class="gap"></td>'.join(
            "".join(_cell(grid, grid.row(controller, guarded, fault)) for controller in grid.controllers)
            for guarded in grid.guards
        )
        lines.append(f'<tr><th scope="row" title="{_text(fault)}">{_text(grid.names[fault])}</th>{cells}</tr>')
    body = "</tbody>\n<tbody>".join(["\n".join(part) for part in (lines[:1], lines[1:]) if part])
    cells_across = across * len(grid.guards)
    table = (
        f'<table class="heat" style="--cells: {cells_across}">\n'
        f'<colgroup><col class="fault">{columns}</colgroup>\n'
        f'<thead><tr><th scope="col" rowspan="2" class="fault">Fault</th>{guards}</tr><tr>{heads}</tr></thead>\n'
        f"<tbody>{body}</tbody></table>"
    )
    title = "Longest time of any person below 60 mg/dl"
    return section(title, caption, f"{_scale(grid)}\n{scrolling(table, title)}")


def _scale(grid: Grid) -> str:
    keys = "".join(
        f"<span><span {_look(shade, 'key')}></span>{shade.words}</span>" for shade in legend_shades(grid.rows.values())
    )
    return f'<div class="scale">{keys}<span>▲ people worse off than without the fault</span></div>'


def _look(shade: Shade, *kinds: str) -> str:
    classes = " ".join([*kinds, *([] if shade.colour else ["none"])])
    style = f'style="background: {shade.colour}; color: {shade.ink}"' if shade.colour else ""
    return f'class="{classes}" {style}'.rstrip()


def _cell(grid: Grid, row: StressRow) -> str:
    worse = f"<small>▲{len(row.worse)}</small>" if row.worse else ""
    return (
        f'<td {_look(shade_of(row))} title="{_text(_hover(grid, row))}">{short_pct(row.below_60_worst_pct)}{worse}</td>'
    )


def _hover(grid: Grid, row: StressRow) -> str:
    lines = [f"{row.tried.controller}, {grid.told(row.tried)}, {GUARDS[row.tried.guarded]}"]
    for group, quantities in grouped():
        lines.append(f"{group}: {', '.join(f'{quantity.name} {quantity.of(row)}' for quantity in quantities)}")
    return "\n".join(lines)


def _why(result: StressResult, grid: Grid) -> str:
    """Reasons for failures with the guard; without it a failure is expected."""
    rows = failing(grid, guarded=True) if True in grid.guards else []
    if not rows:
        return ""
    caption = (
        "Every controller and fault with which at least one person was worse off in spite of the guard, and what "
        "happened to the person affected most. People are listed by their numbers in the population, the one affected "
        "most first."
    )
    reasons = {reason.tried: reason for reason in result.reasons}
    parts = []
    for row in rows:
        reason = reasons.get(row.tried)
        told = (
            f"<p>Person {reason.person}: {_text(reason.text)}</p>" if reason else "<p>The reason was not examined.</p>"
        )
        parts.append(
            f"<dt>{_text(row.tried.controller)}<span>{_text(grid.told(row.tried))}</span></dt>"
            f"<dd>{told}<p>{worse_told(row)}: {numbers_told(row)}</p></dd>"
        )
    body = "\n".join(parts)
    return section("Who was worse off, and why", caption, f'<dl class="why">\n{body}\n</dl>')


def _all(grid: Grid) -> str:
    groups = "".join(
        f'<th scope="colgroup" class="group part" colspan="{len(quantities)}">{_text(group)}</th>'
        for group, quantities in grouped()
    )
    heads = "".join(
        f'<th scope="col" class="{_part(place)}">{_text(quantity.name)}</th>'
        for place, quantity in enumerate(QUANTITIES)
    )
    head = (
        f'<thead><tr><th scope="col" rowspan="2">Fault</th><th scope="col" rowspan="2" class="guard">Guard</th>{groups}'
        f"</tr><tr>{heads}</tr></thead>"
    )
    tables = [
        f"<h3>{_text(controller)}</h3>\n"
        + scrolling(
            f"<table>\n{head}\n" + "\n".join(_rows(grid, controller, fault) for fault in grid.faults) + "</table>",
            f"All numbers of {controller}",
        )
        for controller in grid.controllers
    ]
    caption = (
        "Times are percentages of the run: the mean over the people, and the largest value of any person (worst). Ever "
        "below: the percentage of people whose glucose fell below that value at any time. Events: periods of 15 min or "
        "longer below 70 mg/dl (low) or 54 mg/dl (very low), summed over all people. Samples: percentages of the "
        "samples of all people. Worse off: the number of people as in the map above, and the largest increase of the "
        "time below 60 mg/dl of any person."
    )
    return section("All numbers", caption, "\n".join(tables), "all")


def _rows(grid: Grid, controller: str, fault: str) -> str:
    pair = grid.pair(controller, fault)
    lines = []
    for place, row in enumerate(pair):
        name = f'<th scope="row" rowspan="{len(pair)}">{_text(grid.names[fault])}</th>' if place == 0 else ""
        cells = "".join(
            f'<td class="value {_part(column)}{" worse" * _is_worse(column, row)}">{_text(quantity.of(row))}</td>'
            for column, quantity in enumerate(QUANTITIES)
        )
        lines.append(f'<tr>{name}<td class="guard">{"with" if row.tried.guarded else "without"}</td>{cells}</tr>')
    return f"<tbody>{''.join(lines)}</tbody>"


def _is_worse(column: int, row: StressRow) -> bool:
    return not row.stands and QUANTITIES[column].group == "Worse off"


def _part(column: int) -> str:
    """CSS class of the first column of a group."""
    return "part" if column == 0 or QUANTITIES[column - 1].group != QUANTITIES[column].group else ""


def _faults(grid: Grid) -> str:
    if not grid.faults[1:]:
        return ""
    lines = []
    for text in grid.faults[1:]:
        fault = FAULTS.choose(text)
        lines.append(
            f'<tr><th scope="row">{_text(grid.names[text])}</th><td>{fault.part}</td>'
            f"<td>{_text(fault.summary)}</td><td>{_text(settings_in_words(fault))}</td>"
            f"<td>{_text(when_in_words(fault))}</td></tr>"
        )
    heads = "".join(f'<th scope="col">{head}</th>' for head in ("Fault", "Part", "What happens", "Settings", "When"))
    table = f"<table>\n<thead><tr>{heads}</tr></thead>\n<tbody>{''.join(lines)}</tbody></table>"
    body = scrolling(table, "The faults")
    return section(
        "The faults",
        "A fault without a fixed time begins at a random time, which is drawn for each person; all times are equally "
        "likely.",
        body,
        "faults",
    )
