"""``glucoloop query``: queries to a trial, in SQL."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from decimal import Decimal
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from glucoloop.cli.command import Command, CommandOption, Given
from glucoloop.cli.interrupts import leave_to_the_system
from glucoloop.cli.screen import note, print_rows, print_value, show
from glucoloop.refusal import Refusal

if TYPE_CHECKING:
    from glucoloop.trials.query import Answer

HELP: Final = (
    "Query the folder of a trial in SQL, in the dialect of DuckDB.\n\n"
    "Its tables are people (one row per person and controller), counts and bands (glucose and insulin over time), "
    "summary, and traces if they were kept; without a query their columns are listed. From a trial "
    "that is not finished, the finished shards are read. Nothing is written. "
    "A query ends at Ctrl-C.\n\n"
    "  glucoloop query trial 'select controller, avg(undershoot_mg_dl) from people group by all'\n\n"
    "  glucoloop query trial 'select corr(F_LC, minimum_mg_dl) from people' --json\n\n"
    "  glucoloop query trial 'from people where minimum_mg_dl < 54' --csv"
)
_MAX_SHOWN: Final = 1000
_LONGEST_CELL: Final = 10_000


def _query(typed: Given) -> None:
    """Run the query and print the answer."""
    folder, sql = str(typed["folder"]), typed.get("sql")
    if typed.get("json") and typed.get("csv"):
        raise Refusal("--json and --csv exclude one another; leave one out")
    if not folder:
        raise Refusal("DIR is empty; give the folder of a trial")
    from glucoloop.trials.query import VIEWS, Answer, trial_tables

    leave_to_the_system()
    with trial_tables(Path(folder)) as tables:
        if tables.done < tables.shards:
            note([f"{tables.done} of {tables.shards} shards are done; the answer is about these."])
        note(tables.notes)
        if sql is None and typed.get("json"):
            print_value(tables.views)
            return
        views = ((name, VIEWS[name], ", ".join(columns)) for name, columns in tables.views.items())
        answer = Answer(["Table", "What it holds", "Columns"], views) if sql is None else tables.query(sql)
        if typed.get("csv"):
            print_rows(answer.columns, answer.rows)
        elif typed.get("json"):
            plain = {"columns": answer.columns, "rows": list(answer.rows)}
            print_value(plain, lambda value: float(value) if isinstance(value, Decimal) else str(value))
        else:
            _print_table(answer)


def _print_table(answer: Answer) -> None:
    from rich import box
    from rich.table import Table

    from glucoloop.reporting.columns import FittingTable

    shown = list(itertools.islice(answer.rows, _MAX_SHOWN + 1))
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for position, name in enumerate(answer.columns):
        numbers = shown and isinstance(shown[0][position], int | float)
        table.add_column(name, justify="right" if numbers else "left")
    for row in shown[:_MAX_SHOWN]:
        table.add_row(*_cells(row))
    show(FittingTable(table))
    if not shown:
        note(["No row answers the question."])
    if len(shown) > _MAX_SHOWN:
        note([f"The first {_MAX_SHOWN} rows; --csv prints all."])
    if any(len(str(value)) > _LONGEST_CELL for row in shown for value in row):
        note([f"The first {_LONGEST_CELL} letters of a longer text; --csv prints it whole."])


def _cells(row: tuple[Any, ...]) -> Iterator[str]:
    for value in row:
        text = "" if value is None else f"{value:.6g}" if isinstance(value, float) else str(value)
        yield text if len(text) <= _LONGEST_CELL else f"{text[:_LONGEST_CELL]} ..."


QUERY: Final = Command(
    "query",
    HELP,
    (
        CommandOption("folder", "DIR", "The folder that glucoloop trial wrote.", metavar="DIR"),
        CommandOption("sql", "SQL", "One SELECT, PIVOT, DESCRIBE or SUMMARIZE.", metavar="SQL", required=False),
        CommandOption("json", "--json", "Print one JSON object: columns, and a list of rows."),
        CommandOption("csv", "--csv", "Print lines of comma-separated values, however many."),
    ),
    _query,
)
