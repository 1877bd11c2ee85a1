"""The compact form of a traced function: its lines, its tables and the workspace that it needs."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from glucoloop.native.targets.c.compact.flat import flatten
from glucoloop.native.targets.c.compact.memory import placed
from glucoloop.native.targets.c.compact.translate import Place, Translator
from glucoloop.native.targets.c.compact.writer import Tables, Writer
from glucoloop.native.targets.c.numbers import FORMATS
from glucoloop.native.targets.c.records import Structure

_LOCAL: Final = re.compile(r"\bv\d+\b")
_DEFINED: Final = re.compile(r"const \w+ (v\d+) = ")


@dataclass(frozen=True)
class Body:
    """The lines of a C function."""

    lines: Sequence[str]
    workspace: Mapping[str, int]
    """Count of numbers of each kind in the workspace."""


def compact(
    closed: Any, given: Sequence[Structure], returned: Sequence[Structure], precision: str, tables: Tables
) -> Body:
    """Write a traced function in the compact form, with its arguments and results in records, leaf by leaf."""
    writer = Writer(FORMATS[precision], tables)
    Translator(writer).translate(flatten(closed, precision), _places(given), _places(returned))
    lines, workspace = placed(_used(writer.lines), writer.arrays)
    return Body(lines=lines, workspace=workspace)


def _used(lines: Sequence[str]) -> list[str]:
    """Lines without local constants that nothing reads."""
    while True:
        read = Counter(name for line in lines for name in _LOCAL.findall(line))
        kept = [line for line in lines if not ((found := _DEFINED.match(line)) and read[found.group(1)] == 1)]
        if len(kept) == len(lines):
            return kept
        lines = kept


def _places(records: Sequence[Structure]) -> list[Place]:
    return [Place(f"{of.pointer}->{f.name}", f.kind, f.shape) for of in records for f in of.fields]
