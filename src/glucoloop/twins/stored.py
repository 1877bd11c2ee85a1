"""Twin as other commands take it again: its posterior, from the plain values that were kept."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import numpy as np
import numpy.typing as npt

from glucoloop.patients.catalogue import patient_entry
from glucoloop.patients.population import Population
from glucoloop.patients.table import PeopleTable
from glucoloop.refusal import Refusal
from glucoloop.schema.values import ValueBounds, checked
from glucoloop.text import one_line
from glucoloop.twins.prior import Prior
from glucoloop.twins.twin import TWIN

Values = npt.NDArray[np.float64]


_Logarithm = Annotated[float, ValueBounds(at_least=-60.0, at_most=60.0)]
_Positive = Annotated[float, ValueBounds(at_least=1e-12, at_most=1e12)]


@dataclass(frozen=True)
class _Posterior:
    """Posterior as its file holds it."""

    parameters: Annotated[tuple[str, ...], ValueBounds(shortest=1, longest=100)]
    log_mean: list[_Logarithm]
    log_covariance: list[list[_Logarithm]]
    start: _Logarithm

    def __post_init__(self) -> None:
        number = len(self.parameters)
        if len({*self.parameters}) < number:
            raise Refusal("a parameter is there twice")
        if {len(self.log_mean), len(self.log_covariance), *map(len, self.log_covariance)} != {number}:
            raise Refusal(f"its {number} parameters have a mean or a covariance of another size")


@dataclass(frozen=True)
class _Kept:
    """Plain values of a twin that are used again."""

    patient: str
    posterior: _Posterior
    known: dict[str, _Positive]
    profile: dict[Literal["total_daily_dose_U", "carb_ratio_g_U"], _Positive]


@dataclass(frozen=True)
class StoredTwin:
    """Posterior of a twin, in the form of a prior: its coordinates are about the twin, which is at 0."""

    posterior: Prior
    start: float
    """Coordinate of glucose at the start, see `twins.trajectory.Simulator`."""
    profile: Mapping[str, float]

    @classmethod
    def of(cls, plain: Mapping[str, Any]) -> StoredTwin:
        """Twin from the plain values of `twins.Twin.plain`; Refusal for others."""
        try:
            kept = checked(_Kept, {name: plain[name] for name in _Kept.__dataclass_fields__ if name in plain})
            for name in (*kept.posterior.parameters, *kept.known):
                patient_entry(kept.patient).refuse_unknown(name)
            factor = np.linalg.cholesky(np.asarray(kept.posterior.log_covariance))
        except (Refusal, np.linalg.LinAlgError) as error:
            raise Refusal(
                f"it is no twin that glucoloop wrote: {one_line(error)}; find it again with `glucoloop twin`"
            ) from None
        posterior = Prior(
            population=TWIN,
            patient=kept.patient,
            parameters=kept.posterior.parameters,
            mean=np.asarray(kept.posterior.log_mean),
            factor=factor,
            known=kept.known,
        )
        return cls(posterior, kept.posterior.start, {str(name): value for name, value in kept.profile.items()})

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
