"""``glucoloop reproduce``: reproduction of a published study."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import typer

from glucoloop.cli.request import Output
from glucoloop.cli.screen import show, stages
from glucoloop.cli.telling import print_json, where_written

if TYPE_CHECKING:
    from collections.abc import Sequence

    from glucoloop.papers.parker1999.comparison import Row

PAPERS: Final = ("parker1999",)
_OPERATING_POINTS: Final = ("setpoint-81", "nominal-22", "fasting-81")
MOST_SEEDS: Final = 1000

HELP: Final = (
    "Reproduce a published study and compare each number with the printed one.\n\n"
    "parker1999: Parker, Doyle and Peppas, IEEE Trans. Biomed. Eng. 46(2), 1999. Every table, figure and claim, at "
    "each reading of its operating point; what does not reproduce is listed.\n\n"
    "  glucoloop reproduce parker1999 --out parker1999\n\n"
    "  glucoloop reproduce parker1999 --quick --out glimpse\n\n"
    "  glucoloop reproduce parker1999 --table II --figure 4 --out part"
)


def command(
    paper: Annotated[str, typer.Argument(help=f"The study: {', '.join(PAPERS)}.", metavar="PAPER")],
    operating_point: Annotated[
        list[str] | None,
        typer.Option("--operating-point", help="One of its operating points; repeat it for more.", show_default="all"),
    ] = None,
    table: Annotated[
        list[str] | None,
        typer.Option("--table", help="Only this table, I or II; repeat it for both.", metavar="N", show_default="all"),
    ] = None,
    figure: Annotated[
        list[str] | None,
        typer.Option("--figure", help="Only this figure, 2 to 6; repeat it for more.", metavar="N", show_default="all"),
    ] = None,
    seeds: Annotated[
        str | None, typer.Option(help="Runs of each noisy experiment.", metavar="N", show_default="60; quick: 3")
    ] = None,
    seed: Annotated[str, typer.Option(help="The same seed gives the same numbers.", metavar="N")] = "1",
    quick: Annotated[
        bool, typer.Option("--quick", help="A glimpse: few seeds, dead times to 5 min, no tuning searches.")
    ] = False,
    out: Annotated[str | None, typer.Option(help="Folder for report and figures.", metavar="DIR")] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace an earlier result in that folder.")] = False,
    json: Annotated[bool, typer.Option("--json", help="Print the report as one JSON object.")] = False,
) -> None:
    """Run every experiment, compare the results, write and print them."""
    if paper not in PAPERS:
        raise ValueError(f"unknown paper {paper!r}; the known ones are: {', '.join(PAPERS)}")
    points = list(dict.fromkeys(operating_point or _OPERATING_POINTS))
    for point in points:
        if point not in _OPERATING_POINTS:
            raise ValueError(f"unknown operating point {point!r}; the known ones are: {', '.join(_OPERATING_POINTS)}")
    from glucoloop.limits import LARGEST_SEED

    first = _whole("--seed", seed, 0, LARGEST_SEED - MOST_SEEDS)
    if out == "":
        raise ValueError("--out is empty; give a path")
    output = Output(out=None if out is None else Path(out), overwrite=overwrite, json=json, mmol=False)
    files: dict[str, str] = {}
    with output.folder() as folder, stages("Importing the simulator") as progress:
        from glucoloop.cli.compiled import keep_compiled
        from glucoloop.papers.parker1999.pages import json_report
        from glucoloop.papers.parker1999.parts import chosen
        from glucoloop.papers.parker1999.reproduce import QUICK_SEEDS, SEEDS, carry_out, write

        part = chosen(table or (), figure or ())
        if part is not None and not part.entries and output.out is None:
            raise ValueError("--figure without --out would show nothing; give --out and a folder for the picture")
        keep_compiled()
        runs = _whole("--seeds", seeds, 1, MOST_SEEDS) if seeds is not None else QUICK_SEEDS if quick else SEEDS
        studies, rows = carry_out(points, seeds=runs, seed=first, quick=quick, progress=progress, part=part)
        if folder is not None:
            write(folder.write, studies, rows, first, progress, part)
            files = folder.paths()
    if json:
        print_json(json_report(rows, studies, first), files, ())
        return
    if rows:
        _tell(rows, points)
    print(where_written(output.out, files))


def _whole(option: str, text: str, least: int, most: int) -> int:
    try:
        value = int(text)
    except ValueError:
        raise ValueError(f"{option} is {text!r}; give a whole number") from None
    if not least <= value <= most:
        raise ValueError(f"{option} is {text}; give a whole number from {least} to {most}")
    return value


def _tell(rows: Sequence[Row], points: Sequence[str]) -> None:
    from rich.table import Table

    from glucoloop.papers.parker1999.comparison import count

    table = Table(box=None, pad_edge=False)
    table.add_column("entry")
    table.add_column("printed", justify="right")
    for point in points:
        table.add_column(point, justify="right")
    for row in rows:
        found = (row.reproduced.get(point) for point in points)
        cells = (one.text if one else "" for one in found)
        printed = row.entry.printed
        table.add_row(row.entry.what, printed if isinstance(printed, str) else f"{printed:g}", *cells)
    show(table)
    for point in points:
        print(f"{point}: {count(rows, point)}.")
