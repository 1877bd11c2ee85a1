"""Twin as other commands take it again: its posterior, from the plain values that were kept."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from glucoloop.patients.population import Population
from glucoloop.patients.table import PeopleTable
from glucoloop.refusal import Refusal
from glucoloop.twins.prior import Prior
from glucoloop.twins.twin import TWIN

Values = npt.NDArray[np.float64]


@dataclass(frozen=True)
class StoredTwin:
    """Posterior of a twin, in the form of a prior: its coordinates are about the twin, which is at 0."""

    posterior: Prior
    start: float
    """Coordinate of glucose at the start, see `twins.course.Simulator`."""
    profile: Mapping[str, float]

    @classmethod
    def of(cls, plain: Mapping[str, Any]) -> StoredTwin:
        """Twin from the plain values of `twins.Twin.plain`; Refusal for others."""
        try:
            kept = plain["posterior"]
            posterior = Prior(
                population=TWIN,
                patient=str(plain["patient"]),
                parameters=tuple(map(str, kept["parameters"])),
                mean=np.asarray(kept["log_mean"], float),
                factor=np.linalg.cholesky(np.asarray(kept["log_covariance"], float)),
                known={str(name): float(value) for name, value in plain["known"].items()},
            )
            if posterior.factor.shape != (len(posterior.parameters), posterior.mean.size):
                raise ValueError
            profile = {str(name): float(value) for name, value in plain["profile"].items()}
            return cls(posterior, float(kept["start"]), profile)
        except (KeyError, TypeError, ValueError, AttributeError, np.linalg.LinAlgError):
            raise Refusal("it is no twin that glucoloop wrote; find it again with `glucoloop twin`") from None

    def coordinates(self, draws: int, seed: int) -> Values:
        """Coordinates ``(1 + draws, coordinates)`` of the twin and of people drawn from its posterior."""
        scores = np.random.default_rng(seed).standard_normal((draws, self.posterior.mean.size))
        z = np.vstack([np.zeros(self.posterior.mean.size), scores])
        return np.column_stack([z, np.full(len(z), self.start)])

    def people(self, values: Mapping[str, Values]) -> Population:
        """People with these parameters ``(people,)`` by name, the first of whom is the twin."""
        number = len(next(iter(values.values())))
        table = PeopleTable(
            names=(TWIN, *(f"draw {k}" for k in range(1, number))),
            values={name: tuple(map(float, column)) for name, column in values.items()},
            profile={name: (value,) * number for name, value in self.profile.items()},
        )
        return Population(TWIN, (), "drawn from the posterior", self.posterior.patient, table)
