"""Report of the reproduction: one self-contained HTML page, and the same as Markdown and JSON."""

from __future__ import annotations

import html
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from string import Template
from typing import Any, Final

import glucoloop
from glucoloop.papers.parker1999.comparison import ComparedEntry, Reproduced, count
from glucoloop.papers.parker1999.experiments import PointResults
from glucoloop.papers.parker1999.figures import CAPTIONS
from glucoloop.papers.parker1999.readings import READINGS
from glucoloop.report.page import FOOTER

TITLE: Final = "Parker, Doyle and Peppas (1999), reproduced"
_SECTIONS: Final = (
    ("Table I: disturbance rejection without noise", "table-1."),
    ("Table II: dead time, with noise", "table-2."),
    ("Figures and claims of the text", ("figure-", "claim.")),
    ("Patient, model and identification", "model."),
    ("Tunings", "tuning."),
)
_LONG: Final = 48  # characters, from which on a cell is given room
_VERDICTS: Final = {True: "yes", False: "no", None: ""}
_BY_SPREAD: Final = "spread"
_READING_NUMBERS: Final = {name: number for number, name in enumerate(READINGS, 1)}


@dataclass(frozen=True)
class Table:
    """Rows of text under a heading."""

    heading: str
    note: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


def _row_text(row: ComparedEntry, points: Sequence[str]) -> tuple[str, ...]:
    cells = [row.entry.what, f"{_printed(row)} {row.entry.unit}".strip(), f"p. {row.entry.page}, {row.entry.place}"]
    for point in points:
        found, difference = row.reproduced.get(point), row.difference(point)
        cells += [
            found.text if found else "not run",
            "" if difference is None else f"{difference:+.2f}",
            _BY_SPREAD if row.agrees_by_spread(point) else _VERDICTS[row.agrees(point)],
        ]
    return (*cells, ", ".join(str(_READING_NUMBERS[name]) for name in row.entry.readings))


def _printed(row: ComparedEntry) -> str:
    printed = row.entry.printed
    text = printed if isinstance(printed, str) else f"{printed:g}"
    return f"at most {text}" if row.entry.kind == "at-most" else text


def _columns(points: Sequence[str]) -> tuple[str, ...]:
    found = [column for point in points for column in (point, "difference", "agrees")]
    return ("Entry", "Printed", "Place", *found, "Readings")


def _anew(studies: Mapping[str, PointResults]) -> Table:
    """Table of linear MPC with known dead times: model shifted, and model identified again."""
    rows = []
    for point, study in studies.items():
        for dead_time, anew in study.identified_anew.items():
            shifted = study.with_noise["mpc", dead_time].metrics.undershoot_mg_dl
            cells = (Reproduced.of(values).text for values in (shifted, anew.metrics.undershoot_mg_dl))
            rows.append((point, dead_time, *cells))
    return Table(
        heading="Linear MPC told of its dead time in two ways: undershoot, mg/dl",
        note=(
            "The paper identifies a new model from delayed records. Two Laguerre functions cannot hold leading zeros, "
            "so such a model counts on a response that has not begun; shifting the model of the undelayed patient is "
            "nearer to the printed rows, and is what Table II above shows."
        ),
        columns=("Operating point", "Dead time", "Model shifted", "Model identified anew"),
        rows=tuple(rows),
    )


def tables(rows: Sequence[ComparedEntry], studies: Mapping[str, PointResults]) -> list[Table]:
    """Every table of the report; those of experiments that were not carried out are left out."""
    made = []
    for heading, prefix in _SECTIONS:
        of_section = tuple(_row_text(row, list(studies)) for row in rows if row.entry.id.startswith(prefix))
        if of_section:
            made.append(Table(heading=heading, note="", columns=_columns(list(studies)), rows=of_section))
        if of_section and prefix == "table-2." and any(study.identified_anew for study in studies.values()):
            made.append(_anew(studies))
    return made


def tables_at_the_end(rows: Sequence[ComparedEntry]) -> list[Table]:
    """Tables of the entries that do not reproduce, and of the readings that the rows rest on."""
    if not rows:
        return []
    failed = tuple(
        (row.entry.what, _printed(row), point, found.text)
        for row in rows
        for point, found in row.reproduced.items()
        if row.agrees(point) is False
    )
    used = {name for row in rows for name in row.entry.readings}
    return [
        Table(
            heading="What does not reproduce",
            note=(
                "A number agrees if it is within a tenth of the printed one, or if the printed one lies between the "
                "10th and the 90th percentile over the seeds, which the tables mark with the word spread; a bound "
                "agrees if it is kept. Everything else is listed here, at each operating point."
            ),
            columns=("Entry", "Printed", "Operating point", "Reproduced"),
            rows=failed,
        ),
        Table(
            heading="Readings",
            note="What the paper leaves open, and how it is read here; rows name by number what they rest on.",
            columns=("Number", "Name", "Choice"),
            rows=tuple(
                (str(_READING_NUMBERS[name]), name, choice) for name, choice in READINGS.items() if name in used
            ),
        ),
    ]


def _summary(rows: Sequence[ComparedEntry], studies: Mapping[str, PointResults], seed: int) -> list[str]:
    lines = []
    for point, study in studies.items():
        if all(row.agrees(point) is None for row in rows):
            continue
        lines.append(f"At {point}, {count(rows, point)}.")
        if study.with_noise:
            lines[-1] += f" Noisy entries are medians over {study.seeds} seeds, with the 10th and 90th percentile."
    return [*lines, f"glucoloop {glucoloop.__version__}, seed {seed}."]


