"""Report of the reproduction: one self-contained HTML page, and the same as Markdown and JSON."""

from __future__ import annotations

import base64
import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import glucoloop
from glucoloop.papers.parker1999.comparison import ComparedEntry, Reproduced, count, left_out
from glucoloop.papers.parker1999.experiments import PointResults
from glucoloop.papers.parker1999.figures import CAPTIONS
from glucoloop.papers.parker1999.published import INTERPRETATIONS, reason_for
from glucoloop.report.template import FOOTER, render

TITLE: Final = "Parker, Doyle and Peppas (1999), reproduced"
_SECTIONS: Final = (
    ("Table I: disturbance rejection without noise", "table-1."),
    ("Table II: dead time, with noise", "table-2."),
    ("Figures and claims of the text", ("figure-", "claim.")),
    ("Patient, model and identification", "model."),
    ("Tunings", "tuning."),
)
_CELLS: Final = (
    "In each cell: the result, its difference from the printed number, and whether it agrees. Spread: it agrees only "
    "because the printed number lies within the spread of the seeds. Input: the printed number was put in, so that it "
    "cannot but agree."
)
_NUMBERS: Final = {name: str(number) for number, name in enumerate(INTERPRETATIONS, 1)}
"""Numbers of the interpretations, by which the rows name them."""


@dataclass(frozen=True)
class Table:
    """Rows of text under a heading."""

    heading: str
    note: str
    columns: Sequence[str]
    rows: Sequence[Sequence[str]]


def tables(rows: Sequence[ComparedEntry], studies: Mapping[str, PointResults]) -> list[Table]:
    """Tables of the printed entries; those of experiments that were not carried out are left out."""
    shown: list[Table] = []
    for heading, beginning in _SECTIONS:
        cells = [
            (
                row.entry.what,
                f"{_printed(row)} {row.entry.unit}".strip(),
                *(_found(row, point) for point in studies),
                f"p. {row.entry.page}, {row.entry.place}",
                ", ".join(_NUMBERS[name] for name in row.entry.interpretations),
            )
            for row in rows
            if row.entry.id.startswith(beginning) and row.reproduced
        ]
        if cells:
            columns = ("Entry", "Printed", *studies, "Place", "Interpretations")
            shown.append(Table(heading, "" if shown else _CELLS, columns, cells))
        if cells and beginning == "table-2." and any(study.identified_anew for study in studies.values()):
            shown.append(_known_dead_times(studies))
    return shown


def _printed(row: ComparedEntry) -> str:
    printed = row.entry.printed
    text = printed if isinstance(printed, str) else f"{printed:g}"
    return f"at most {text}" if row.entry.kind == "at-most" else text


def _found(row: ComparedEntry, point: str) -> str:
    """The result at an operating point, its difference from the printed number, and whether it agrees."""
    found, difference = row.reproduced.get(point), row.difference(point)
    if found is None:
        return "not run"
    if row.agrees_by_spread(point):
        verdict = "spread"
    elif row.agrees(point):
        verdict = "input" if point in row.entry.input_at else "yes"
    else:
        verdict = "no"
    return "; ".join([found.text, *([] if difference is None else [f"{difference:+.2f}"]), verdict])


def _known_dead_times(studies: Mapping[str, PointResults]) -> Table:
    rows = []
    for point, study in studies.items():
        for dead_time, anew in study.identified_anew.items():
            both = study.runs["mpc", dead_time], anew
            rows.append((point, dead_time, *(Reproduced.of(runs.metrics.undershoot_mg_dl).text for runs in both)))
    return Table(
        "Linear MPC told of its dead time in two ways: undershoot, mg/dl",
        "The paper identifies a new model from delayed records. Two Laguerre functions cannot hold leading zeros, so "
        "such a model counts on a response that has not begun; shifting the model of the undelayed patient is nearer "
        "to the printed rows, and is what Table II above shows.",
        ("Operating point", "Dead time", "Model shifted", "Model identified anew"),
        rows,
    )


def closing_tables(rows: Sequence[ComparedEntry]) -> list[Table]:
    """Tables of the entries that do not reproduce, and of the interpretations that the rows rest on."""
    if not rows:
        return []
    failed = [
        (row.entry.what, _printed(row), point, found.text, reason_for(row.entry.id, point) or "not known")
        for row in rows
        for point, found in row.reproduced.items()
        if row.agrees(point) is False
    ]
    used = {name for row in rows for name in row.entry.interpretations}
    return [
        Table(
            "What does not reproduce",
            "A number agrees if it is within a tenth of the printed one, or if the printed one lies between the 10th "
            "and the 90th percentile over the seeds, which the tables mark with the word spread; a bound agrees if it "
            "is kept. Everything else is listed here, at each operating point, with the reason where one is known.",
            ("Entry", "Printed", "Operating point", "Reproduced", "Reason"),
            failed,
        ),
        Table(
            "Interpretations",
            "What the paper leaves open, and how it is read here; rows name by number what they rest on.",
            ("Number", "Name", "Choice"),
            [(_NUMBERS[name], name, choice) for name, choice in INTERPRETATIONS.items() if name in used],
        ),
    ]


def _summary(rows: Sequence[ComparedEntry], studies: Mapping[str, PointResults], seed: int) -> list[str]:
    sentences = []
    for point, study in studies.items():
        if any(row.agrees(point) is not None for row in rows):
            noisy = any(situation.rstrip("M").isdigit() for _, situation in study.runs)
            seeds = f" Noisy entries are medians over {study.seeds} seeds, with the 10th and 90th percentile."
            sentences.append(f"At {point}, {count(rows, point)}.{seeds if noisy else ''}")
    return [*sentences, *filter(None, [left_out(rows)]), f"glucoloop {glucoloop.__version__}, seed {seed}."]


def json_report(rows: Sequence[ComparedEntry], studies: Mapping[str, PointResults], seed: int) -> dict[str, Any]:
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
        "interpretations": INTERPRETATIONS,
    }


def markdown_report(
    rows: Sequence[ComparedEntry],
    studies: Mapping[str, PointResults],
    seed: int,
    figures: Mapping[tuple[str, str], bytes],
) -> str:
    """The report as Markdown, beside the files of the figures."""
    parts = [f"# {TITLE}", *_summary(rows, studies, seed)]
    parts += [f"![{CAPTIONS[name]} ({point})]({point}-{name}.svg)" for point, name in figures]
    for table in [*tables(rows, studies), *closing_tables(rows)]:
        lines = [table.columns, [":---"] * len(table.columns), *table.rows]
        text = "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines)
        parts += [f"## {table.heading}", *filter(None, [table.note]), text if table.rows else "Nothing."]
    return "\n\n".join([*parts, FOOTER]) + "\n"


def html_report(
    rows: Sequence[ComparedEntry],
    studies: Mapping[str, PointResults],
    seed: int,
    figures: Mapping[tuple[str, str], bytes],
) -> str:
    """The report as one page; `figures` are SVG files by operating point and name."""
    return render(
        Path(__file__).with_name("page.html"),
        TITLE,
        sentences=_summary(rows, studies, seed),
        tables=tables(rows, studies),
        figures=[
            (f"{CAPTIONS[name]} At {point}.", base64.b64encode(svg).decode()) for (point, name), svg in figures.items()
        ],
        closing_tables=closing_tables(rows),
    )
