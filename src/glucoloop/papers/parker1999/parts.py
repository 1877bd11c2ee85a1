"""The tables and figures of the paper: what each shows, and which experiments it needs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from glucoloop.papers.parker1999.experiments import DEAD_TIMES_MIN, Experiments, noisy_runs
from glucoloop.refusal import Refusal


@dataclass(frozen=True)
class PaperPart:
    """A table or figure of the paper, or several together."""

    experiments: Experiments
    entries: tuple[str, ...] = ()
    """Prefixes of the names of its printed numbers; empty where it has no numbers."""
    figures: tuple[str, ...] = ()
    """Names of figures, as `figures.draw` knows them."""

    def __or__(self, other: PaperPart) -> PaperPart:
        return PaperPart(
            experiments=self.experiments | other.experiments,
            entries=self.entries + other.entries,
            figures=self.figures + other.figures,
        )


_FIG_6: Final = frozenset(("mpc", f"{minutes}") for minutes in DEAD_TIMES_MIN)
TABLES: Final = {
    "I": PaperPart(Experiments(without_noise=True), entries=("table-1.",)),
    "II": PaperPart(Experiments(with_noise=noisy_runs()), entries=("table-2.",)),
}
FIGURES: Final = {
    "2": PaperPart(Experiments(model=True), figures=("figure-2",)),
    "3": PaperPart(Experiments(model=True), entries=("model.validation.",), figures=("figure-3",)),
    "4": PaperPart(Experiments(with_noise=noisy_runs((0,))), entries=("figure-4.",), figures=("figure-4",)),
    "5": PaperPart(Experiments(without_noise=True), figures=("figure-5",)),
    "6": PaperPart(Experiments(with_noise=_FIG_6), figures=("figure-6",)),
}
_ARABIC: Final = {"1": "I", "2": "II"}


def chosen(tables: Sequence[str], figures: Sequence[str]) -> PaperPart | None:
    """The union of the named tables and figures; None if none is named.

    Raises
    ------
    ValueError
        For a table or figure that is not reproduced.
    """
    part: PaperPart | None = None
    for kind, names, known in (("table", tables, TABLES), ("figure", figures, FIGURES)):
        for name in names:
            key = name.strip().upper()
            one = known.get(_ARABIC.get(key, key) if kind == "table" else key)
            if one is None:
                raise Refusal(f"unknown {kind} {name!r}; the known ones are: {', '.join(known)}")
            part = one if part is None else part | one
    return part
