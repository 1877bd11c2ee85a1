"""A population as a file.

A TOML file has ``[[vary]]`` for each parameter that varies by itself, ``[[joint]]`` for several that vary together, and
``[[person]]`` for each named person. A CSV file has one person a line, and the names of the columns in the first.
"""

from __future__ import annotations

import csv
import io
import typing
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from glucoloop.arguments import converted
from glucoloop.component.grammar import NAME, component_tree, plain
from glucoloop.component.setting import known_names
from glucoloop.meals import Meal
from glucoloop.patients.catalogue import DEFAULT_PATIENT, patient_entry
from glucoloop.patients.population import Population, population, population_names
from glucoloop.patients.table import DRAWS, ONCE, PROFILE_COLUMNS, PeopleTable
from glucoloop.patients.variation import JointVariation, Variation
from glucoloop.refusal import Refusal
from glucoloop.situations.meal_text import meal_text, parse_meal
from glucoloop.situations.toml import LARGEST_CHARACTERS, read_file, text_of_file
from glucoloop.spreadsheet import text_of_cell
from glucoloop.text import how_many, is_printable

VARY_KEY: Final = "vary"
"""Key of the tables of variation in a file: ``[[vary]]``."""
JOINT_KEY: Final = "joint"
PERSON_KEY: Final = "person"
DRAW_KEY: Final = "draw"
MEALS_COLUMN: Final = "meals"
"""Column of a person's own day: a list of meals, or a text with spaces between them."""
_SUFFIXES: Final = (".toml", ".csv")
_EXAMPLE: Final = f"people.csv, draw={DRAWS[1]}"


def read_population(
    keys: Mapping[str, object], patient: str = DEFAULT_PATIENT.name, name: str = "custom"
) -> Population:
    """Population of a patient from the keys of a file.

    The keys are ``name`` and ``summary``, which may be left out, lists of tables ``vary``, ``joint`` and ``person``,
    and ``draw``, which says how named people are drawn; a population whose keys have no name has `name`. An unknown
    key, a value of the wrong type or out of bounds, and a table that can make a person who cannot be are refused.
    """
    known = ("name", "summary", DRAW_KEY, VARY_KEY, JOINT_KEY, PERSON_KEY)
    for key in keys:
        if key not in known:
            raise Refusal(f"unknown key {key!r} of a population; {known_names(key, known)}")
    for key in ("name", "summary", DRAW_KEY):
        if not isinstance(keys.get(key, ""), str):
            raise Refusal(f"{key} is {keys[key]!r}; give a text")
    called, summary = str(keys.get("name", name)), str(keys.get("summary", ""))
    if not is_printable(called):
        raise Refusal(
            f"the name {called!r} of the population cannot be printed in a line; leave out its control characters"
        )
    vary, joint, rows = (_tables(keys, key) for key in (VARY_KEY, JOINT_KEY, PERSON_KEY))
    variations: list[Variation | JointVariation] = []
    for key, kind, tables in ((VARY_KEY, Variation, vary), (JOINT_KEY, JointVariation, joint)):
        for number, table in enumerate(tables, 1):
            variations.append(_read_variation(kind, f"[[{key}]] number {number}", table))
    people = read_table(rows, patient, str(keys.get(DRAW_KEY, ONCE))) if rows else None
    if DRAW_KEY in keys and people is None:
        raise Refusal(f"{DRAW_KEY} says how named people are drawn, but there is no [[{PERSON_KEY}]]; leave it out")
    return Population(called or name, tuple(variations), summary, patient, people)


def _tables(keys: Mapping[str, object], key: str) -> Sequence[Mapping[str, Any]]:
    tables = keys.get(key, [])
    if not isinstance(tables, list | tuple) or not all(isinstance(table, Mapping) for table in tables):
        what = "person" if key == PERSON_KEY else "parameter" if key == VARY_KEY else "group of parameters"
        raise Refusal(f"{key} is {tables!r}; give a table for each {what}, under [[{key}]]")
    return tables


def _read_variation(kind: type[Any], where: str, table: Mapping[str, object]) -> Any:
    types = typing.get_type_hints(kind)
    try:
        for key in table:
            if key not in types:
                raise Refusal(f"unknown key {key!r} of a variation; {known_names(key, types)}")
        for key in ("parameter", "distribution") if kind is Variation else ("parameters", "covariance"):
            if key not in table:
                raise Refusal(f"{key} is missing; add it")
        if kind is JointVariation:
            return JointVariation(**{key: _of_joint(key, value) for key, value in table.items()})
        return Variation(**{key: converted(key, value, types[key], "Variation") for key, value in table.items()})
    except Refusal as error:
        raise error.within(where) from None


