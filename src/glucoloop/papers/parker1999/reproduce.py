"""The whole reproduction, or some tables and figures of it: run, compare, draw and write."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from glucoloop.papers.parker1999.comparison import ComparedEntry, compare
from glucoloop.papers.parker1999.experiments import (
    DEAD_TIMES_MIN,
    NOISE_FREE,
    Experiment,
    PointResults,
    Progress,
    all_experiments,
    noisy_runs,
    study,
)
from glucoloop.papers.parker1999.figures import CAPTIONS, draw
from glucoloop.papers.parker1999.options import Reproduction
from glucoloop.papers.parker1999.pages import html_report, json_report, markdown_report
from glucoloop.patients import OPERATING_POINTS
from glucoloop.refusal import Refusal
from glucoloop.report.print_figure import KINDS, figure_bytes

QUICK_DEAD_TIMES_MIN: Final = (0, 5)


@dataclass(frozen=True)
class PaperPart:
    """A table or figure of the paper, or several together."""

    experiments: frozenset[Experiment]
    entries: tuple[str, ...] = ()
    """Beginnings of the names of its printed numbers; empty where it has no numbers."""
    figures: tuple[str, ...] = ()
    """Names of figures, as in `figures.CAPTIONS`."""


WHOLE: Final = PaperPart(all_experiments(), entries=("",), figures=tuple(CAPTIONS))
TABLES: Final = {
    "I": PaperPart(frozenset({NOISE_FREE}), entries=("table-1.",)),
    "II": PaperPart(noisy_runs(), entries=("table-2.",)),
}
FIGURES: Final = {
    "2": PaperPart(frozenset({"model"}), figures=("figure-2",)),
    "3": PaperPart(frozenset({"model"}), entries=("model.validation.",), figures=("figure-3",)),
    "4": PaperPart(noisy_runs((0,)), entries=("figure-4.",), figures=("figure-4",)),
    "5": PaperPart(frozenset({NOISE_FREE}), figures=("figure-5",)),
    "6": PaperPart(frozenset(("mpc", f"{minutes}") for minutes in DEAD_TIMES_MIN), figures=("figure-6",)),
}
_ARABIC: Final = {"1": "I", "2": "II"}


def chosen(tables: Sequence[str], figures: Sequence[str]) -> PaperPart:
    """The named tables and figures together; the whole paper if none is named."""
    parts = []
    for kind, names, known in (("table", tables, TABLES), ("figure", figures, FIGURES)):
        for name in names:
            key = name.strip().upper()
            key = _ARABIC.get(key, key) if kind == "table" else key
            if key not in known:
                raise Refusal(f"unknown {kind} {name!r}; the known ones are: {', '.join(known)}")
            parts.append(known[key])
    if not parts:
        return WHOLE
    return PaperPart(
        experiments=frozenset().union(*(part.experiments for part in parts)),
        entries=tuple(entry for part in parts for entry in part.entries),
        figures=tuple(figure for part in parts for figure in part.figures),
    )


def carry_out(
    asked: Reproduction, part: PaperPart, progress: Progress
) -> tuple[dict[str, PointResults], list[ComparedEntry]]:
    """Run what a part of the paper needs at each operating point, and compare the results with the printed numbers."""
    for name in asked.points:
        if name not in OPERATING_POINTS:
            raise Refusal(f"unknown operating point {name!r}; the known ones are: {', '.join(OPERATING_POINTS)}")
    experiments = part.experiments
    if asked.quick:
        experiments &= all_experiments(QUICK_DEAD_TIMES_MIN, tunings=False)
    studies = {
        name: study(name, experiments, seeds=asked.runs, seed=asked.seed, progress=progress) for name in asked.points
    }
    return studies, compare(studies, part.entries)


def write(
    write_file: Callable[[str, bytes | str], None],
    studies: Mapping[str, PointResults],
    rows: Sequence[ComparedEntry],
    seed: int,
    progress: Progress,
    figures: Sequence[str] = WHOLE.figures,
) -> None:
    """Write the named figures, and the report in three forms, by a function that is given the name and content."""
    svg = {}
    for point, one in studies.items():
        for name, figure in draw(one, figures).items():
            for kind in KINDS:
                drawn = figure_bytes(figure, kind)
                write_file(f"{point}-{name}.{kind}", drawn)
                if kind == "svg":
                    svg[point, name] = drawn
        progress(f"{point}: figures drawn")
    write_file("report.json", json.dumps(json_report(rows, studies, seed), indent=2, allow_nan=False) + "\n")
    write_file("report.md", markdown_report(rows, studies, seed, svg))
    write_file("report.html", html_report(rows, studies, seed, svg))
