"""Queries to the folder of a trial, in SQL.

DuckDB reads the Parquet files in place. A query only reads: SELECT, PIVOT, DESCRIBE or SUMMARIZE; nothing is written,
and no other file is read. DuckDB's own limit of memory does not count the texts and lists that a function makes, nor
rows as objects of Python, so the process has a limit too.
"""

from __future__ import annotations

import contextlib
import re
import sys
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import polars as pl

from glucoloop.refusal import Refusal, needed_for
from glucoloop.schema.values import checked
from glucoloop.storage.files import stored_json
from glucoloop.text import is_printable, one_line
from glucoloop.trials.folder import BANDS, SHARDS, SUMMARY, TrialOrigin, done_shards, final_files
from glucoloop.trials.shard import BANDS as COUNTS
from glucoloop.trials.shard import PEOPLE, TRACES
from glucoloop.trials.trace_store import (
    MEND,
    StoredTable,
    file_system_path,
    refuse_changed,
    refusing,
    store_address,
    system_of,
)

if sys.platform == "linux":
    import resource

with needed_for("a question in SQL"):
    import duckdb

VIEWS: Final = {
    "people": "one row a person and controller: parameters, basal rate, metrics",
    "counts": "how many people had a glucose or insulin from low to high at a time",
    "bands": "quantiles of glucose and insulin over time",
    "summary": "how each metric is spread, by controller",
    "traces": "glucose and insulin of those whose traces were kept",
}
_MAX_MEMORY_MB: Final = 1000
"""Memory that a query may take: what DuckDB counts, and on Linux all that the process takes for it."""
_SPECIAL: Final = frozenset("*?[]{}")
_ROWS: Final = 10_000
_LACKED: Final = re.compile(r"Required module '(?P<package>[^']+)' failed to import")
"""DuckDB's words for a Python package that it needs to hand over a value, before a traceback."""
_SPACES: Final = dict.fromkeys(map(ord, "\t\n\r"), " ")
"""White space that a query over several lines may hold."""


@dataclass(frozen=True)
class Answer:
    """The answer to a query; its rows can be read once."""

    columns: list[str]
    rows: Iterator[tuple[Any, ...]]


@dataclass(frozen=True)
class _TrialTables:
    """The tables of a trial, open for queries; see `trial_tables`."""

    connection: Any
    views: dict[str, list[str]]
    """Columns of each existing table."""
    notes: tuple[str, ...]
    """Sentences on tables that cannot be read."""
    done: int
    shards: int
    memory_mb: int

    def query(self, sql: str) -> Answer:
        """Answer a query; ValueError for a text that is not one query that only reads, or that DuckDB refuses."""
        if not is_printable(sql.translate(_SPACES)):
            raise Refusal(f"{one_line(sql)!r} holds control characters; leave them out, or write them as chr(0)")
        with self._refusing():
            statements = self.connection.extract_statements(sql)
            if len(statements) != 1 or not self._only_reads(statements[0]):
                raise Refusal(
                    f"{one_line(sql)!r} is not one question that only reads; give one SELECT, "
                    'like "select controller, avg(undershoot_mg_dl) from people group by all"'
                )
            first = self.connection.execute(statements[0]).fetchmany(_ROWS)
        return Answer([column[0] for column in self.connection.description], self._rows(first))

    def _rows(self, result: list[tuple[Any, ...]]) -> Iterator[tuple[Any, ...]]:
        while result:
            yield from result
            with self._refusing():
                result = self.connection.fetchmany(_ROWS)

    def _only_reads(self, statement: Any) -> bool:
        """Whether a statement is a query, or a PIVOT, which DuckDB carries out as several statements."""
        if statement.type == duckdb.StatementType.SELECT:
            return True
        if statement.type != duckdb.StatementType.MULTI:
            return False
        # COPY, CREATE and INSERT of a PIVOT are several statements too, but only a query may stand in parentheses.
        try:
            inside = self.connection.extract_statements(f"from ({statement.query.rstrip().rstrip(';')}\n)")
        except duckdb.Error:
            return False
        return len(inside) == 1 and inside[0].type == duckdb.StatementType.MULTI

    @contextlib.contextmanager
    def _refusing(self) -> Iterator[None]:
        """Refuse, in a sentence, what DuckDB refuses in the block."""
        try:
            yield
        except (duckdb.OutOfMemoryException, MemoryError):
            raise Refusal(
                f"the question needs more than {self.memory_mb} MB of memory; ask for fewer rows or columns, or group "
                "them"
            ) from None
        except (duckdb.Error, OverflowError) as error:
            raise Refusal(_sentence(error)) from None


