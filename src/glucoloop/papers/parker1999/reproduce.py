"""The whole paper: run, compare, draw, write."""

from __future__ import annotations

import io
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

from glucoloop.papers.parker1999.comparison import Row, compare
from glucoloop.papers.parker1999.experiments import DEAD_TIMES_MIN, Progress, Study, study
from glucoloop.papers.parker1999.figures import draw
from glucoloop.papers.parker1999.pages import html_report, json_report, markdown_report
from glucoloop.patients import OPERATING_POINTS

SEEDS: Final = 60
QUICK_SEEDS: Final = 3
QUICK_DEAD_TIMES_MIN: Final = (0, 5)


def carry_out(
    operating_points: Sequence[str], *, seeds: int, seed: int, quick: bool, progress: Progress
) -> tuple[dict[str, Study], list[Row]]:
    """Run the experiments at each operating point and set the results beside the printed numbers.

    Raises
    ------
    ValueError
        For fewer than one seed, or an unknown operating point.
    """
    if seeds < 1:
        raise ValueError(f"{seeds} seeds are too few; give 1 or more")
    for name in operating_points:
        if name not in OPERATING_POINTS:
            raise ValueError(f"unknown operating point {name!r}; the known ones are: {', '.join(OPERATING_POINTS)}")
    dead_times = QUICK_DEAD_TIMES_MIN if quick else DEAD_TIMES_MIN
    studies = {
        name: study(name, seeds=seeds, seed=seed, dead_times_min=dead_times, tunings=not quick, progress=progress)
        for name in operating_points
    }
    return studies, compare(studies)


def write(folder: Path, studies: dict[str, Study], rows: list[Row], seed: int, progress: Progress) -> dict[str, Any]:
    """Write figures and reports into an existing folder.

    Returns
    -------
    dict
        The report as plain data, as it also stands in ``report.json``.
    """
    svg, paths = {}, {}
    for point, one in studies.items():
        (folder / point).mkdir()
        for name, figure in draw(one).items():
            text = io.StringIO()
            figure.savefig(text, format="svg")
            svg[f"{point}/{name}"] = text.getvalue()
            paths[f"{point}/{name}"] = f"{point}/{name}.svg"
            (folder / point / f"{name}.svg").write_text(text.getvalue(), encoding="utf-8")
            figure.savefig(folder / point / f"{name}.png")
        progress(f"{point}: figures drawn")
    report = json_report(rows, studies, seed)
    (folder / "report.json").write_text(json.dumps(report, indent=2, allow_nan=False) + "\n", encoding="utf-8")
    (folder / "report.md").write_text(markdown_report(rows, studies, seed, paths), encoding="utf-8")
    (folder / "report.html").write_text(html_report(rows, studies, seed, svg), encoding="utf-8")
    return report
