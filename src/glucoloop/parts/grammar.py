"""Text of a part, as on the command line: ``mpc-se, move_horizon=2``; and the tree that files and JSON hold.

A text without a name, ``move_horizon=2``, sets settings of the part that is there already. A value stays the text that
was typed until the type of its setting is known: only then is ``1:5`` a range and ``06:30`` a time.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final

from glucoloop.refusal import Refusal

NAME: Final = "name"
NONE: Final = "none"
"""Text in place of a part or a list that leaves it out."""
Tree = dict[str, Any]
"""A part as plain values: its name, and the settings that were given; a nested part is a tree."""
_BARE: Final = re.compile(r"[^,='\"()\[\]]+")
DEEPEST: Final = 10
"""Largest number of parts within one another."""


@dataclass(frozen=True)
class GivenValue:
    """A value as it was given, and the option or file in which it stood."""

    value: object
    where: str
    text: bool = True
    """Whether it is a text of the command line, which the type of its setting reads; otherwise it has its type."""
    alone: bool = False
    """Whether the option gives this value alone, so that messages call it by the option."""


def part_tree(text: str, where: str, example: str = "mpc, move_horizon=2") -> Tree:
    """Tree of a part from its text.

    Raises
    ------
    Refusal
        For a text that is no part, or a setting that is given twice.
    """
    tree: Tree = {}
    if not text.strip():
        return tree
    before = f"{where}: " if where else ""
    for place, item in enumerate(_pieces(text, where)):
        key, is_setting, value = (piece.strip() for piece in item.partition("="))
        if not is_setting and place == 0 and key:
            tree[NAME] = GivenValue(unquoted(key), where)
        elif not is_setting or not key.isidentifier() or not value:
            raise Refusal(
                f"{where}: {item.strip()!r} in {text!r} is no setting with a value; write it like {example!r}"
            )
        elif key in tree:
            raise Refusal(f"{before}{key} is given twice in {text!r}; leave one out")
        elif value[0] == "(" and value[-1] == ")":
            tree[key] = part_tree(value[1:-1], where, example)
        else:
            tree[key] = GivenValue(unquoted(value), where)
    return tree


def _pieces(text: str, where: str) -> Iterator[str]:
    """Pieces between commas that stand in no quotes or brackets."""
    start, depth, quote = 0, 0, ""
    before = f"{where}: " if where else ""
    for place, sign in enumerate(text):
        if quote:
            quote = "" if sign == quote else quote
        elif sign in "'\"":
            quote = sign
        elif sign in "([":
            depth += 1
            if depth > DEEPEST:
                raise Refusal(f"{before}{text!r} is nested too deeply for a part")
        elif sign in ")]":
            depth -= 1
        elif sign == "," and depth == 0:
            yield text[start:place]
            start = place + 1
    if quote or depth:
        raise Refusal(f"{before}{text!r} has {'a quotation mark' if quote else 'a bracket'} without its pair; add it")
    yield text[start:]


def unquoted(text: str) -> str:
    """A text without the quotation marks around it."""
    return text[1:-1] if len(text) > 1 and text[0] == text[-1] and text[0] in "'\"" else text


def part_text(tree: Mapping[str, Any]) -> str:
    """Text from which the same tree is read."""
    settings = (f"{key}={_value_text(value)}" for key, value in tree.items() if key != NAME and value is not None)
    return ", ".join([*([_value_text(tree[NAME])] if NAME in tree else []), *settings])


def _value_text(value: Any) -> str:
    if isinstance(value, Mapping):
        return f"({part_text(value)})"
    if isinstance(value, bool):
        return "true" if value else "false"
    text = repr(value).removesuffix(".0") if isinstance(value, float) else str(value)
    quote = "'" if '"' in text else '"'
    return text if _BARE.fullmatch(text) and text == text.strip() else f"{quote}{text}{quote}"


def given(plain: Any, where: str) -> Any:
    """Plain values of a file, each with the place in which it stands."""
    if isinstance(plain, Mapping):
        return {str(key): given(value, where) for key, value in plain.items()}
    if isinstance(plain, list | tuple):
        return [given(value, where) for value in plain]
    return GivenValue(plain, where, text=False)


def plain(tree: Any) -> Any:
    """Given values without their places."""
    if isinstance(tree, Mapping):
        return {key: plain(value) for key, value in tree.items()}
    if isinstance(tree, list | tuple):
        return [plain(value) for value in tree]
    return tree.value if isinstance(tree, GivenValue) else tree


def place(tree: Any) -> str:
    """Option or file in which the first value of a tree stood."""
    if isinstance(tree, GivenValue):
        return tree.where
    for value in tree.values() if isinstance(tree, Mapping) else tree if isinstance(tree, list) else ():
        found = place(value)
        if found:
            return found
    return ""
