"""People of one's own in the page: of a table, as a twin is, or drawn here, as a twin's posterior is."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final
from urllib.parse import urlencode

import numpy as np

import glucoloop
from glucoloop.component.setting import choices_text
from glucoloop.lab.patient_functions import SEED, people_of
from glucoloop.patients.population import draw
from glucoloop.refusal import Refusal
from glucoloop.situations.population import named_population

MAX_OWN: Final = 200
"""Largest number of people whom a page carries."""


def with_people(data: dict[str, Any], family: str, population: str) -> dict[str, Any]:
    """Data of the page with a population in the place of the usual one of a family; it opens with that family.

    Person by person they are those of ``glucoloop trial`` with the seed of the page. Of a file only the name is told.
    """
    known = data["people"]
    if family not in known:
        raise Refusal(f"the page has no people around {family}; give --patient {choices_text(tuple(known))}")
    people, names = named_population(population, family), list(people_of(family).distributions())
    if set(people.parameters) != set(names):
        raise Refusal(
            f"the people of {population} differ in {', '.join(people.parameters) or 'nothing'}; people of the page "
            f"differ in {', '.join(names)}: give a population that has each of these, as a twin of {family} has"
        )
    count = min(people.most_people or MAX_OWN, MAX_OWN)
    values = draw(people, SEED, np.arange(count)).values
    given = np.stack([values[name] for name in names], axis=1).tolist()
    own = {**known[family], "population": Path(population).name, "count": count, "given": given}
    opens = {"glucoloop": glucoloop.__version__, "patient": family} | ({"follow": "0"} if count == 1 else {})
    return {**data, "people": {**known, family: own}, "open": f"#{urlencode(opens)}"}
