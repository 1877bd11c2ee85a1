"""Differences of a virtual person from the others, in words."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from glucoloop.parts.patients import patient_entry
from glucoloop.patients.model import patient_model
from glucoloop.patients.population import Population
from glucoloop.units import u_h_from_mu_min

_REMARKABLE: Final = 3


def person_in_words(population: Population, person: Mapping[str, Any]) -> str:
    """Basal rate of a person, who is a row of a summary, and the parameters that are farthest from the middle."""
    distributions, meanings = population.distributions(), patient_model(population.patient).meanings
    drawn: Mapping[str, float] = person["parameters"]

    def apart(name: str) -> float:
        of = distributions[name]
        return (drawn[name] - of.centre) / (of.upper - of.lower)

    basal = person["basal_insulin_mU_min"]
    per_hour = f" ({u_h_from_mu_min(basal):.2f} U/h)" if patient_entry(population.patient).under_the_skin else ""
    phrases = [f"basal rate {basal:.1f} mU/min{per_hour}"]
    for name in sorted(drawn, key=lambda name: -abs(apart(name)))[:_REMARKABLE]:
        centre, way = distributions[name].centre, "above" if apart(name) > 0.0 else "below"
        far = f"{abs(drawn[name] / centre - 1.0):.0%} {way}".replace("%", " %") if centre else way
        phrases.append(f"{meanings.get(name, name)} {drawn[name]:.3g}, {far} the usual {centre:.3g}")
    return "; ".join(phrases)
