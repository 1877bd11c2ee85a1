"""``glucoloop reproduce``: reproduction of a published study."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from glucoloop.cli.command import Command
from glucoloop.cli.option import JSON, OUT, OVERWRITE, CommandOption, Given, options_of, reworded
from glucoloop.cli.request import request_of
from glucoloop.cli.screen import print_json, show, stage, where_written
from glucoloop.papers.parker1999.options import Reproduction
from glucoloop.refusal import Refusal
from glucoloop.situations.request import asked_for

if TYPE_CHECKING:
    from collections.abc import Sequence

    from glucoloop.papers.parker1999.comparison import ComparedEntry

PAPERS: Final = ("parker1999",)

HELP: Final = (
    "Reproduce a published study and compare each number with the printed one.\n\n"
    "parker1999: Parker, Doyle and Peppas, IEEE Trans. Biomed. Eng. 46(2), 1999. Every table, figure and claim is "
    "reproduced at each of three operating points that the paper can be read to mean; numbers that do not reproduce "
    "are listed with the reason where one is known.\n\n"
    "  glucoloop reproduce parker1999 --out parker1999\n\n"
    "  glucoloop reproduce parker1999 --quick --out glimpse\n\n"
    "  glucoloop reproduce parker1999 --table II --figure 4 --out part"
)


_OPTIONS: Final = (
    CommandOption("paper", "PAPER", f"The study: {', '.join(PAPERS)}.", metavar="PAPER"),
    *options_of(Reproduction),
    *reworded(
        (OUT, OVERWRITE, JSON),
        help={"out": "Folder for report and figures.", "json": "Print the report as one JSON object."},
    ),
)


def _reproduce(typed: Given) -> None:
    """Run every experiment, compare the results, write and print them."""
    paper = typed.pop("paper")
    if paper not in PAPERS:
        raise Refusal(f"unknown paper {paper!r}; the known ones are: {', '.join(PAPERS)}")
    request = request_of(typed, _OPTIONS)
    asked, output = asked_for(Reproduction, request.tree), request.output
    files: dict[str, str] = {}
    with output.folder() as folder, stage("Importing the simulator") as progress:
        from glucoloop.cli.compiled import keep_compiled
        from glucoloop.papers.parker1999.pages import json_report
        from glucoloop.papers.parker1999.reproduce import carry_out, chosen, write

        part = chosen(asked.table, asked.figure)
        if not part.entries and output.out is None:
            raise Refusal("--figure without --out would show nothing; give --out and a folder for the picture")
        keep_compiled()
        studies, rows = carry_out(asked, part, progress)
        if folder is not None:
            write(folder.write, studies, rows, asked.seed, progress, part.figures)
            files = folder.paths()
    if output.json:
        print_json(json_report(rows, studies, asked.seed), files)
        return
    if rows:
        _print_comparison(rows, asked.points)
    print(where_written(output.out, files))


def _print_comparison(rows: Sequence[ComparedEntry], points: Sequence[str]) -> None:
    from rich.table import Table

    from glucoloop.papers.parker1999.comparison import count, left_out

    table = Table(box=None, pad_edge=False)
    table.add_column("entry")
    table.add_column("printed", justify="right")
    for point in points:
        table.add_column(point, justify="right")
    for row in rows:
        if row.reproduced:
            printed = row.entry.printed
            cells = (row.reproduced[point].text if point in row.reproduced else "not run" for point in points)
            table.add_row(row.entry.what, printed if isinstance(printed, str) else f"{printed:g}", *cells)
    show(table)
    for point in points:
        print(f"{point}: {count(rows, point)}.")
    if missing := left_out(rows):
        print(missing)


REPRODUCE: Final = Command("reproduce", HELP, _OPTIONS, _reproduce)
