"""Databases of apps: the tables with records as texts."""

from __future__ import annotations

import re
import sqlite3
from typing import Final

from glucoloop.records.file_text import MAX_ROWS
from glucoloop.refusal import Refusal

XDRIP_TABLES: Final = {
    "BgReadings": ("timestamp", "calculated_value", "dg_mgdl"),
    "Treatments": ("timestamp", "eventType", "carbs", "insulin", "insulinJSON"),
    "BloodTest": ("timestamp", "mgdl"),
}
"""Columns that are read of each table of xDrip's database."""
_SQLITE: Final = b"SQLite format 3\0"
_BREAKS: Final = re.compile(r"[\x00-\x1f\x7f\x85\u2028\u2029]+")
_STEPS_AT_ONCE, _MAX_STEPS = 1_000_000, 2_000
"""Steps of SQLite's machine, in thousands of millions at most, after which a query is given up."""


def is_database(data: bytes) -> bool:
    """Whether the bytes of a file are those of a database of SQLite."""
    return data.startswith(_SQLITE)


def tables_of(data: bytes) -> list[bytes]:
    """Known tables of a database as texts, fields divided by tabs; Refusal for a database that has none of them."""
    steps = 0

    def too_long() -> bool:
        nonlocal steps
        steps += 1
        return steps > _MAX_STEPS

    result: list[bytes] = []
    try:
        with sqlite3.connect(":memory:") as database:
            database.deserialize(data)
            database.execute("PRAGMA trusted_schema = OFF")
            database.set_progress_handler(too_long, _STEPS_AT_ONCE)
            for name, columns in XDRIP_TABLES.items():
                if not database.execute(
                    "SELECT 1 FROM sqlite_master WHERE type = 'table' AND name = ?", (name,)
                ).fetchone():
                    continue
                there = {row[1] for row in database.execute(f"PRAGMA table_info({name})")}
                chosen = ", ".join(f'"{column}"' if column in there else "NULL" for column in columns)
                rows = database.execute(f"SELECT {chosen} FROM {name} LIMIT {MAX_ROWS + 1}")
                lines = ("\t".join("" if cell is None else _BREAKS.sub(" ", str(cell)) for cell in row) for row in rows)
                text = "\n".join(["\t".join(columns), *lines])
                result.append(text.encode(errors="replace"))
    except (sqlite3.Error, UnicodeDecodeError, OverflowError) as error:
        raise Refusal("it is a database that is damaged; export it again") from error
    if not result:
        raise Refusal(
            "it is a database without a table of xDrip, which is the only app whose database is known; "
            "export its readings as CSV"
        )
    return result
