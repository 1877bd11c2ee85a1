"""Choice of memory and Laguerre functions for a record, by how well readings left out of the fit are predicted.

Several sets of functions, from the paper's to those for insulin that acts for a day, are fitted without each of ten
blocks of readings in turn. Taken is the set with the minimum error on the blocks left out, but the paper's if its error
is within one standard error of that: L. Breiman, J. Friedman, R. Olshen, C. Stone, Classification and Regression Trees,
1984, Sec. 3.4.3.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from glucoloop.component.routes import INTRAVENOUS, ROUTES, SUBCUTANEOUS
from glucoloop.identification.laguerre import laguerre_functions
from glucoloop.identification.reliability import held_out_errors

Floats = npt.NDArray[np.float64]

_BETWEEN: Final = ((360.0, 0.92, 2, False), (720.0, 0.96, 2, False), (1440.0, 0.98, 2, False), (480.0, 0.93, 6, True))
"""Memory in min, pole at 5-min samples, functions, and whether insulin is given subcutaneously."""
_POLES_AT_MIN: Final = 5.0


@dataclass(frozen=True)
class Basis:
    """Span in which an impulse response is sought."""

    memory: int
    """Number of samples M after which the response has died out, or has only its realisation."""
    pole: float
    functions: int | None
    """Number of Laguerre functions; None for any response of M coefficients."""
    subcutaneous: bool = False
    """Whether the response begins at 0 with a slope of 0 and is never above 0; see `subcutaneous_response`."""

    def given(self, **values: Any) -> Basis:
        """The same with other values."""
        return dataclasses.replace(self, **values)

    def rows(self) -> Any:
        """Functions ``(L, M)`` in whose span the response is sought; None if it is not smoothed."""
        return None if self.functions is None else laguerre_functions(self.pole, self.functions, self.memory)


def usual_bases(sample_time_min: float) -> tuple[Basis, ...]:
    """Candidates at a sample time, the paper's first."""
    paper, slow = (
        Basis(*ROUTES[route].identification(sample_time_min).values()) for route in (INTRAVENOUS, SUBCUTANEOUS)
    )
    between = (
        Basis(max(2, round(memory_min / sample_time_min)), pole ** (sample_time_min / _POLES_AT_MIN), functions, skin)
        for memory_min, pole, functions, skin in _BETWEEN
    )
    return paper, *between, slow.given(subcutaneous=True)


def candidates(sample_time_min: float, given: Mapping[str, Any]) -> tuple[Basis, ...]:
    """Usual candidates with the given values in place of their own, each once."""
    return tuple(dict.fromkeys(basis.given(**given) for basis in usual_bases(sample_time_min)))


def chosen(bases: Iterable[Basis], regression: Callable[[Basis], tuple[Floats, Floats]], samples: int) -> Basis:
    """The basis in which readings left out of the fit are predicted best, or the first if it is about as good.

    One whose memory is longer than half of the record is left out, but not the first, and so is one whose regression
    raises ValueError. All regressions have the same readings.
    """
    first, *others = bases
    if not others:
        return first
    possible, errors = [], []
    for basis in (first, *(basis for basis in others if 2 * basis.memory <= samples)):
        try:
            columns, readings = regression(basis)
        except ValueError:
            continue
        if readings.size > columns.shape[1]:
            possible.append(basis)
            errors.append(held_out_errors(columns, readings))
    if not possible:
        return first
    best = int(np.argmin([float(error.mean()) for error in errors]))
    apart = errors[0] - errors[best]
    near = apart.mean() <= apart.std(ddof=1) / np.sqrt(apart.size)
    return possible[0] if near else possible[best]
