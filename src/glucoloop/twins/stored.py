"""Twin as other commands take it again: its posterior and its checks, from the plain values that were kept."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
import numpy.typing as npt

from glucoloop.patients.catalogue import patient_entry
from glucoloop.patients.population import Population
from glucoloop.patients.table import PeopleTable
from glucoloop.refusal import Refusal
from glucoloop.schema.values import ValueBounds, checked
from glucoloop.text import one_line
from glucoloop.twins.extended import ExtendedPatient
from glucoloop.twins.prior import Prior
from glucoloop.twins.twin import TWIN

Values = npt.NDArray[np.float64]

_Coordinate = Annotated[float, ValueBounds(at_least=-60.0, at_most=60.0)]
_Positive = Annotated[float, ValueBounds(at_least=1e-12, at_most=1e12)]


@dataclass(frozen=True)
class _Filter:
    """Person in coordinates as a file holds it."""

    parameters: Annotated[tuple[str, ...], ValueBounds(shortest=1, longest=100)]
    prior_mean: list[_Coordinate]
    prior_factor: list[list[_Coordinate]]
    coordinates: list[_Coordinate]
    covariance: list[list[_Coordinate]]
    mean_mg_dl: Annotated[float, ValueBounds(at_least=20.0, at_most=800.0)]
    steps: Annotated[int, ValueBounds(at_least=1, at_most=1000)]
    site: Annotated[str, ValueBounds(shortest=1, longest=40)]

    def __post_init__(self) -> None:
        number = len(self.parameters)
        if len({*self.parameters}) < number:
            raise Refusal("a parameter is there twice")
        if {len(self.prior_mean), len(self.prior_factor), *map(len, self.prior_factor)} != {number}:
            raise Refusal(f"its {number} parameters have a mean or a factor of another size")
        coordinates = len(self.coordinates)
        if {len(self.covariance), *map(len, self.covariance)} != {coordinates}:
            raise Refusal(f"its {coordinates} coordinates have a covariance of another size")


@dataclass(frozen=True)
class _Kept:
    """Plain values of a twin that are used again."""

    patient: str
    population: str
    verdict: Annotated[str, ValueBounds(longest=1000)]
    predicts: bool | None
    known: dict[str, _Positive]
    filter: _Filter


@dataclass(frozen=True)
class StoredTwin:
    """Person of a twin, and whether it predicted the days that were held out."""

    patient: ExtendedPatient
    p: Values
    factor: Values
    """Cholesky factor of the covariance of the coordinates."""
    mean_mg_dl: float
    verdict: str
    predicts: bool | None

    @classmethod
    def of(cls, plain: Mapping[str, Any]) -> StoredTwin:
        """Twin from the plain values of `twins.Twin.plain`; Refusal for others."""
        if "posterior" in plain and "filter" not in plain:
            raise Refusal(
                "it is a twin of an earlier version, which had no place for what nobody entered; find it again with "
                "`glucoloop twin`"
            )
        try:
            kept = checked(_Kept, {name: plain[name] for name in _Kept.__dataclass_fields__ if name in plain})
            of = kept.filter
            for name in (*of.parameters, *kept.known):
                patient_entry(kept.patient).refuse_unknown(name)
            prior = Prior(
                population=one_line(kept.population),
                patient=kept.patient,
                parameters=of.parameters,
                mean=np.asarray(of.prior_mean),
                factor=np.asarray(of.prior_factor),
                known=kept.known,
            )
            patient = ExtendedPatient(prior, of.steps, of.site)
            if len(of.coordinates) != patient.coordinates:
                raise Refusal(f"it has {len(of.coordinates)} coordinates and not {patient.coordinates}")
            factor = np.linalg.cholesky(np.asarray(of.covariance))
        except (Refusal, np.linalg.LinAlgError) as error:
            raise Refusal(
                f"it is no twin that glucoloop wrote: {one_line(error)}; find it again with `glucoloop twin`"
            ) from None
        return cls(
            patient, np.asarray(of.coordinates), factor, of.mean_mg_dl, f"{one_line(kept.verdict)}.", kept.predicts
        )


def people_of(patient: str, values: list[dict[str, float]], profile: Mapping[str, float]) -> Population:
    """People with these parameters, all with one profile."""
    names = (TWIN, *(f"draw {k}" for k in range(1, len(values))))
    table = PeopleTable(
        names=names,
        values={name: tuple(of[name] for of in values) for name in values[0]},
        profile={name: (value,) * len(values) for name, value in profile.items() if math.isfinite(value)},
    )
    return Population(TWIN, (), "people that the record could be of", patient, table)
