"""Space of plausible sensor errors: bounded in size, with a few stretches in which the reading is stuck."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from glucoloop.refusal import Refusal
from glucoloop.threefry import uniforms

Array = npt.NDArray[Any]


@dataclass(frozen=True)
class ErrorSpace:
    """All sequences of errors that a sensor may make.

    A sequence is a point with coordinates from -1 to 1: the errors one after the other, each relative to the largest,
    and then the moments at which the stuck stretches begin, from the first sample to the last.

    Raises
    ------
    ValueError
        For a number out of its bounds.
    """

    samples: int
    error: float
    """Largest relative error: 0.1 is 10 % of the true glucose."""
    hold_samples: int = 3
    """Number of samples for which an error stays the same."""
    stretches: int = 3
    """Number of stretches in which the reading is stuck."""
    stretch_samples: int = 6
    """Number of equal readings in each stretch."""

    def __post_init__(self) -> None:
        if not (math.isfinite(self.error) and 0.0 <= self.error < 1.0):
            raise Refusal(f"a largest error of {100.0 * self.error:g} % is not possible; give 0 or more, below 100")
        for name, least in (("samples", 1), ("hold_samples", 1), ("stretches", 0), ("stretch_samples", 1)):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int) or value < least:
                raise Refusal(f"{name} of {value!r} is not possible; give a whole number of {least} or more")

    @property
    def pieces(self) -> int:
        """Number of errors of a sequence, each of which holds for some samples."""
        return -(-self.samples // self.hold_samples)

    @property
    def dimension(self) -> int:
        """Number of coordinates of a point."""
        return self.pieces + self.stretches

    def centre(self, rng: np.random.Generator) -> Array:
        """Point ``(dimension,)`` without any error, with the stuck stretches anywhere."""
        return np.concatenate([np.zeros(self.pieces), rng.uniform(-1.0, 1.0, self.stretches)])

    def random_points(self, seed: int, person: npt.NDArray[np.int64]) -> Array:
        """Each person's own point, ``(n, dimension)``, drawn uniformly from a seed and the person's number."""
        return np.stack([2.0 * uniforms(seed, "sensor error", person, i) - 1.0 for i in range(self.dimension)], axis=1)

    def points_of(self, smaller: ErrorSpace, points: Array) -> Array:
        """Points ``(..., dimension)`` of this space for those of one with smaller errors: the same sequences.

        Raises
        ------
        ValueError
            If the other space has larger errors, or other pieces or stretches.
        """
        if dataclasses.replace(smaller, error=self.error) != self or smaller.error > self.error:
            raise Refusal(
                f"sequences of {smaller} are not all in {self}; give a space of smaller errors, else the same"
            )
        ratio = smaller.error / self.error if self.error else 0.0
        return np.concatenate([ratio * np.clip(points[..., : self.pieces], -1.0, 1.0), points[..., self.pieces :]], -1)

    def errors(self, points: Array) -> Array:
        """Relative error of each reading, ``(samples, n)``, of points ``(n, dimension)``, clipped to the bounds."""
        pieces = self.error * np.clip(points[:, : self.pieces], -1.0, 1.0)
        return np.repeat(pieces, self.hold_samples, axis=1)[:, : self.samples].T

    def stuck_from(self, points: Array) -> Array:
        """Sample at which each stuck stretch begins, ``(stretches, n)``."""
        share = np.clip(0.5 * (points[:, self.pieces :] + 1.0), 0.0, 1.0)
        return np.minimum(np.floor(share * self.samples), self.samples - 1.0).T
