"""A population as a table in a file: ``[[vary]]`` for each parameter that varies."""

from __future__ import annotations

import typing
from collections.abc import Mapping
from pathlib import Path
from typing import Final

from glucoloop.arguments import converted
from glucoloop.parts.setting import known_names
from glucoloop.patients.population import Population, populations_of
from glucoloop.patients.settings import USUAL_PATIENT
from glucoloop.patients.variation import Variation
from glucoloop.printable import is_printable
from glucoloop.refusal import Refusal
from glucoloop.situations.toml import LARGEST_CHARACTERS, read_toml

VARY_KEY: Final = "vary"
"""Key of the tables of variation in a file: ``[[vary]]``."""


def read_population(keys: Mapping[str, object], patient: str = USUAL_PATIENT.name, name: str = "custom") -> Population:
    """Population of a patient from the keys of a file.

    The keys are ``name`` and ``summary``, which may be left out, and ``vary``, a list of tables; a population whose
    keys have no name has `name`. An unknown key, a value of the wrong type or out of bounds, and a table that can make
    a person who cannot be are refused.
    """
    known = ("name", "summary", VARY_KEY)
    for key in keys:
        if key not in known:
            raise Refusal(f"unknown key {key!r} of a population; {known_names(key, known)}")
    for key in ("name", "summary"):
        if not isinstance(keys.get(key, ""), str):
            raise Refusal(f"{key} is {keys[key]!r}; give a text")
    called, summary = str(keys.get("name", name)), str(keys.get("summary", ""))
    if not is_printable(called):
        raise Refusal(
            f"the name {called!r} of the population cannot be printed in a line; leave out its control characters"
        )
    tables = keys.get(VARY_KEY, [])
    if not isinstance(tables, list | tuple) or not all(isinstance(table, Mapping) for table in tables):
        raise Refusal(f"{VARY_KEY} is {tables!r}; give a table for each parameter, under [[{VARY_KEY}]]")
    variations = tuple(_read_variation(number, table) for number, table in enumerate(tables, 1))
    return Population(called or name, variations, summary, patient)


def _read_variation(number: int, table: Mapping[str, object]) -> Variation:
    types = typing.get_type_hints(Variation)
    try:
        for key in table:
            if key not in types:
                raise Refusal(f"unknown key {key!r} of a variation; {known_names(key, types)}")
        for key in ("parameter", "distribution"):
            if key not in table:
                raise Refusal(f"{key} is missing; add it")
        return Variation(**{key: converted(key, value, types[key], "Variation") for key, value in table.items()})
    except Refusal as error:
        raise Refusal(f"[[{VARY_KEY}]] number {number}: {error}") from None


def population_keys(population: Population) -> dict[str, object]:
    """The keys from which the same population is read."""
    tables = [
        {key: value for key, value in vars(variation).items() if value is not None}
        for variation in population.variations
    ]
    return {"name": population.name, "summary": population.summary, VARY_KEY: tables}


def named_population(text: str, patient: str = USUAL_PATIENT.name) -> Population:
    """Population of a patient by its name, or from a file whose name ends in ``.toml``; Refusal if there is none."""
    path = Path(text)
    if path.suffix != ".toml":
        known = populations_of(patient)
        if text not in known:
            whose = "" if patient == USUAL_PATIENT.name else f" of {patient}"
            raise Refusal(
                f"unknown population {text!r}{whose}; {known_names(text, known)}, or give a file like people.toml"
            )
        return known[text]
    if "\0" in text:
        raise Refusal(f"the path {text!r} holds a NUL character, which no file has in its name; leave it out")
    try:
        with path.open(encoding="utf-8-sig") as file:
            # No more than the largest size of a configuration, so that a larger file is refused and never read whole.
            keys = read_toml(file.read(LARGEST_CHARACTERS + 1), text).keys
    except OSError as error:
        raise Refusal(f"{text} cannot be read: {error.strerror or error}") from None
    except UnicodeDecodeError:
        raise Refusal(f"{text} is not TOML: it is not text in UTF-8") from None
    try:
        people = read_population(keys, patient, path.stem)
    except Refusal as error:
        raise Refusal(f"{text}: {error}") from None
    if not people.variations:
        # a file that was cut short must not pass for the nominal patient
        raise Refusal(
            f"{text} has no [[vary]] table, so all people would be the same; add one, or name the preset nominal"
        )
    return people
