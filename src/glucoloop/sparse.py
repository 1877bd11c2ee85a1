"""Arrays of people that are zero almost everywhere, such as what is eaten in each minute of a day."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt


@dataclass(frozen=True)
class Sparse:
    """An array ``(..., people)`` that is zero but in some places; numbers that share a place are added up, in order."""

    shape: tuple[int, ...]
    row: npt.NDArray[np.intp]
    """(numbers,) place of each number along all axes but that of people, row by row."""
    person: npt.NDArray[np.intp]
    """(numbers,) place of each number along the axis of people."""
    number: npt.NDArray[np.float64]

    def reshaped(self, *leading: int) -> Sparse:
        """The same numbers with other axes before that of people."""
        return Sparse((*leading, self.shape[-1]), self.row, self.person, self.number)

    def dense(self) -> npt.NDArray[np.float64]:
        """The array with its zeros."""
        whole: npt.NDArray[np.float64] = np.zeros(math.prod(self.shape))
        np.add.at(whole, self.row * self.shape[-1] + self.person, self.number)
        return whole.reshape(self.shape)


def dense(array: Any) -> npt.NDArray[Any]:
    """The array with its zeros, if it is sparse."""
    return array.dense() if isinstance(array, Sparse) else np.asarray(array)
