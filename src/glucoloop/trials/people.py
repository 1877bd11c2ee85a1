"""Results of people under one controller, one row per person."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class PeopleRows:
    """Some people of a trial under one controller, in the order of their numbers."""

    person: npt.NDArray[np.int64]
    """(n,) numbers of the people."""
    feasible: npt.NDArray[np.bool_]
    """(n,) whether a basal rate holds the person at the setpoint; without one the run cannot start."""
    basal_insulin_mU_min: Floats
    """(n,) basal rates, NaN for people without one."""
    drawn: Mapping[str, Floats]
    """(n,) drawn values of each parameter."""
    metrics: Mapping[str, npt.NDArray[Any]]
    """(n,) values of each metric by its name in `metrics.metric`; NaN for people without a basal rate."""
    yes_or_no: frozenset[str] = frozenset()
    """Metrics that are 0 or 1."""
    profile: Mapping[str, Floats] = field(default_factory=dict)
    """(n,) known fields of the people's profiles, those of `trials.trial.profile_columns`."""

    @property
    def below_validity(self) -> npt.NDArray[np.bool_]:
        """(n,) whether glucose was ever below the range in which the person's model is valid.

        It is False throughout where that was not measured, in folders of an earlier version.
        """
        result = self.metrics.get("time_below_validity_pct", np.zeros(self.person.shape))
        ever: npt.NDArray[np.bool_] = result > 0.0
        return ever


Shard = Mapping[str, PeopleRows]
"""Results of a shard by the label of the controller."""
Shards = Callable[[], Iterable[Shard]]
"""Function that reads the shards again from the first one, so that only one at a time is in memory."""
