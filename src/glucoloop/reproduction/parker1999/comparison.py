"""Comparison of reproduced numbers with the printed ones."""

from __future__ import annotations

import dataclasses
import tomllib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
import numpy.typing as npt

from glucoloop.patients import OPERATING_POINTS
from glucoloop.reproduction.parker1999.experiments import PointResults, noisy_runs
from glucoloop.text import how_many
from glucoloop.tuning.search import printed_tuning


@dataclass(frozen=True, kw_only=True)
class _PrintedEntry:
    """One printed number or statement, and what of the reproduction is compared with it."""

    id: str
    what: str
    printed: float | str
    """Number or word; the bound, where the entry is one."""
    unit: str = ""
    kind: Literal["value", "at-most"] = "value"
    page: int
    place: str
    controller: str = ""
    situation: str = ""
    """``"noise-free"``, or a dead time with noise: ``"10M"`` is one of 10 min that the controller knows."""
    metric: str
    less_than: str = ""
    """Controller of the same situation whose number this one is below, in percent."""
    more_than: str = ""
    interpretations: tuple[str, ...]
    """Names in `INTERPRETATIONS` on which the reproduced number depends."""
    input_at: tuple[str, ...] = ()
    """Operating points at which the printed number is put in, so that it cannot but agree."""

    @property
    def is_own(self) -> bool:
        """Whether the entry is of a controller that the paper does not have, so that nothing is printed."""
        return self.printed == ""


@dataclass(frozen=True, kw_only=True)
class _Deviation:
    """Entries that do not reproduce for one reason, found by an experiment or by a calculation."""

    entries: tuple[str, ...]
    """Beginnings of the names of the entries."""
    reason: str
    points: tuple[str, ...] = tuple(OPERATING_POINTS)
    """Operating points at which it is the reason."""


def _records(name: str) -> list[dict[str, Any]]:
    return [{key: tuple(v) if isinstance(v, list) else v for key, v in row.items()} for row in _FILE[name]]


_FILE: Final = tomllib.loads(Path(__file__).with_name("published.toml").read_text(encoding="utf-8"))
ENTRIES: Final = tuple(_PrintedEntry(**record) for record in _records("entry"))
"""All entries, in the order of the paper's tables."""
DEVIATIONS: Final = tuple(_Deviation(**record) for record in _records("deviation"))
INTERPRETATIONS: Final[Mapping[str, str]] = _FILE["interpretations"]
"""Choices where the paper is open or illegible, by name: settings, never hidden constants."""


def reason_for(entry: str, operating_point: str) -> str:
    """The reason why an entry does not reproduce at an operating point; empty where none is known."""
    reasons = (one.reason for one in DEVIATIONS if entry.startswith(one.entries) and operating_point in one.points)
    return next(reasons, "")


UNSETTLED: Final = "551+"
_CLOSE: Final = 0.1
"""Relative difference within which a number agrees with the printed one."""


@dataclass(frozen=True)
class Reproduced:
    """Result for one entry at one operating point."""

    median: float | str
    low: float | None = None
    """10th percentile over the seeds; None where there is one run."""
    high: float | None = None
    unsettled: bool = False
    """Whether more than half of the runs never settle."""

    @classmethod
    def of(cls, values: Any, settles: Any = True) -> Reproduced:
        """Median and percentiles over the seeds, `(seeds,)`."""
        array = np.asarray(values, float).ravel()
        unsettled = bool(np.mean(~np.asarray(settles)) > 0.5)
        if array.size == 1:
            return cls(median=float(array[0]), unsettled=unsettled)
        low, median, high = (float(part) for part in np.percentile(array, [10, 50, 90]))
        return cls(median=median, low=low, high=high, unsettled=unsettled)

    @property
    def text(self) -> str:
        """Text of the result in a table."""
        if isinstance(self.median, str):
            return self.median
        middle = UNSETTLED if self.unsettled else _three_digits(self.median)
        if self.low is None or self.high is None:
            return middle
        return f"{middle} ({_three_digits(self.low)} to {_three_digits(self.high)})"


@dataclass(frozen=True)
class ComparedEntry:
    """An entry beside what was found of it."""

    entry: _PrintedEntry
    reproduced: Mapping[str, Reproduced]
    """Result at each operating point."""

    def difference(self, operating_point: str) -> float | None:
        """Reproduced less printed, where both are numbers."""
        results, printed = self.reproduced.get(operating_point), self.entry.printed
        if results is None or isinstance(results.median, str) or isinstance(printed, str):
            return None
        return results.median - printed

    def agrees(self, operating_point: str) -> bool | None:
        """Whether the entry reproduces; None where it was not measured.

        A number does if it is within a tenth of the printed one or the printed one lies between the 10th and the 90th
        percentile of the seeds; a bound if it is kept, which NaN never does; a word if it is the same.
        """
        results, printed = self.reproduced.get(operating_point), self.entry.printed
        if results is None or self.entry.is_own:
            return None
        if printed == UNSETTLED:
            return results.unsettled
        if isinstance(printed, str) or isinstance(results.median, str):
            return printed == results.median
        if self.entry.kind == "at-most":
            return results.median <= printed
        within = results.low is not None and results.high is not None and results.low <= printed <= results.high
        return within or self._close(operating_point)

    def agrees_by_spread(self, operating_point: str) -> bool:
        """Whether the entry reproduces only because the seeds spread over the printed number.

        Its median is more than a tenth away: another realisation of the noise could well have been printed.
        """
        numbers = self.entry.kind == "value" and self.difference(operating_point) is not None
        return numbers and bool(self.agrees(operating_point)) and not self._close(operating_point)

    def _close(self, operating_point: str) -> bool:
        difference, printed = self.difference(operating_point), self.entry.printed
        return difference is not None and abs(difference) <= _CLOSE * abs(float(printed))


