"""The whole reproduction: run, compare, draw and write."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

from glucoloop.papers.parker1999.comparison import ComparedEntry, compare
from glucoloop.papers.parker1999.experiments import DEAD_TIMES_MIN, Experiments, PointResults, Progress, study
from glucoloop.papers.parker1999.figures import draw
from glucoloop.papers.parker1999.pages import html_report, json_report, markdown_report
from glucoloop.papers.parker1999.parts import PaperPart
from glucoloop.patients import OPERATING_POINTS
from glucoloop.refusal import Refusal
from glucoloop.report.print_figure import KINDS, figure_bytes

QUICK_DEAD_TIMES_MIN: Final = (0, 5)


def carry_out(
    operating_points: Sequence[str],
    *,
    seeds: int,
    seed: int,
    quick: bool,
    progress: Progress,
    part: PaperPart | None = None,
) -> tuple[dict[str, PointResults], list[ComparedEntry]]:
    """Run the experiments at each operating point and compare the results with the printed numbers.

    Without a `part` they are those of the whole paper; with one, only what it needs is run.

    Raises
    ------
    ValueError
        For fewer than one seed, or an unknown operating point.
    """
    if seeds < 1:
        raise Refusal(f"{seeds} seeds are too few; give 1 or more")
    for name in operating_points:
        if name not in OPERATING_POINTS:
            raise Refusal(f"unknown operating point {name!r}; the known ones are: {', '.join(OPERATING_POINTS)}")
    dead_times = QUICK_DEAD_TIMES_MIN if quick else DEAD_TIMES_MIN
    wanted = Experiments.of_paper() if part is None else part.experiments
    wanted = wanted.limited_to(dead_times, tunings=not quick)
    studies = {name: study(name, wanted, seeds=seeds, seed=seed, progress=progress) for name in operating_points}
    return studies, compare(studies) if part is None else compare(studies, part.entries)


def write(
    write_file: Callable[[str, bytes | str], None],
    studies: Mapping[str, PointResults],
    rows: Sequence[ComparedEntry],
    seed: int,
    progress: Progress,
    part: PaperPart | None = None,
) -> dict[str, Any]:
    """Write figures and reports.

    Parameters
    ----------
    write_file : callable
        Function that writes a file, given its name and content.
    studies, rows, seed, part
        Arguments and results of `carry_out`.
    progress : callable
        Called with the name of the step that has just been done.

    Returns
    -------
    dict
        The report as plain data, as it also stands in ``report.json``.
    """
    inline, files = {}, {}
    for point, one in studies.items():
        for name, figure in draw(one, None if part is None else part.figures).items():
            files[f"{point}/{name}"] = f"{point}-{name}.svg"
            for kind in KINDS:
                drawn = figure_bytes(figure, kind)
                write_file(f"{point}-{name}.{kind}", drawn)
                if kind == "svg":
                    inline[f"{point}/{name}"] = drawn.decode()
        progress(f"{point}: figures drawn")
    report = json_report(rows, studies, seed)
    write_file("report.json", json.dumps(report, indent=2, allow_nan=False) + "\n")
    write_file("report.md", markdown_report(rows, studies, seed, files))
    write_file("report.html", html_report(rows, studies, seed, inline))
    return report
