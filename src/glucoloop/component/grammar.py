"""Text of a component, as on the command line: ``mpc-se, move_horizon=2``; and the tree that files and JSON hold.

A text without a name, ``move_horizon=2``, sets settings of the component that is there already. A value stays the text
that was typed until the type of its setting is known: only then is ``1:5`` a range and ``06:30`` a time. A list stands
in brackets, and a component with settings in parentheses: ``habits=[skipped, (snack, time=15h)]``.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final

from glucoloop.component.setting import known_names
from glucoloop.refusal import Refusal
from glucoloop.text import shown

NAME: Final = "name"
NONE: Final = "none"
"""Text in place of a component or a list that leaves it out."""
Tree = dict[str, Any]
"""A component as plain values: its name, and the explicit settings; a nested component is a tree."""
_BARE: Final = re.compile(r"[^,='\"()\[\]]+")
_DEEPEST: Final = 10
"""Largest number of components within one another."""


@dataclass(frozen=True)
class Leaf:
    """A value as it was given, and the option or file in which it stood."""

    value: object
    source: str
    text: bool = True
    """Whether it is a text of the command line, which the type of its setting reads; otherwise it has its type."""
    by_option: bool = False
    """Whether messages call the value by its option, which gives this value alone."""


def component_tree(text: str, source: str, example: str = "mpc, move_horizon=2") -> Tree:
    """Tree of a component from its text; Refusal for a text that is no component, or a setting that is given twice."""
    tree: Tree = {}
    if not text.strip():
        return tree
    before = f"{source}: " if source else ""
    for number, item in enumerate(_pieces(text, before)):
        key, is_setting, value = (piece.strip() for piece in item.partition("="))
        if not is_setting and number == 0 and key:
            tree[NAME] = Leaf(_unquoted(key), source)
        elif not is_setting or not key.isidentifier() or not value:
            raise Refusal(
                f"{source}: {item.strip()!r} in {text!r} is no setting with a value; write it like {example!r}"
            )
        elif key in tree:
            raise Refusal(f"{before}{key} is given twice in {text!r}; leave one out")
        elif value[0] == "(" and value[-1] == ")":
            tree[key] = component_tree(value[1:-1], source, example)
        elif value[0] == "[" and value[-1] == "]":
            tree[key] = _listed(value[1:-1], source, example)
        else:
            tree[key] = Leaf(_unquoted(value), source)
    return tree


def _listed(text: str, source: str, example: str) -> list[Any]:
    """Items of a list from the text between its brackets."""
    items = [piece.strip() for piece in _pieces(text, f"{source}: " if source else "")] if text.strip() else []
    return [
        component_tree(item[1:-1], source, example) if item[:1] == "(" else Leaf(_unquoted(item), source)
        for item in items
    ]


def _pieces(text: str, before: str) -> Iterator[str]:
    """Pieces between commas that stand in no quotes or brackets."""
    start, depth, quote = 0, 0, ""
    for at, sign in enumerate(text):
        if quote:
            quote = "" if sign == quote else quote
        elif sign in "'\"":
            quote = sign
        elif sign in "([":
            depth += 1
            if depth > _DEEPEST:
                raise Refusal(f"{before}{text!r} is nested too deeply for a component")
        elif sign in ")]":
            depth -= 1
        elif sign == "," and depth == 0:
            yield text[start:at]
            start = at + 1
    if quote or depth:
        raise Refusal(f"{before}{text!r} has {'a quotation mark' if quote else 'a bracket'} without its pair; add it")
    yield text[start:]


def _unquoted(text: str) -> str:
    return text[1:-1] if len(text) > 1 and text[0] == text[-1] and text[0] in "'\"" else text


def component_text(tree: Mapping[str, Any]) -> str:
    """Text from which the same tree is read."""
    settings = (f"{key}={_value_text(value)}" for key, value in tree.items() if key != NAME and value is not None)
    return ", ".join([*([_value_text(tree[NAME])] if NAME in tree else []), *settings])


def _value_text(value: Any) -> str:
    if isinstance(value, Mapping):
        return component_text(value) if value.keys() == {NAME} else f"({component_text(value)})"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_value_text, value))}]"
    if isinstance(value, bool):
        return "true" if value else "false"
    text = repr(value).removesuffix(".0") if isinstance(value, float) else str(value)
    quote = "'" if '"' in text else '"'
    return text if _BARE.fullmatch(text) and text == text.strip() else f"{quote}{text}{quote}"


def as_tree(plain: Any, source: str) -> Any:
    """Plain values of a file, each with the place in which it stands."""
    if isinstance(plain, Mapping):
        return {str(key): as_tree(value, source) for key, value in plain.items()}
    if isinstance(plain, list | tuple):
        return [as_tree(value, source) for value in plain]
    return Leaf(plain, source, text=False)


def plain(tree: Any) -> Any:
    """The values of a tree without their places."""
    if isinstance(tree, Mapping):
        return {key: plain(value) for key, value in tree.items()}
    if isinstance(tree, list | tuple):
        return [plain(value) for value in tree]
    return tree.value if isinstance(tree, Leaf) else tree


def place(tree: Any) -> str:
    """Option or file in which the first value of a tree stood."""
    if isinstance(tree, Leaf):
        return tree.source
    inner = tree.values() if isinstance(tree, Mapping) else tree if isinstance(tree, list) else ()
    return next(filter(None, map(place, inner)), "")


def over(lower: Any, upper: Any) -> Any:
    """Both trees as one: a component that is named again replaces the component, another setting replaces the setting.

    A component that is named again by the name that it has is replaced too: what is not said then has its default. A
    component without a name changes the settings of the one that is there.
    """
    if not isinstance(upper, Mapping) or NAME in upper:
        return upper
    there = _changed(lower)
    if not isinstance(there, Mapping):
        return upper
    return {**there, **{key: over(there.get(key), value) for key, value in upper.items()}}


def put(tree: Tree, path: str, value: str, source: str) -> Tree:
    """A tree with one setting by its path: ``controller.move_weight``, ``sensor.lag.lag_min``, ``faults.2.start_min``.

    In a list a component is found by its label, its name, or its place from 1; where there is only one, it needs none.
    A path to nothing is refused.
    """
    first, _, rest = path.partition(".")
    if rest.count(".") > _DEEPEST:
        raise Refusal(f"{source}: {shown(path)} is longer than any path to a setting")
    if not rest:
        return {**tree, **component_tree(f"{first}={value}", source)}
    inner = _changed(tree.get(first, {}))
    if not isinstance(inner, list):
        if not isinstance(inner, Mapping):
            raise Refusal(f"{source}: {first} is {plain(inner)!r} and no component, so it has no setting {rest!r}")
        return {**tree, first: put(dict(inner), rest, value, source)}
    tables = as_tables(inner, first)
    at, rest = _place_of(tables, first, rest, source)
    return {**tree, first: [put(one, rest, value, source) if i == at else one for i, one in enumerate(tables)]}


def _place_of(tables: list[Any], setting: str, path: str, source: str) -> tuple[int, str]:
    """Place of a component in the list of a setting, and the path within it."""
    which, _, rest = path.partition(".")
    names = [str(plain(table.get("label", table.get(NAME, "")))) for table in tables]
    if names.count(which) == 1 and rest:
        return names.index(which), rest
    if which.isdecimal() and 1 <= int(which) <= len(tables) and rest:
        return int(which) - 1, rest
    if len(tables) == 1 and which not in names:
        return 0, path
    advice = known_names(which, names)
    if names.count(which) > 1:
        advice = f"there are {names.count(which)} of that name; name one by its place, like {setting}.1"
    raise Refusal(f"{source}: {setting} has no {which!r}; {advice}")


def _changed(leaf: Any) -> Any:
    """A component whose settings are changed; one that was left out has none of its own."""
    return {} if plain(leaf) == NONE else as_table(leaf)


def as_table(leaf: Any, tree_of: Callable[[str, str], Tree] = component_tree) -> Any:
    """A component of a tree as a table, also where it stands as a text."""
    if isinstance(leaf, Leaf) and isinstance(leaf.value, str):
        return tree_of(leaf.value, leaf.source)
    return leaf


def as_tables(leaf: Any, setting: str) -> list[Tree]:
    """The components of the list of a setting, or one alone, each as a table; another value is refused."""
    tables = [as_table(item) for item in (leaf if isinstance(leaf, list) else [leaf])]
    for table in tables:
        if not isinstance(table, Mapping):
            raise Refusal(
                f"{place(table)}: {setting} holds {shown(plain(table))}, which is no component; give a text or a table"
            )
    return tables
