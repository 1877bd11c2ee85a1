"""Command line of the benchmarks that run the same people in two ways, for several controllers and both precisions."""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Sequence
from typing import Any

Row = dict[str, Any]


def answer(
    doc: str,
    measured: Callable[[str, str, int, int], Row],
    controllers: Sequence[str],
    ways: tuple[str, str],
    *,
    people: int,
    head: str = "",
    more: Callable[[Row], str] = lambda row: "",
) -> None:
    """Read the options, measure, and print a table, or JSON."""
    parser = argparse.ArgumentParser(description=doc.splitlines()[0])
    parser.add_argument("--json", action="store_true", help="print the figures as JSON")
    parser.add_argument("--people", type=int, default=people)
    parser.add_argument("--repeats", type=int, default=15)
    asked = parser.parse_args()
    rows = [
        measured(controller, precision, asked.people, asked.repeats)
        for controller in controllers
        for precision in ("float64", "float32")
    ]
    if asked.json:
        print(json.dumps(rows, indent=2))
        return
    print(f"{'':23}{''.join(f'{way:>12}' for way in ways)}{'cost':>8}{head}")
    for row in rows:
        speeds = "".join(f"{row[f'{way}_patient_days_s']:12.0f}" for way in ways)
        print(f"{row['controller']:>9}, {row['precision']:12}{speeds}{row['cost_pct']:6.1f} %{more(row)}")