@contextlib.contextmanager
def trial_tables(folder: Path, memory_mb: int = _MAX_MEMORY_MB) -> Iterator[_TrialTables]:
    """Open the folder of a trial, finished or not, for queries; ValueError if none of its shards is done.

    In the block the process, whatever it does, may take `memory_mb` more memory than it has; see `_memory_limited`.
    """
    origin = TrialOrigin.of_folder(folder)
    shards, final = done_shards(folder, origin), final_files(folder)
    if not shards:
        raise Refusal(f"no shard of {folder} is done yet; run `glucoloop trial --config {folder}/trial.toml` first")
    place = folder.resolve()
    if _SPECIAL & set(str(place)):
        raise Refusal(f"{place} has one of {' '.join(sorted(_SPECIAL))} in its name; rename it to ask questions")
    with duckdb.connect(":memory:") as connection:
        paths = [place / SHARDS / shard.path.name for shard in shards]
        stored = {name: table for shard in shards for name, table in shard.stored.items()}
        traces: list[str] = []
        notes: tuple[str, ...] = ()
        try:
            for name, statement in _views(paths, place, final).items():
                connection.execute(f"create view {name} as {statement}")
            if stored:
                traces, notes = _view_of_store(connection, str(origin.traces_at), stored)
            if SUMMARY in final:
                with tempfile.TemporaryDirectory() as scratch:
                    _summary(folder).write_parquet(f"{scratch}/summary.parquet")
                    connection.execute("create table summary as from read_parquet(?)", [f"{scratch}/summary.parquet"])
            settings = {
                "memory_limit": f"{memory_mb}MB",
                "temp_directory": "",
                "allowed_directories": [str(place)],
                "allowed_paths": traces,
                "enable_external_access": False,
                "lock_configuration": True,
            }
            for name, value in settings.items():
                connection.execute(f"set {name} = ?", [value])
            result = connection.execute(
                "select table_name, list(column_name order by column_index) from duckdb_columns() "
                "where not internal group by all"
            ).fetchall()
        except duckdb.Error as error:
            raise Refusal(f"{folder} cannot be read: {one_line(error)}") from None
        columns = dict(result)
        views = {name: columns[name] for name in VIEWS if name in columns}
        with _memory_limited(memory_mb * 1_000_000):
            yield _TrialTables(connection, views, notes, len(shards), origin.shards, memory_mb)


def _view_of_store(
    connection: Any, address: str, stored: Mapping[str, StoredTable]
) -> tuple[list[str], tuple[str, ...]]:
    """Make the view of traces in a store; returns what DuckDB reads for it, and a note if the store cannot be read."""
    try:
        path = file_system_path(store_address(address))
        refuse_changed(address, stored, MEND)
        if path is not None:
            traces = [str(path / name) for name in stored]
        else:
            system, root = system_of(address)
            traces = [system.unstrip_protocol(f"{root}/{name}") for name in stored]  # s3a as s3, which DuckDB knows
            connection.register_filesystem(system)
        with refusing(address, "read"):
            connection.execute(f"create view traces as {_read_parquet('*', traces)}")
    except Refusal as error:
        return [], (f"The traces are left out: {one_line(error)}.",)
    return traces, ()


def _views(shards: list[Path], place: Path, final: list[str]) -> dict[str, str]:
    """SQL of the views of the existing tables."""
    counts = "controller, quantity, t_min, low, high, sum(count)::bigint as count"
    tables = {
        "people": ("*", [shard / PEOPLE for shard in shards], ""),
        "counts": (counts, [shard / COUNTS for shard in shards], "group by all"),
        "traces": ("*", [shard / TRACES for shard in shards], ""),
        "bands": ("*", [place / BANDS] if BANDS in final else [], ""),
    }
    views = {}
    for name, (columns, files, grouped) in tables.items():
        if existing := [str(file) for file in files if file.exists()]:
            views[name] = f"{_read_parquet(columns, existing)} {grouped}"
    return views


def _read_parquet(columns: str, files: list[str]) -> str:
    sources = ", ".join("'" + file.replace("'", "''") + "'" for file in files)
    return f"select {columns} from read_parquet([{sources}])"


def _summary(folder: Path) -> pl.DataFrame:
    """Table with one row per controller and metric."""
    mend = f"move it away and run the command that made {folder} again"
    summary = stored_json(folder / SUMMARY, mend, dict[str, Any])
    try:
        rows = [
            {"controller": label, "metric": metric, **values}
            for label, of_label in checked(dict[str, dict[str, Any]], summary.get("controllers")).items()
            for metric, values in checked(dict[str, dict[str, float | None]], of_label.get("metrics")).items()
        ]
        if not rows:
            raise Refusal("it has no controller")
    except Refusal as error:
        raise Refusal(f"{folder / SUMMARY} is damaged: {error}; {mend}") from None
    table = pl.DataFrame(rows, infer_schema_length=None)
    return table.with_columns(pl.exclude("controller", "metric").cast(pl.Float64))


def _sentence(error: Exception) -> str:
    """DuckDB's own message in a line, without the part that points into the text."""
    if isinstance(error, OverflowError):
        return "the answer holds a span of time that is too long to be shown; cast it to varchar"
    lacked = _LACKED.search(str(error))
    if lacked is not None:
        package = lacked["package"]
        what = "a time with a time zone" if package == "pytz" else "a value"
        return f"the answer holds {what}, for which {package} is missing; cast it to varchar"
    return one_line(str(error).partition("\n\nLINE ")[0].partition("\nLINE ")[0])


@contextlib.contextmanager
def _memory_limited(most_bytes: int) -> Iterator[None]:
    """Let this process, all its threads together, take at most so many bytes more in the block than it has.

    Beyond them the system hands out no memory, which Python tells as MemoryError. Linux alone counts the private memory
    of a process against such a limit; other systems have no bound here.
    """
    if sys.platform != "linux":
        yield
        return
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[5])
    soft, hard = resource.getrlimit(resource.RLIMIT_DATA)
    most = pages * resource.getpagesize() + most_bytes
    resource.setrlimit(resource.RLIMIT_DATA, (most if soft == resource.RLIM_INFINITY else min(soft, most), hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_DATA, (soft, hard))