def json_report(rows: Sequence[ComparedEntry], studies: Mapping[str, PointResults], seed: int) -> dict[str, Any]:
    """The report as plain data."""
    return {
        "paper": "Parker, Doyle, Peppas 1999, IEEE Trans. Biomed. Eng. 46(2), 148-157",
        "glucoloop": glucoloop.__version__,
        "seed": seed,
        "seeds": {point: study.seeds for point, study in studies.items()},
        "entries": [
            {
                "id": row.entry.id,
                "what": row.entry.what,
                "printed": row.entry.printed,
                "kind": row.entry.kind,
                "unit": row.entry.unit,
                "page": row.entry.page,
                "place": row.entry.place,
                "readings": list(row.entry.readings),
                "reproduced": {
                    point: {
                        "median": found.median,
                        "p10": found.low,
                        "p90": found.high,
                        "unsettled": found.unsettled,
                        "difference": row.difference(point),
                        "agrees": row.agrees(point),
                        "agrees_by_spread": row.agrees_by_spread(point),
                    }
                    for point, found in row.reproduced.items()
                },
            }
            for row in rows
        ],
        "readings": READINGS,
    }


def markdown_report(
    rows: Sequence[ComparedEntry], studies: Mapping[str, PointResults], seed: int, figures: Mapping[str, str]
) -> str:
    """The report as Markdown; `figures` are paths by name."""
    parts = [f"# {TITLE}", *_summary(rows, studies, seed)]
    parts += [f"![{CAPTIONS[name.split('/')[-1]]} ({name.split('/')[0]})]({path})" for name, path in figures.items()]
    for table in [*tables(rows, studies), *tables_at_the_end(rows)]:
        lines = [table.columns, tuple("---" for _ in table.columns), *table.rows]
        text = "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines)
        parts += [f"## {table.heading}", *([table.note] if table.note else []), text if table.rows else "Nothing."]
    return "\n\n".join([*parts, FOOTER]) + "\n"


def html_report(
    rows: Sequence[ComparedEntry], studies: Mapping[str, PointResults], seed: int, figures: Mapping[str, str]
) -> str:
    """The report as one page; `figures` are SVG texts by name, ``operating-point/figure``."""
    parts = [f"<p>{html.escape(line)}</p>" for line in _summary(rows, studies, seed)]
    parts += [_html_table(table) for table in tables(rows, studies)]
    for name, svg in figures.items():
        point, figure = name.split("/")
        caption = f"{html.escape(CAPTIONS[figure])} <span>{html.escape(point)}</span>"
        parts.append(f"<figure>{_inline(svg, name)}<figcaption>{caption}</figcaption></figure>")
    parts += [_html_table(table) for table in tables_at_the_end(rows)]
    return _PAGE.substitute(title=html.escape(TITLE), body="\n".join(parts), footer=FOOTER)


def _inline(svg: str, name: str) -> str:
    """An SVG without its XML head, with ids made unique, so that they do not refer to another figure on the page."""
    body = svg[svg.index("<svg") :]
    own = "".join(letter if letter.isalnum() else "-" for letter in name)
    for mark in ('id="', 'href="#', "url(#"):
        body = body.replace(mark, f"{mark}{own}-")
    return body


def _html_table(table: Table) -> str:
    if not table.rows:
        body = "<p>Nothing.</p>"
    else:
        head = "".join(f"<th>{html.escape(column)}</th>" for column in table.columns)
        lines = "".join(f"<tr>{''.join(map(_html_cell, table.columns, row))}</tr>" for row in table.rows)
        body = f"<table><thead><tr>{head}</tr></thead><tbody>{lines}</tbody></table>"
    note = f"<p>{html.escape(table.note)}</p>" if table.note else ""
    return f"<section><h2>{html.escape(table.heading)}</h2>{note}{body}</section>"


def _html_cell(column: str, cell: str) -> str:
    """A cell that names its column, for a narrow screen, where the head of the table is not shown."""
    kind = "long" if len(cell) > _LONG else cell if cell in ("yes", "no") else ""
    mark = f' class="{kind}"' if kind else ""
    return f'<td{mark} data-column="{html.escape(column)}">{html.escape(cell)}</td>'


_PAGE: Final = Template("""<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>$title</title>
<style>
:root { color-scheme: light dark; --line: #8886; --yes: #00855b; --no: #c04a00; }
body { font: 16px/1.5 system-ui, sans-serif; margin: 2rem auto; max-width: 92rem; padding: 0 1rem; }
h1 { font-size: 1.6rem; } h2 { font-size: 1.15rem; margin-top: 2.5rem; }
table { border-collapse: collapse; font-size: .82rem; font-variant-numeric: tabular-nums; }
th, td { text-align: left; vertical-align: top; padding: .3rem .7rem .3rem 0; border-bottom: 1px solid var(--line); }
th:last-child, td:last-child { padding-right: 0; }
td.long { min-width: 16rem; }
.yes { color: var(--yes); } .no { color: var(--no); font-weight: 600; }
figure { margin: 2rem 0; background: white; color: black; padding: 1rem; border-radius: .4rem; max-width: 46rem; }
figure svg { width: 100%; height: auto; }
figcaption { font-size: .85rem; } figcaption span { color: #666; }
footer { margin-top: 3rem; color: #777; font-size: .85rem; }
@media (max-width: 60rem) { /* one column: every row is a list, every cell says of what it is */
  thead { display: none; }
  tbody, tr, td { display: block; border: 0; }
  tr { padding: .5rem 0; border-bottom: 1px solid var(--line); }
  td, td.long { display: grid; grid-template-columns: 8rem 1fr; min-width: 0; padding: .1rem 0; }
  td:empty { display: none; }
  td::before { content: attr(data-column); color: #777; }
  figure { padding: .3rem; }
}
</style>
</head>
<body>
<h1>$title</h1>
$body
<footer>$footer</footer>
</body>
</html>
""")