def _of_joint(key: str, value: Any) -> Any:
    """Value of a key of a joint distribution, with lists as tuples."""
    if key == "scale":
        return converted(key, value, str, "JointVariation")
    if not isinstance(value, list | tuple):
        raise Refusal(f"{key} is {value!r}; give a list")
    if key == "covariance":
        return tuple(_of_joint("a row of the covariance", row) for row in value)
    kind = str if key == "parameters" else float
    return tuple(converted(f"{key}[{i}]", item, kind, "JointVariation") for i, item in enumerate(value))


def read_table(rows: Sequence[Mapping[str, Any]], patient: str, draw: str = ONCE) -> PeopleTable:
    """Table of the people of a patient from rows; columns are ``name``, parameters, profile and ``meals``.

    A column that is a parameter of the patient, as weight is of some, is known to whoever doses as well. What is not
    known of a person's profile is left out; parameters are given of all or of none.
    """
    model = patient_entry(patient)
    columns = list(dict.fromkeys(column for row in rows for column in row))
    names, meals = [], []
    for number, row in enumerate(rows, 1):
        name = row.get(NAME)
        if not isinstance(name, str | int) or isinstance(name, bool):
            raise Refusal(f"person number {number} has no name; add it, like name = 'anna'")
        names.append(str(name))
        meals.append(_meals(row.get(MEALS_COLUMN, ()), str(name)))
    values: dict[str, tuple[float, ...]] = {}
    profile: dict[str, tuple[float | None, ...]] = {}
    for column in columns:
        if column in (NAME, MEALS_COLUMN):
            continue
        if column not in PROFILE_COLUMNS or column in model.nominal:
            try:
                model.refuse_unknown(column)
            except Refusal as error:
                raise Refusal(
                    f"column {column!r} is no part of a profile ({', '.join(PROFILE_COLUMNS)}); {error}"
                ) from None
            lacking = [name for name, row in zip(names, rows, strict=True) if row.get(column) is None]
            if lacking:
                raise Refusal(f"{column} of {lacking[0]!r} is missing; give it, or leave the column out")
        known = tuple(
            None if row.get(column) is None else converted(f"{column} of {name!r}", row[column], float, "a person")
            for name, row in zip(names, rows, strict=True)
        )
        if column in model.nominal:
            values[column] = typing.cast(tuple[float, ...], known)
        else:
            profile[column] = known
    return PeopleTable(
        names=tuple(names), values=values, profile=profile, meals=tuple(meals) if any(meals) else (), draws=draw
    )


def _meals(day: Any, name: str) -> tuple[Meal, ...]:
    texts = day.split() if isinstance(day, str) else () if day is None else day
    if not isinstance(texts, list | tuple) or not all(isinstance(text, str) for text in texts):
        raise Refusal(f"meals of {name!r} are {day!r}; give a list, like ['60g@7h', '80g@12h']")
    try:
        return tuple(map(parse_meal, texts))
    except Refusal as error:
        raise error.within(f"meals of {name!r}") from None


def population_keys(population: Population) -> dict[str, object]:
    """The keys from which the same population is read."""
    result: dict[str, Any] = {"name": population.name, "summary": population.summary}
    vary = [_keys(one) for one in population.variations if isinstance(one, Variation)]
    joint = [_keys(one) for one in population.variations if isinstance(one, JointVariation)]
    if vary or not (joint or population.table):
        result[VARY_KEY] = vary
    if joint:
        result[JOINT_KEY] = joint
    table = population.table
    if table is not None:
        result |= {DRAW_KEY: table.draws, PERSON_KEY: []}
        for row, name in enumerate(table.names):
            columns = {column: known[row] for column, known in (*table.profile.items(), *table.values.items())}
            known = {column: value for column, value in columns.items() if value is not None}
            meals = {MEALS_COLUMN: list(map(meal_text, table.meals[row]))} if table.meals else {}
            result[PERSON_KEY].append({NAME: name, **known, **meals})
    return result


def _keys(variation: object) -> dict[str, Any]:
    return {key: _listed(value) for key, value in vars(variation).items() if value is not None}


def _listed(value: Any) -> Any:
    return list(map(_listed, value)) if isinstance(value, tuple) else value


def named_population(text: str, patient: str = DEFAULT_PATIENT.name) -> Population:
    """Population of a patient by its name, or from a file; Refusal if there is none.

    The name of a file ends in ``.toml`` or ``.csv``. ``NAME, draw=with-replacement`` draws named people by the seed, so
    that there may be any number of them.
    """
    tree = plain(component_tree(text, "", _EXAMPLE))
    called, draw = tree.pop(NAME, None), tree.pop(DRAW_KEY, None)
    if not called or tree:
        raise Refusal(f"{text!r} is no population; give its name, and at most {DRAW_KEY}, like {_EXAMPLE!r}")
    result = _population_named(called, patient)
    return result if draw is None else result.drawn_as(draw)