def _three_digits(value: float) -> str:
    return f"{value:.0f}" if abs(value) >= 100.0 else f"{value:.3g}"


def count(rows: Iterable[ComparedEntry], operating_point: str) -> str:
    """Number of entries that reproduce at an operating point, as a sentence without its full stop."""
    measured = [row for row in rows if row.agrees(operating_point) is not None]
    agree = sum(bool(row.agrees(operating_point)) for row in measured)
    spread = sum(row.agrees_by_spread(operating_point) for row in measured)
    only = f", {spread} of them only within the spread of the seeds" if spread else ""
    sentence = f"{agree} of {len(measured)} printed entries reproduce{only}"
    results = [row for row in measured if operating_point not in row.entry.input_at]
    if len(results) == len(measured):
        return sentence
    inputs = how_many(len(measured) - len(results), "entry that is an input", "entries that are inputs")
    agree = sum(bool(row.agrees(operating_point)) for row in results)
    return f"{sentence}; without {inputs}, {agree} of {len(results)}"


def left_out(rows: Iterable[ComparedEntry]) -> str:
    """Sentence on the entries that no experiment was run for; empty if there are none."""
    number = sum(not row.reproduced and not row.entry.is_own for row in rows)
    return f"{how_many(number, 'printed entry', 'printed entries')} not run and left out." if number else ""


def compare(
    studies: Mapping[str, PointResults], beginnings: tuple[str, ...] = ("",), own: Iterable[str] = ()
) -> list[ComparedEntry]:
    """Compare the printed entries whose names begin so with the results of the study at each operating point.

    Controllers of one's own, by their labels, have the entries of linear MPC in Tables I and II, without a number.
    """
    rows = []
    for entry in (*ENTRIES, *(entry for label in own for entry in _entries_of(label))):
        if entry.id.startswith(beginnings):
            results = {point: _reproduced(entry, study) for point, study in studies.items()}
            rows.append(ComparedEntry(entry, {point: one for point, one in results.items() if one is not None}))
    return rows


def _entries_of(label: str) -> Iterator[_PrintedEntry]:
    """Entries of a controller of one's own; one that knows the dead time says so among its settings."""
    for entry in ENTRIES:
        table = entry.id.partition(".")[0]
        if entry.id.startswith(("table-1.mpc.", "table-2.mpc.")) and not entry.situation.endswith("M"):
            yield dataclasses.replace(
                entry,
                id=f"{table}.{label}.{entry.situation}.{entry.metric}",
                what=entry.what.replace("Linear MPC", label).replace(", unknown", ""),
                printed="",
                place="",
                controller=label,
                input_at=(),
            )


def _reproduced(entry: _PrintedEntry, study: PointResults) -> Reproduced | None:
    """The result for an entry; None if its experiment was not carried out."""
    if entry.metric == "rank_of_tuning":
        return _rank_of_tuning(entry.controller, study)
    if entry.metric == "increase_of_undershoot_pct":
        return _largest_increase(study)
    if not entry.controller:
        return None if study.model is None else Reproduced.of(study.model.numbers[entry.metric])
    if (entry.controller, entry.situation) not in study.runs:
        return None
    metrics = study.runs[entry.controller, entry.situation].metrics
    if entry.less_than or entry.more_than:
        other = study.runs.get((entry.less_than or entry.more_than, entry.situation))
        if other is None:
            return None
        less = _percent_less(getattr(metrics, entry.metric), getattr(other.metrics, entry.metric))
        return Reproduced.of(less if entry.less_than else -less)
    if entry.metric == "constraints_satisfied":
        broken = float(np.mean(~np.asarray(metrics.constraints_satisfied)))
        return Reproduced("violated" if broken > 0.5 else "satisfied")
    if entry.metric == "deviation_mg_dl":
        return Reproduced.of(np.maximum(metrics.undershoot_mg_dl, metrics.overshoot_mg_dl))
    if entry.metric.startswith("settling"):
        settles = getattr(metrics, entry.metric.removesuffix("_min").replace("settling", "settled"))
        return Reproduced.of(getattr(metrics, entry.metric), settles)
    return Reproduced.of(getattr(metrics, entry.metric))


def _percent_less(ours: Any, theirs: Any) -> npt.NDArray[np.float64]:
    return np.asarray(100.0 * (1.0 - np.asarray(ours, float) / np.asarray(theirs, float)), np.float64)


def _largest_increase(study: PointResults) -> Reproduced | None:
    """The largest increase of undershoot by a dead time of 5 min: of both controllers, which know it or not."""
    if not noisy_runs((0, 5)) <= study.runs.keys():
        return None
    undershoot = {run: study.runs[run].metrics.undershoot_mg_dl for run in noisy_runs((0, 5))}
    increases = [-_percent_less(late, undershoot[run[0], "0"]) for run, late in undershoot.items() if run[1] != "0"]
    return Reproduced(max(float(np.median(increase)) for increase in increases))


def _rank_of_tuning(controller: str, study: PointResults) -> Reproduced | None:
    if controller not in study.tuning:
        return None
    rank = study.tuning[controller].rank_of(printed_tuning(study.operating_point, controller))
    if rank.rank is None:
        return Reproduced(f"no, it breaks a bound or oscillates; {rank.points} others do not")
    return Reproduced("yes" if rank.rank == 1 else f"no, number {rank.rank} of {rank.points}")
