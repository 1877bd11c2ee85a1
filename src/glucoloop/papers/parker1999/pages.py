"""Report of the reproduction: one self-contained HTML page, and the same as Markdown and JSON."""

from __future__ import annotations

import base64
import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import glucoloop
from glucoloop.papers.entries import Reproduced, markdown_table
from glucoloop.papers.parker1999.comparison import count, left_out
from glucoloop.papers.parker1999.deviations import reason_for
from glucoloop.papers.parker1999.experiments import PointResults
from glucoloop.papers.parker1999.figures import CAPTIONS
from glucoloop.papers.parker1999.published import PrintedRow
from glucoloop.papers.parker1999.readings import READINGS
from glucoloop.report.template import FOOTER, render

TITLE: Final = "Parker, Doyle and Peppas (1999), reproduced"
_SECTIONS: Final = (
    ("Table I: disturbance rejection without noise", "table-1."),
    ("Table II: dead time, with noise", "table-2."),
    ("Figures and claims of the text", ("figure-", "claim.")),
    ("Patient, model and identification", "model."),
    ("Tunings", "tuning."),
)
_CELL: Final = (
    "In each cell: the result, its difference from the printed number, and whether it agrees. Spread: it agrees only "
    "because the printed number lies within the spread of the seeds. Input: the printed number was put in, so that it "
    "cannot but agree."
)
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


def _row_text(row: PrintedRow, points: Sequence[str]) -> tuple[str, ...]:
    found = (_found(row, point) for point in points)
    readings = ", ".join(str(_READING_NUMBERS[name]) for name in row.entry.readings)
    place = f"p. {row.entry.page}, {row.entry.place}"
    return (row.entry.what, f"{_printed(row)} {row.entry.unit}".strip(), *found, place, readings)


def _found(row: PrintedRow, point: str) -> str:
    """The result at an operating point, its difference from the printed number, and whether it agrees."""
    found, difference = row.reproduced.get(point), row.difference(point)
    if found is None:
        return "not run"
    verdict = _BY_SPREAD if row.agrees_by_spread(point) else _VERDICTS[row.agrees(point)]
    if verdict == "yes" and point in row.entry.input_at:
        verdict = "input"
    return "; ".join([found.text, *([] if difference is None else [f"{difference:+.2f}"]), verdict])


def _printed(row: PrintedRow) -> str:
    printed = row.entry.printed
    text = printed if isinstance(printed, str) else f"{printed:g}"
    return f"at most {text}" if row.entry.kind == "at-most" else text


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


def tables(rows: Sequence[PrintedRow], studies: Mapping[str, PointResults]) -> list[Table]:
    """Every table of the report; those of experiments that were not carried out are left out."""
    made: list[Table] = []
    for heading, prefix in _SECTIONS:
        chosen = [row for row in rows if row.entry.id.startswith(prefix) and row.reproduced]
        if chosen:
            columns = ("Entry", "Printed", *studies, "Place", "Readings")
            told = tuple(_row_text(row, list(studies)) for row in chosen)
            made.append(Table(heading=heading, note="" if made else _CELL, columns=columns, rows=told))
        if chosen and prefix == "table-2." and any(study.identified_anew for study in studies.values()):
            made.append(_anew(studies))
    return made


def tables_at_the_end(rows: Sequence[PrintedRow]) -> list[Table]:
    """Tables of the entries that do not reproduce, and of the readings that the rows rest on."""
    if not rows:
        return []
    failed = tuple(
        (row.entry.what, _printed(row), point, found.text, reason_for(row.entry.id, point) or "not known")
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
                "agrees if it is kept. Everything else is listed here, at each operating point, with the reason where "
                "one is known."
            ),
            columns=("Entry", "Printed", "Operating point", "Reproduced", "Reason"),
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


def _summary(rows: Sequence[PrintedRow], studies: Mapping[str, PointResults], seed: int) -> list[str]:
    lines = []
    for point, study in studies.items():
        if all(row.agrees(point) is None for row in rows):
            continue
        lines.append(f"At {point}, {count(rows, point)}.")
        if study.with_noise:
            lines[-1] += f" Noisy entries are medians over {study.seeds} seeds, with the 10th and 90th percentile."
    return [*lines, *filter(None, [left_out(rows)]), f"glucoloop {glucoloop.__version__}, seed {seed}."]


def json_report(rows: Sequence[PrintedRow], studies: Mapping[str, PointResults], seed: int) -> dict[str, Any]:
    """The report as plain data."""
    return {
        "paper": "Parker, Doyle, Peppas 1999, IEEE Trans. Biomed. Eng. 46(2), 148-157",
        "glucoloop": glucoloop.__version__,
        "seed": seed,
        "seeds": {point: study.seeds for point, study in studies.items()},
        "entries": [
            {
                **dataclasses.asdict(row.entry),
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
    rows: Sequence[PrintedRow],
    studies: Mapping[str, PointResults],
    seed: int,
    figures: Mapping[str, str],
) -> str:
    """The report as Markdown; `figures` are paths by name."""
    parts = [f"# {TITLE}", *_summary(rows, studies, seed)]
    parts += [f"![{CAPTIONS[name.split('/')[-1]]} ({name.split('/')[0]})]({path})" for name, path in figures.items()]
    for table in [*tables(rows, studies), *tables_at_the_end(rows)]:
        text = markdown_table(table.columns, table.rows) if table.rows else "Nothing."
        parts += [f"## {table.heading}", *([table.note] if table.note else []), text]
    return "\n\n".join([*parts, FOOTER]) + "\n"


def html_report(
    rows: Sequence[PrintedRow],
    studies: Mapping[str, PointResults],
    seed: int,
    figures: Mapping[str, str],
) -> str:
    """The report as one page; `figures` are SVG texts by name, ``operating-point/figure``."""
    shown = []
    for name, svg in figures.items():
        point, figure = name.split("/")
        shown.append((f"{CAPTIONS[figure]} At {point}.", base64.b64encode(svg.encode()).decode()))
    return render(
        Path(__file__).with_name("page.html"),
        TITLE,
        sentences=_summary(rows, studies, seed),
        tables=tables(rows, studies),
        figures=shown,
        tables_at_the_end=tables_at_the_end(rows),
    )