def _population_named(text: str, patient: str) -> Population:
    path = Path(text)
    if path.suffix not in _SUFFIXES:
        known = population_names(patient)
        if text not in known:
            whose = "" if patient == DEFAULT_PATIENT.name else f" of {patient}"
            raise Refusal(
                f"unknown population {text!r}{whose}; {known_names(text, known)}, or give a file like people.toml"
            )
        return population(text, patient=patient)
    of_csv = path.suffix == ".csv"
    keys = {PERSON_KEY: _csv_rows(text_of_file(text, "CSV"), text)} if of_csv else read_file(text).keys
    try:
        people = read_population(keys, patient, path.stem)
    except Refusal as error:
        raise error.within(text) from None
    if not (people.variations or people.table):
        # a file that was cut short must not pass for the nominal patient
        raise Refusal(
            f"{text} has no [[{VARY_KEY}]] table, no [[{JOINT_KEY}]] and no [[{PERSON_KEY}]], so all people would be "
            "the same; add one, or name the preset nominal"
        )
    return people


def _csv_rows(content: str, text: str) -> list[dict[str, Any]]:
    """Rows of a CSV file, with numbers where they can be read; an empty place is not known."""
    if len(content) > LARGEST_CHARACTERS:
        raise Refusal(f"{text} is too large for a table of people: at most {LARGEST_CHARACTERS} characters will do")
    try:
        head, *lines = [
            line for line in csv.reader(io.StringIO(content), strict=True) if any(map(str.strip, line))
        ] or [[]]
    except csv.Error as error:
        raise Refusal(f"{text} is not CSV: {error}") from None
    columns = [column.strip() for column in head]
    for column in columns:
        if not column or columns.count(column) > 1:
            raise Refusal(
                f"{text}: the column {column!r} is {'without a name' if not column else 'there twice'}; rename it"
            )
    rows = []
    for number, line in enumerate(lines, 1):
        if len(line) != len(columns):
            raise Refusal(
                f"{text}: person number {number} has {len(line)} values for {len(columns)} columns; mend the line"
            )
        rows.append({column: _cell(column, cell.strip()) for column, cell in zip(columns, line, strict=True)})
    return rows


def _cell(column: str, text: str) -> Any:
    if column in (NAME, MEALS_COLUMN):
        return text_of_cell(text)
    try:
        return float(text) if text else None
    except ValueError:
        return text  # which is refused as the value of a column


def described_population(name: str, patient: str) -> tuple[dict[str, Any], list[str]]:
    """A population of a patient as plain values, and in lines: who its people are, or how they are drawn."""
    people = population(name, patient=patient)
    table, drawn = people.table, people.distributions()
    result: dict[str, Any] = {"kind": "population", "patient": patient, **population_keys(people)}
    lines = [f"population {name}: {people.summary}"]
    if table is not None:
        own = [*table.profile, *([MEALS_COLUMN] if table.meals else [])]
        lines += [
            f"  {how_many(len(table.names), 'person', 'people')} of {patient}, by name: {', '.join(table.names)}",
            f"  One alone: --patient '{patient}, person={table.names[0]}'; more than there are, by the seed: "
            f"--population '{name}, {DRAW_KEY}={DRAWS[1]}'",
            *([f"  Of each person are known: {', '.join(own)}"] if own else []),
        ]
    elif drawn:
        lines.append(f"  People of {patient}, drawn by the seed; one alone: --patient '{patient}, person=17'")
    meanings = patient_entry(patient).meanings
    for parameter, of in drawn.items():
        meant = f": {meanings[parameter]}" if parameter in meanings else ""
        lines.append(f"  {parameter} from {of.lower:.4g} to {of.upper:.4g}, about {of.centre:.4g} ({of.kind}){meant}")
    return result, lines


def person_of(text: str, patient: str, seed: int) -> Population:
    """One person of a patient, whoever is drawn.

    The text is the name of a person of the patient's default population, or its number where people have no names, like
    ``person=17``; of another population that stands before a colon: ``people.csv:anna``.
    """
    where, _, name = text.rpartition(":")
    people = _population_named(where.strip() or patient_entry(patient).default_population, patient)
    try:
        return people.alone(name.strip(), seed)
    except Refusal as error:
        raise error.within(f"person {text!r} of {patient}") from None
