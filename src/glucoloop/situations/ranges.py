"""Ranges of a controller's settings, for searches: ``mpc, move_horizon=1:4, move_weight=0|1|3``.

In a tree they are parted from the controller, whose settings have no ranges, and written back to it.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any, Final

from glucoloop.component.grammar import Leaf, Tree, as_table, place, plain
from glucoloop.refusal import Refusal
from glucoloop.units import ending_of

RANGES: Final = "ranges"
"""Setting of a search that holds the ranges, as texts by the name of the setting."""


def ranges_parted(tree: Mapping[str, Any], tuned: Collection[str], *, always: bool) -> Tree:
    """A tree whose ranges stand apart from the settings of its first controller.

    The settings `tuned` may be ranges; with `always` a single value of such a setting is a range too.
    """
    result = dict(tree)
    leaf = result.get("controller")
    if leaf is None:
        return result
    tables = list(map(as_table, leaf if isinstance(leaf, list) else [leaf]))
    if not tables or not isinstance(tables[0], Mapping):
        return result
    names = {name.removesuffix(ending_of(name)): name for name in tuned if name not in tables[0]}
    table = {str(names.get(key, key)): value for key, value in tables[0].items()}
    first = {key: value for key, value in table.items() if key not in tuned or not (always or _is_range(value))}
    ranges = {key: Leaf(_text(key, value), place(value)) for key, value in table.items() if key not in first}
    result["controller"] = [first, *tables[1:]] if first else tables[1:]
    if not result["controller"]:
        del result["controller"]
    return {**result, RANGES: ranges} if ranges else result


def with_ranges(tree: Tree, ranges: Mapping[str, str]) -> Tree:
    """A tree with its ranges among the settings of its first controller."""
    result = {key: value for key, value in tree.items() if key != RANGES}
    if ranges:
        first, *others = result.get("controller") or [{}]
        result["controller"] = [{**first, **ranges}, *others]
    return result


def _is_range(leaf: Any) -> bool:
    value = plain(leaf)
    return isinstance(value, list) or (isinstance(value, str) and bool({":", "|"} & set(value)))


def _text(name: str, leaf: Any) -> str:
    """A range as text; a file may hold a number or a list of numbers."""
    value = plain(leaf)
    if isinstance(value, list) and value:
        return "|".join(_text(name, item) for item in value)
    if isinstance(value, str | int | float) and not isinstance(value, bool):
        return str(value)
    at = place(leaf)
    raise Refusal(f"{f'{at}: ' if at else ''}{name} is {value!r}; write it like 1:4 or 0|1|3")
