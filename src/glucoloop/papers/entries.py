"""Entries of a paper as records, what is found of them, and whether it agrees.

An entry is a printed number, or a claimed one with its bound. What is found stands in columns: operating points, or
controllers.
"""

from __future__ import annotations

import importlib.resources
import tomllib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, Generic, Literal, TypeVar

import numpy as np

UNSETTLED: Final = "551+"
_CLOSE: Final = 0.1
"""Relative difference within which a number agrees with the printed one."""


@dataclass(frozen=True, kw_only=True)
class PaperEntry:
    """One number or statement."""

    id: str
    what: str
    printed: float | str
    """Number or word; the bound, where the entry is one."""
    unit: str = ""
    kind: Literal["value", "at-most", "at-least"] = "value"
    """``"value"``, or the side of a bound."""


E = TypeVar("E", bound=PaperEntry, covariant=True)


def read_entries(package: str, file: str, kind: type[E]) -> tuple[E, ...]:
    """Read the entries of a file in a package, in its order."""
    text = importlib.resources.files(package).joinpath(file).read_text(encoding="utf-8")
    rows: list[Any] = tomllib.loads(text)["entry"]
    lists = ({key: tuple(of) if isinstance(of, list) else of for key, of in row.items()} for row in rows)
    made: Callable[..., E] = kind
    return tuple(made(**row) for row in lists)


@dataclass(frozen=True)
class Reproduced:
    """Result for one entry in one column."""

    median: float | str
    low: float | None = None
    """10th percentile over the seeds; None where there is one run."""
    high: float | None = None
    unsettled: bool = False
    """Whether more than half of the runs never settle."""

    @classmethod
    def of(cls, values: Any, settled: Any = None) -> Reproduced:
        """Median and percentiles over the seeds, `(seeds,)`."""
        array = np.asarray(values, float)
        unsettled = settled is not None and bool(np.mean(~np.asarray(settled)) > 0.5)
        if array.size == 1:
            return cls(median=float(array[0]), unsettled=unsettled)
        low, median, high = (float(part) for part in np.percentile(array, [10, 50, 90]))
        return cls(median=median, low=low, high=high, unsettled=unsettled)

    @property
    def text(self) -> str:
        """Text of the result in a table."""
        if isinstance(self.median, str):
            return self.median
        middle = UNSETTLED if self.unsettled else _number(self.median)
        if self.low is None or self.high is None:
            return middle
        return f"{middle} ({_number(self.low)} to {_number(self.high)})"


@dataclass(frozen=True)
class ComparedEntry(Generic[E]):
    """An entry beside what is found of it."""

    entry: E
    reproduced: Mapping[str, Reproduced]
    """Result in each column."""

    def _numbers(self, column: str) -> tuple[float, float] | None:
        """The number found and the printed one, where both are numbers."""
        found, printed = self.reproduced.get(column), self.entry.printed
        if found is None or isinstance(found.median, str) or isinstance(printed, str):
            return None
        return found.median, printed

    def difference(self, column: str) -> float | None:
        """Reproduced less printed, where both are numbers."""
        numbers = self._numbers(column)
        return None if numbers is None else numbers[0] - numbers[1]

    def agrees(self, column: str) -> bool | None:
        """Whether the entry reproduces; None where it was not measured.

        A number does if it is within a tenth of the printed one or the printed one lies between the 10th and the 90th
        percentile of the seeds; a bound if it is kept, which NaN never does; a word if it is the same.
        """
        found, printed, numbers = self.reproduced.get(column), self.entry.printed, self._numbers(column)
        if found is None:
            return None
        if printed == UNSETTLED:
            return found.unsettled
        if numbers is None:
            return printed == found.median
        if self.entry.kind == "at-most":
            return numbers[0] <= numbers[1]
        if self.entry.kind == "at-least":
            return numbers[0] >= numbers[1]
        within = found.low is not None and found.high is not None and found.low <= numbers[1] <= found.high
        return _close(*numbers) or within

    def agrees_by_spread(self, column: str) -> bool:
        """Whether the entry reproduces only because the seeds spread over the printed number.

        Its median is more than a tenth away: another realisation of the noise could well have been printed.
        """
        numbers = self._numbers(column)
        if numbers is None or self.entry.kind != "value" or not self.agrees(column):
            return False
        return not _close(*numbers)


def compared(entries: Iterable[E], found: Mapping[str, Mapping[str, Reproduced]]) -> list[ComparedEntry[E]]:
    """Entries beside what was found of them: by column, and in it by the id of the entry."""
    return [
        ComparedEntry(entry, {column: ours[entry.id] for column, ours in found.items() if entry.id in ours})
        for entry in entries
    ]


def markdown_table(columns: Sequence[str], rows: Iterable[Sequence[str]], right: Sequence[str] = ()) -> str:
    """A table in Markdown; `right` are columns whose cells stand at the right, as numbers do."""
    lines = [columns, ["---:" if column in right else ":---" for column in columns], *rows]
    return "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines)


def _close(found: float, printed: float) -> bool:
    return abs(found - printed) <= _CLOSE * abs(printed)


def _number(value: float) -> str:
    """Text of a number with three significant digits."""
    return f"{value:.0f}" if abs(value) >= 100.0 else f"{value:.3g}"
