"""What became of people: one row a person, under one controller."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class People:
    """Some people of a trial under one controller, in the order of their numbers."""

    person: npt.NDArray[np.int64]
    """(n,)"""
    able: npt.NDArray[np.bool_]
    """(n,) whether a basal rate holds him at the setpoint; without one there is nothing to start from."""
    basal_insulin_mU_min: Floats
    """(n,) NaN for those who are not able."""
    drawn: Mapping[str, Floats]
    """(n,) each, by parameter: what sets a person apart."""
    metrics: Mapping[str, Floats]
    """(n,) each, by the name of a field of `Metrics`; NaN for those who are not able."""
    yes_or_no: frozenset[str] = frozenset()
    """Metrics that are 0 or 1."""

    @property
    def below_validity(self) -> npt.NDArray[np.bool_]:
        """(n,) whether glucose was ever lower than the person's model is valid for.

        False throughout where that was not measured, in folders that an earlier version wrote.
        """
        found = self.metrics.get("time_below_validity_pct", np.zeros(self.person.shape))
        ever: npt.NDArray[np.bool_] = found > 0.0
        return ever


Shard = Mapping[str, People]
"""By the label of the controller."""
Shards = Callable[[], Iterable[Shard]]
"""Calling it reads the shards again from the first one, so that only one at a time need be in memory."""
