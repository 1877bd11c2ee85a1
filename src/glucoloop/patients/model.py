"""A patient model as a value: construction of its people, and their variable parameters."""

from __future__ import annotations

import difflib
import functools
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import jax
import jax.numpy as jnp

from glucoloop.arguments import checked
from glucoloop.component.code import loaded
from glucoloop.patients.protocol import Patient
from glucoloop.patients.settings import patient_entry
from glucoloop.patients.variation import Distribution
from glucoloop.refusal import Refusal

Values = Mapping[str, Any]
"""Number, or array ``(people,)``, of each parameter."""
Sound = Callable[[jax.Array, jax.Array], tuple[jax.Array, jax.Array]]


def _anything(varied: Mapping[str, Distribution]) -> None:
    """Accept any distributions."""


def _finite(x: jax.Array, lowest_mg_dl: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Check of a state that only requires it to be finite."""
    finite = jnp.all(jnp.isfinite(x), axis=0)
    return finite, finite


@dataclass(frozen=True, kw_only=True)
class PatientModel:
    """Model of a kind of patient, from which people are made."""

    build: Callable[[Values, Any, Any], Patient]
    """The patient, or the people, of some values, a basal rate and a setpoint, nominal otherwise. JAX traces it."""
    operating_points: Mapping[str, Callable[[], Patient]]
    """Function that makes the nominal patient there, for each operating point of the entry."""
    nominal: Mapping[str, float] = field(default_factory=dict)
    """All parameters that can vary, with the nominal patient's value."""
    populations: Callable[[], Mapping[str, Any]] = dict
    """The populations by name, besides the nominal one."""
    read_populations: Mapping[str, Callable[[], Any]] = field(default_factory=dict)
    """Function that reads a population which comes with another package, by name; called once it is asked for."""
    refuse: Callable[[Mapping[str, Distribution]], None] = _anything
    """Function that raises ValueError for distributions that can make an impossible person."""
    follows: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """Parameters that follow from others, each with these others."""
    meanings: Mapping[str, str] = field(default_factory=dict)
    """Meaning of parameters that can vary, in words."""
    profile: Mapping[str, float] = field(default_factory=dict)
    """Known fields of the nominal patient's `glucoloop.therapy.Profile`, beside how the patient rests."""
    hint: str = ""
    """List of the known parameters, for the error about an unknown one."""
    sound: Sound = _finite
    """Whether insulin and glucose of states ``(states, ...)`` are possible, if the glucose that is controlled has never
    been below the given one; checked at every sample of a campaign.
    """

    def refuse_unknown(self, parameter: str) -> None:
        """Refuse the name of an unknown parameter, with the most similar known one."""
        if parameter in self.nominal:
            return
        if parameter in self.follows:
            raise Refusal(f"{parameter} follows from {' and '.join(self.follows[parameter])}; vary these instead")
        close = difflib.get_close_matches(parameter, self.nominal, n=1)
        meant = f"did you mean {close[0]!r}? " if close else ""
        known = self.hint or f"the known ones are: {', '.join(self.nominal) or 'none, since nothing can vary'}"
        raise Refusal(f"unknown parameter {parameter!r}; {meant}{known}")


@functools.cache
def patient_model(name: str) -> PatientModel:
    """Model of a patient by name."""
    model: PatientModel = loaded(patient_entry(name).model)
    return model


@checked
def patient(name: str = "parker-1999", operating_point: str | None = None) -> Patient:
    """A nominal patient at an operating point.

    Parameters
    ----------
    name : str
        ``"parker-1999"`` or another of ``glucoloop list patients``; or ``"module:Class"`` of a `PatientComponent`.
    operating_point : str, optional
        The default one by default. Of ``"parker-1999"``: ``"setpoint-81"``: 81.1 mg/dl, held by 25.606 mU/min;
        ``"nominal-22"``: 22.33 mU/min, holding 92.099 mg/dl; ``"fasting-81"``: 22.33 mU/min, holding 81.153 mg/dl in
        a person whose effects are normalised at a fasting glucose of 81 mg/dl.
    """
    entry = patient_entry(name)
    point = entry.default_operating_point if operating_point is None else entry.point(operating_point).name
    return patient_model(name).operating_points[point]()
