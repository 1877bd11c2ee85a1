"""Tables of a study and of metrics: a number is declared once; files, JSON, terminal and page follow.

The value of a `Column` is a Polars expression over the people (or runs) of a cell, its heading and text are those of
the page, and `short` is its heading in the terminal. ``measured`` computes all columns of all cells, `terminal_table`
and the macro ``numbers`` of ``templates/parts.html`` show them. A `MetricRow` is a line of a table with a column for
each run; `lines_table` and the macro ``lines`` show them.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import polars as pl
from polars import selectors

from glucoloop.display_units import OTHERS, heading_shown, in_shown_units, other_number, shown_unit
from glucoloop.metrics.metric import Result, metrics_with
from glucoloop.refusal import Refusal
from glucoloop.reporting.labelled_traces import moment_text
from glucoloop.text import NOT_AVAILABLE, glucose_text
from glucoloop.text import percent as percent_text
from glucoloop.units import MIN_PER_DAY, UNIT_BY_ENDING, ending_of

if TYPE_CHECKING:
    from rich.console import Console, ConsoleOptions, RenderResult
    from rich.table import Table

    from glucoloop.bounds import Distance
    from glucoloop.metrics import Metrics

Row = Mapping[str, Any]
"""Values of a cell by the names of the columns."""
Line = tuple[str, Sequence[Row]]
"""Name of a line of a table, and the cells that stand side by side in it."""
_ANY_WIDTH: Final = 10_000
_OF_A_BOUND: Final = {
    "Largest deviation": "deviation_mg_dl",
    "Bound": "bound_mg_dl",
    "Distance to the bound": "distance_mg_dl",
}


def _percent(value: float) -> str:
    """Text of a percentage without its unit, where the heading has it."""
    return percent_text(value).removesuffix(" %")


def terse_percent(value: float) -> str:
    """Text of a percentage in at most four characters; a small value is not rounded to 0, nor a large one to 100."""
    if value in (0.0, 100.0):
        return f"{value:.0f}"
    if value < 0.05:
        return "<0.1"
    return f"{value:.1f}" if value < 9.95 else f"{min(value, 99.0):.0f}"


def whole_glucose(value: float) -> str:
    """Text of a concentration of glucose without decimals."""
    return glucose_text(value, 0)


def whole(value: float) -> str:
    """Text of a number without decimals, and without the sign of a negative zero."""
    return f"{value:z.0f}"


def decimals(digits: int) -> Callable[[float], str]:
    """Text of a number with so many decimals."""
    return lambda value: f"{value:z.{digits}f}"


@dataclass(frozen=True, kw_only=True)
class Column:
    """A number (or a text) of a cell."""

    name: str
    """Name in the files and in JSON."""
    value: pl.Expr | None = None
    """Value, from the people of the cell; None if it stands in the table already."""
    empty: Any = None
    """Value in a cell in which nobody is known."""
    group: str = ""
    head: str = ""
    """Heading on the page, below that of the group; without both the column is not shown there."""
    text: Callable[[Any], str] = _percent
    short: str | None = None
    """Heading in the terminal, with line breaks; without one the column is not shown there."""
    short_text: Callable[[Any], str] | None = None
    """Text in the terminal, if it is another."""
    left: bool = False
    """Whether it is aligned on the left, as a text is."""
    missing: Callable[[Row], str] = lambda row: NOT_AVAILABLE
    """Text where there is no number."""
    only: Callable[[Row], bool] = lambda row: True
    """Cells that have the number; in the terminal it is left out in the others."""
    strong: Callable[[Row], bool] = lambda row: False
    """Cells in which it is bold; in the terminal, the last of those side by side decides."""

    @property
    def unit(self) -> str:
        """Unit of the number, by its name."""
        return UNIT_BY_ENDING.get(ending_of(self.name), "")

    def value_text(self, row: Row) -> str:
        """Text of the number in a cell, on the page."""
        return self._text(row, self.text)

    def other_value_text(self, row: Row) -> str:
        """Text of the number in a cell, on the page, in the other unit of a quantity that has two."""
        return self._text(row, self.text, other=self.unit in OTHERS)

    def short_value_text(self, row: Row) -> str:
        """Text of the number in a cell, in the terminal, in the unit that is shown."""
        return self._text(row, self.short_text or self.text, other=shown_unit(self.unit) != self.unit)

    def _text(self, row: Row, text: Callable[[Any], str], *, other: bool = False) -> str:
        value = row[self.name]
        if value is None or (isinstance(value, float) and not math.isfinite(value)):
            return self.missing(row)
        return other_number(text(value), value, self.unit) if other else text(value)


def measured(people: pl.DataFrame, cells: pl.DataFrame, columns: Sequence[Column]) -> pl.DataFrame:
    """Every column of every cell, in the order of the cells.

    `people` has a row for each person (or run) of each cell, with the columns that name the cell; `cells` a row for
    each cell, with nothing but these columns.
    """
    by = cells.columns
    results = people.group_by(by, maintain_order=True).agg(
        [c.value.alias(c.name) for c in columns if c.value is not None]
    )
    results = results.with_columns(selectors.unsigned_integer().cast(pl.Int64))  # which is what counts are elsewhere
    joined = cells.join(results, on=by, how="left", maintain_order="left", nulls_equal=True)
    return joined.with_columns(
        pl.col(c.name).fill_null(c.empty) for c in columns if c.value is not None and c.empty is not None
    )


def headings(columns: Iterable[Column]) -> list[tuple[str, list[Column]]]:
    """The columns of the page below the headings that they share."""
    visible = [column for column in columns if column.group or column.head]
    return [(group, list(alike)) for group, alike in groupby(visible, lambda column: column.group)]


def terminal_table(
    head: str,
    sections: Sequence[tuple[str, Sequence[Line]]],
    columns: Sequence[Column],
    *,
    caption: str = "",
) -> FittingTable:
    """A table for the terminal, of the columns that have a heading for it.

    `head` stands above the names of the lines. Each section has a name, where an empty one is not shown, and its lines;
    the numbers of the cells of one line stand side by side, as in ``"25|2"``.
    """
    from rich import box
    from rich.table import Table
    from rich.text import Text

    visible = [column for column in columns if column.short is not None]
    caption_text = Text(in_shown_units(caption)) if caption else None
    table = Table(
        box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False, caption=caption_text, caption_justify="left"
    )
    titled = any(section for section, _ in sections)
    names = [name for _, lines in sections for name, _ in lines]
    word = max((len(word) for name in names for word in name.split()), default=0)
    table.add_column(head, vertical="bottom", overflow="fold", min_width=word + titled)
    lines = [rows for _, lines in sections for _, rows in lines]
    texts = {column.name: _side_by_side(column, lines) for column in visible}
    visible = [column for column in visible if any(texts[column.name])]
    for column in visible:
        table.add_column(
            Text(heading_shown(column.short or "")),
            justify="left" if column.left else "right",
            vertical="bottom",
            overflow="fold",
            min_width=max(len(line) for text in texts[column.name] for line in text.split("\n")),
        )
    place = 0
    for section, of_section in sections:
        if place:
            table.add_section()
        if section:
            # Text, since square brackets in a label would be taken for markup
            table.add_row(Text(section, "bold"))
        for name, rows in of_section:
            cells = (Text(texts[c.name][place], "bold" if c.strong(rows[-1]) else "") for c in visible)
            table.add_row(Text(f"{' ' if section else ''}{name}"), *cells)
            place += 1
    return FittingTable(table, (head, *map(_short_with_unit, visible)))


def _short_with_unit(column: Column) -> str:
    """Heading of a column of the terminal, with a unit also where the terminal has no room for it."""
    head, unit = heading_shown(column.short or ""), shown_unit(column.unit)
    return head if unit in head else f"{head}\n{unit}"


def _side_by_side(column: Column, lines: Sequence[Sequence[Row]]) -> list[str]:
    """Text of each line; the last numbers of the pairs stand below each other."""
    texts = [[column.short_value_text(row) for row in rows if column.only(row)] for rows in lines]
    width = max((len(cells[-1]) for cells in texts if len(cells) > 1), default=0)
    return [
        "|".join([*cells[:-1], f"{cells[-1]:>{width if len(cells) > 1 else 0}}"]) if cells else "" for cells in texts
    ]


@dataclass(frozen=True)
class FittingTable:
    """A table that leaves out whole columns where there is no room, since a cut number would be another number."""

    table: Table
    heads: Sequence[str] = ()
    """Headings with their units, for print; by default those of the table."""

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        from rich.measure import Measurement
        from rich.text import Text

        wide = options.update(width=_ANY_WIDTH)
        fitted = copy.copy(self.table)
        while len(fitted.columns) > 1 and Measurement.get(console, wide, fitted).minimum > options.max_width:
            fitted.columns = fitted.columns[:-1]
        left_out = len(self.table.columns) - len(fitted.columns)
        yield fitted
        if left_out:
            columns = "column is" if left_out == 1 else "columns are"
            yield Text(f"For want of room, {left_out} {columns} left out on the right.")


# ------------------------------------------------------------------------------------ metrics of runs side by side


class MetricRow(NamedTuple):
    """One metric of one run or several, also in the other unit if there is one; in the terminal with a `statistic`."""

    section: str
    name: str
    unit: str
    values: Sequence[str]
    other: Sequence[str] | None = None
    statistic: str = ""


def metric_rows(metrics: Mapping[str, Metrics], start_min: float = 0.0) -> list[MetricRow]:
    """Rows for runs by label, one value per run; a time that is only a lower bound ends in "+".

    The runs start `start_min` after midnight. Moments after the first day are days and clocks.
    """
    if not metrics:
        raise Refusal("there are no metrics to show; give those of at least one run")
    plain = [of_run.as_dict() for of_run in metrics.values()]
    rows = []
    for metric in metrics_with(next(iter(metrics.values())).further):
        for result in metric.results:
            if result.title and (not result.seldom or any(values[result.name] for values in plain)):
                texts = [_text(result, of_run) for of_run in plain]
                values = [of_run[result.name] for of_run in plain]
                unit, other = result.unit, in_other_unit(result, texts, values)
                latest_min = max((value for value in values if value is not None), default=0.0)
                if result.moment and latest_min > MIN_PER_DAY:
                    unit, texts = (
                        "",
                        [
                            text if value is None else moment_text(value, latest_min, start_min)
                            for text, value in zip(texts, values, strict=True)
                        ],
                    )
                rows.append(MetricRow(metric.section, result.title, unit, texts, other))
    return rows


def in_other_unit(result: Result, texts: Sequence[str], values: Sequence[float | None]) -> list[str] | None:
    """Texts of values in the other unit of their quantity; None if it has none."""
    if result.unit not in OTHERS:
        return None
    pairs = zip(texts, values, strict=True)
    return [other_number(text, (value or 0.0) / result.divisor, result.unit) for text, value in pairs]


def _text(result: Result, metrics: Mapping[str, float | int | bool | None]) -> str:
    """A value of one run as text."""
    value = metrics[result.name]
    if value is None or isinstance(value, bool):
        return NOT_AVAILABLE if value is None else "yes" if value else "no"
    least, fall = metrics["minimum_mg_dl"], metrics["undershoot_mg_dl"]
    setpoint = math.inf if least is None or fall is None else least + fall
    return result.text(value, setpoint) + ("+" if result.exact_if and not metrics[result.exact_if] else "")


def metrics_table(metrics: Metrics, start_min: float = 0.0) -> Table:
    """Name, value and unit of each metric of one run of one person; ValueError for metrics of many people.

    The run starts `start_min` after midnight.
    """
    return lines_table("Metric", ["Value"], metric_rows({"Value": metrics}, start_min))


def comparison_table(
    metrics: Mapping[str, Metrics], distances: Mapping[str, Distance] | None = None, start_min: float = 0.0
) -> Table:
    """Metrics of several runs side by side, under their labels.

    Parameters
    ----------
    metrics : mapping of str to Metrics
        Metrics of one person each, by label.
    distances : mapping of str to Distance, optional
        Distances to the bound of the situation, under the same labels, for a further section; a run for which the
        bound does not hold has none.
    start_min : float
        Time of day at which the runs start, in minutes after midnight.

    Raises
    ------
    ValueError
        If there are none, or some are of many people.
    """
    rows = metric_rows(metrics, start_min)
    if distances is not None:
        for name, field in _OF_A_BOUND.items():
            how = Result(field, "", unit="mg/dl", digits=2)
            values = [getattr(distances[at], field) if at in distances else math.nan for at in metrics]
            texts = list(map(how.text, values))
            rows.append(MetricRow("Bound", name, how.unit, texts, in_other_unit(how, texts, values)))
    return lines_table("Metric", metrics, rows)


def lines_table(head: str, labels: Iterable[str], rows: Sequence[MetricRow]) -> Table:
    """A table for the terminal; piped, it is plain text."""
    from rich import box
    from rich.table import Table
    from rich.text import Text

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    table.add_column(head, no_wrap=True)
    statistics = any(row.statistic for row in rows)
    if statistics:
        table.add_column("")
    for label in labels:
        # Text, since square brackets in a label would be taken for markup
        table.add_column(Text(label), justify="right")
    table.add_column("Unit", no_wrap=True)
    for section, rows_of_section in groupby(rows, lambda row: row.section):
        if section:
            if table.row_count:
                table.add_section()
            table.add_row(Text(section, "bold"))
        for row in rows_of_section:
            name, unit = f"{'  ' if section else ''}{in_shown_units(row.name)}", shown_unit(row.unit)
            others = row.other or [other_number(text, None, row.unit) for text in row.values if unit != row.unit]
            values = row.values if unit == row.unit else others
            table.add_row(name, *([row.statistic] if statistics else []), *values, unit)
    return table
