"""Prior of a twin: the people of its family, as a normal distribution of the logarithms of their parameters.

Which parameters are found, and how they differ between people, is what the family's population says; nothing here names
one. Mean and covariance are those of people drawn from it, so that independent, joint and tabulated parameters are
treated alike, and a person outside the bounds of the population is unlikely but possible.

A population may draw everything but what its family declares as sensitivity to insulin, as `wilinska2010` does. Nothing
of a record or of a replay could then change how strongly insulin acts. So these constants are found too, about their
nominal values, with the standard deviation of `_UNDRAWN_LOG_SD`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from glucoloop._lazy_jax import scipy
from glucoloop.patients.catalogue import patient_entry
from glucoloop.patients.population import Population
from glucoloop.refusal import Refusal

Values = npt.NDArray[np.float64]

_DRAWN: Final = 4000
_OWN_SHARE: Final = 0.2
"""Share of the covariance of a table of people that is taken as independent, since a table has few people."""
_UNDRAWN_LOG_SD: Final = 0.4
"""Standard deviation of the logarithm of a sensitivity to insulin that a population does not draw; those of
`boiroux2017` are 0.35 to 0.75."""


@dataclass(frozen=True)
class Prior:
    """Normal distribution of the logarithms of parameters, ``mean + factor z`` with independent standard normal z."""

    population: str
    patient: str
    parameters: tuple[str, ...]
    mean: Values
    """``(parameters,)`` mean of the logarithms."""
    factor: Values
    """``(parameters, parameters)`` Cholesky factor of their covariance."""
    known: Mapping[str, float]
    """Parameters that are known of the person, and not found."""

    @property
    def covariance(self) -> Values:
        """``(parameters, parameters)`` covariance of the logarithms."""
        covariance: Values = self.factor @ self.factor.T
        return covariance

    @property
    def sd(self) -> Values:
        """``(parameters,)`` standard deviations of the logarithms."""
        return np.asarray(np.sqrt(np.diag(self.covariance)), np.float64)

    def values(self, z: jax.Array) -> dict[str, Any]:
        """Value ``(people,)`` of each parameter, the known ones too, for coordinates ``(parameters, people)``."""
        logarithms = jnp.asarray(self.mean)[:, None] + jnp.asarray(self.factor) @ z
        result = dict(zip(self.parameters, jnp.exp(logarithms), strict=True))
        return {**result, **{name: jnp.full(z.shape[1], value) for name, value in self.known.items()}}

    def coordinates(self, values: Mapping[str, Any]) -> Values:
        """Coordinates z ``(parameters,)`` of a person with given values."""
        logarithms = np.log([float(values[name]) for name in self.parameters])
        return np.asarray(np.linalg.solve(self.factor, logarithms - self.mean), np.float64)


def prior_of(population: Population, known: Mapping[str, float] | None = None) -> Prior:
    """Prior by a population, given what is known of the person.

    Raises
    ------
    Refusal
        If people do not differ in any parameter that has to be found, a parameter can be 0 or below, or one that is
        known is not possible or not a parameter of the population.
    """
    known = dict(known or {})
    drawn_names = population.parameters
    drawn_as = population if population.table is None else population.drawn_as("with-replacement")
    if not drawn_names:
        raise Refusal(
            f"the people of {population.name} of {population.patient} do not differ, so there is nothing to find; "
            "choose a patient with a population, such as hovorka-2004, or give a population of your own"
        )
    entry = patient_entry(population.patient)
    undrawn = tuple(name for name in getattr(entry, "insulin_sensitivity", ()) if name not in drawn_names)
    names = (*drawn_names, *undrawn)
    for name, value in known.items():
        if name not in names:
            raise Refusal(
                f"{name} does not differ between the people of {population.name}; the parameters are: "
                f"{', '.join(names)}"
            )
        if not 0.0 < value < np.inf:
            raise Refusal(f"{name} is {value:g}; give a finite value above 0")
    values = np.stack(list(drawn_as.values(0, np.arange(_DRAWN)).values()))
    for name, drawn in zip(drawn_names, values, strict=True):
        if not drawn.min() > 0.0:
            raise Refusal(
                f"{name} can be {drawn.min():g} in {population.name}, and a twin is found on the scale of logarithms; "
                "give a population in which it stays above 0"
            )
    logarithms = np.log(values)
    mean, covariance = logarithms.mean(axis=1), np.atleast_2d(np.cov(logarithms))
    if population.table is not None:
        covariance = (1.0 - _OWN_SHARE) * covariance + _OWN_SHARE * np.diag(np.diag(covariance))
    mean = np.append(mean, np.log([float(entry.nominal[name]) for name in undrawn]))
    covariance = scipy.linalg.block_diag(covariance, _UNDRAWN_LOG_SD**2 * np.eye(len(undrawn)))
    is_known = np.array([name in known for name in names])
    if is_known.all():
        raise Refusal("every parameter is given, so there is nothing to find; leave one out")
    if is_known.any():
        known_values = np.log([known[name] for name in names if name in known])
        gain = np.linalg.solve(covariance[np.ix_(is_known, is_known)], covariance[np.ix_(is_known, ~is_known)]).T
        mean = mean[~is_known] + gain @ (known_values - mean[is_known])
        covariance = covariance[np.ix_(~is_known, ~is_known)] - gain @ covariance[np.ix_(is_known, ~is_known)]
    return Prior(
        population=population.name,
        patient=population.patient,
        parameters=tuple(name for name in names if name not in known),
        mean=mean,
        factor=np.linalg.cholesky(covariance),
        known=known,
    )
