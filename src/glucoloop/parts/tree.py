"""Trees of parts, of which an upper one is laid over a lower one."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from glucoloop.parts.grammar import DEEPEST, NAME, NONE, GivenValue, Tree, part_tree, place, plain
from glucoloop.parts.setting import known_names, shown
from glucoloop.refusal import Refusal


def over(lower: Any, upper: Any) -> Any:
    """Both trees as one: a part that is named again replaces the part, another setting replaces the setting.

    A part that is named again by the name that it has is replaced too: what is not said then is as usual. A part
    without a name changes the settings of the one that is there.
    """
    if not isinstance(upper, Mapping) or NAME in upper:
        return upper
    there = _there(lower)
    if not isinstance(there, Mapping):
        return upper
    return {**there, **{key: over(there.get(key), value) for key, value in upper.items()}}


def put(tree: Tree, path: str, value: str, where: str) -> Tree:
    """A tree with one setting by its path: ``controller.move_weight``, ``sensor.lag.lag_min``, ``faults.2.start_min``.

    In a list a part is found by its label, its name, or its place from 1; where there is only one, it needs none.

    Raises
    ------
    Refusal
        For a path to nothing.
    """
    first, _, rest = path.partition(".")
    if rest.count(".") > DEEPEST:
        raise Refusal(f"{where}: {shown(path)} is longer than any path to a setting")
    if not rest:
        return {**tree, **part_tree(f"{first}={value}", where)}
    inner = _there(tree.get(first, {}))
    if not isinstance(inner, list):
        if not isinstance(inner, Mapping):
            raise Refusal(f"{where}: {first} is {plain(inner)!r} and no part, so it has no setting {rest!r}")
        return {**tree, first: put(dict(inner), rest, value, where)}
    tables = as_tables(inner, first)
    at, rest = _found(tables, first, rest, where)
    return {**tree, first: [put(one, rest, value, where) if i == at else one for i, one in enumerate(tables)]}


def _found(tables: list[Any], of: str, path: str, where: str) -> tuple[int, str]:
    """Place of a part in a list, and the path within it."""
    which, _, rest = path.partition(".")
    names = [str(plain(table.get("label", table.get(NAME, "")))) for table in tables]
    if names.count(which) == 1 and rest:
        return names.index(which), rest
    if which.isdecimal() and 1 <= int(which) <= len(tables) and rest:
        return int(which) - 1, rest
    if len(tables) == 1 and which not in names:
        return 0, path
    advice = "there are none" if not names else known_names(which, names)
    if names.count(which) > 1:
        advice = f"there are {names.count(which)} of that name; name one by its place, like {of}.1"
    raise Refusal(f"{where}: {of} has no {which!r}; {advice}")


def _there(leaf: Any) -> Any:
    """A part whose settings are changed; one that was left out has none of its own."""
    return {} if plain(leaf) == NONE else as_table(leaf)


def as_table(leaf: Any) -> Any:
    """A part of a tree as a table, also where it stands as a text."""
    if isinstance(leaf, GivenValue) and isinstance(leaf.value, str):
        return part_tree(leaf.value, leaf.where)
    return leaf


def as_tables(leaf: Any, of: str) -> list[Tree]:
    """The parts of a list, or one alone, each as a table.

    Raises
    ------
    Refusal
        For a value that is no part.
    """
    tables = [as_table(item) for item in (leaf if isinstance(leaf, list) else [leaf])]
    for table in tables:
        if not isinstance(table, Mapping):
            raise Refusal(f"{place(table)}: {of} holds {shown(plain(table))}, which is no part; give a text or a table")
    return tables
