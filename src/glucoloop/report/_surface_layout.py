"""SurfaceLayout of a surface of tunings: two parameters span the axes, each combination of the others has a panel."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Literal

from glucoloop.control.settings import MPCTuning, StateTuning
from glucoloop.refusal import Refusal
from glucoloop.tuning.surface import TuningSurface

MOST_PANELS: Final = 12
# The first of these that vary become the axes; the others, panels.
PARAMETERS: Final = ("prediction_horizon", "reference_filter", "move_horizon", "move_weight", "output_weight")

Kind = Literal["tried", "impossible", "refused", "not tried"]


@dataclass(frozen=True)
class Cell:
    """One place of the grid."""

    kind: Kind
    """Kind of the cell: "impossible" if the prediction horizon is shorter than the move horizon; "refused" if the
    design failed.
    """
    point: int | None = None
    """Index into the surface's arrays, if the tuning was tried."""
    reason: str = ""
    """Reason why the design failed."""


@dataclass(frozen=True)
class SurfaceLayout:
    """Axes and panels of the parameters, and the content of every cell."""

    x: str
    y: str
    panels: tuple[str, ...]
    levels: dict[str, list[float]]
    """The values of each parameter, in rising order."""
    cells: dict[tuple[float, ...], Cell]
    """Cells by the values of the parameters, in the order of `levels`."""

    def combinations(self) -> list[tuple[float, ...]]:
        """Parameter values that distinguish the panels; one empty combination for a single panel."""
        place = [list(self.levels).index(name) for name in self.panels]
        return sorted({tuple(values[at] for at in place) for values in self.cells})

    def rows(self, combination: tuple[float, ...]) -> list[list[Cell]]:
        """Cells of a panel, `[row][column]`; every place holds a cell."""
        fixed = {name: values[0] for name, values in self.levels.items()}
        fixed |= dict(zip(self.panels, combination, strict=True))

        def cell(x: float, y: float) -> Cell:
            values = fixed | {self.x: x, self.y: y}
            known = self.cells.get(tuple(values[name] for name in self.levels))
            if known is not None:
                return known
            return Cell("impossible" if values["prediction_horizon"] < values["move_horizon"] else "not tried")

        return [[cell(x, y) for x in self.levels[self.x]] for y in self.levels[self.y]]


def _value(tuning: MPCTuning, name: str) -> float:
    value: float = getattr(tuning, name)
    return value


def layout(surface: TuningSurface) -> SurfaceLayout:
    """Lay out a surface.

    Raises
    ------
    ValueError
        For more panels than can be read.
    """
    tried = {tuning: Cell("tried", point) for point, tuning in enumerate(surface.tunings)}
    refused = {tuning: Cell("refused", reason=reason) for tuning, reason in surface.refused}
    cells: dict[MPCTuning, Cell] = {**refused, **tried}
    filtered = all(isinstance(tuning, StateTuning) for tuning in cells)
    names = [name for name in PARAMETERS if filtered or name != "reference_filter"]
    levels = {name: sorted({_value(tuning, name) for tuning in cells}) for name in names}
    varying = [name for name in names if len(levels[name]) > 1]
    x, y, *_ = [*varying, *(name for name in names if name not in varying)]
    found = SurfaceLayout(
        x=x,
        y=y,
        panels=tuple(varying[2:]),
        levels=levels,
        cells={tuple(_value(tuning, name) for name in names): cell for tuning, cell in cells.items()},
    )
    needed = len(found.combinations())
    if needed > MOST_PANELS:
        raise Refusal(
            f"the surface would need {needed} panels, at most {MOST_PANELS} can be seen; "
            f"give fewer values of {' and '.join(found.panels)}"
        )
    return found


def texts(names: Sequence[str], symbols: dict[str, str], values: Sequence[float]) -> str:
    """Title of a panel: the parameters and their values."""
    return ", ".join(f"{symbols[name]} = {value:g}" for name, value in zip(names, values, strict=True))
