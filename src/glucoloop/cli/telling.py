"""Output of a command at its end."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from glucoloop.cli.screen import note

if TYPE_CHECKING:
    from glucoloop.studies.closed_loop import Outcome


def print_json(report: Mapping[str, Any], files: Mapping[str, str], notes: tuple[str, ...]) -> None:
    """Print the report on standard output, and files and notes on standard error."""
    from glucoloop.storage.strict_json import json_text, with_version

    print(json_text({**with_version(report), "files": files}))
    note(notes)


def mmol_lines(outcomes: Mapping[str, Outcome]) -> Iterator[str]:
    """Glucose of each run in mmol/l."""
    from glucoloop.printable import glucose_text
    from glucoloop.units import mmol_l_from_mg_dl

    for label, outcome in outcomes.items():
        metrics, setpoint = outcome.metrics, outcome.trace.setpoint_mg_dl
        low, high, target = (
            glucose_text(mmol_l_from_mg_dl(float(value)), 2)
            for value in (metrics.minimum_mg_dl, metrics.peak_mg_dl, setpoint)
        )
        yield f"{label}: glucose from {low} to {high} mmol/l, setpoint {target} mmol/l."


def where_written(out: Path | None, files: Mapping[str, str]) -> str:
    """Sentence on the place of the files, or on how to get them."""
    if out is None:
        return "Nothing was written; --out DIR keeps tables, figures and the configuration."
    return f"Wrote {', '.join(files)} to {out}."
