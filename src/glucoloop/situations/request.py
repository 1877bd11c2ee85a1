"""Reading of what is asked for from a tree of given values, in two steps: bounds and types at once, then the rest.

The first step needs no numerical library, so that a refusal comes at once; the second completes what was given by what
is usual, which imports the patient.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any, TypeVar

from glucoloop.parts.grammar import Tree, place, plain
from glucoloop.parts.part import Part, read
from glucoloop.parts.setting import known_names
from glucoloop.refusal import Refusal

P = TypeVar("P", bound=Part)


def read_root(root: type[P], tree: Mapping[str, Any]) -> P:
    """A request with bounds and types checked; implausible values are asked about unless that was allowed.

    Raises
    ------
    Refusal
        For an unknown part or setting, or a value that is not possible.
    """
    prepared = getattr(root, "prepared", dict)(tree)
    return read(root, prepared, ask=plain(tree.get("allow_unusual")) is not True, where="")


def complete(asked: P) -> P:
    """A request with everything that is usual, and asked about where it is implausible together.

    Raises
    ------
    Refusal
        For what is at odds.
    """
    whole = asked.completed()
    ask = getattr(whole, "ask", None)
    if ask is not None and not getattr(whole, "allow_unusual", False):
        ask()
    return whole


def asked_for(root: type[P], tree: Mapping[str, Any]) -> P:
    """Both steps at once."""
    return complete(read_root(root, tree))


def parted(
    tree: Mapping[str, Any], *roots: type[Part], refused: Collection[str] = (), what: str = ""
) -> tuple[Tree, ...]:
    """A tree of several roots as one for each; a setting belongs to the first that has it.

    Parameters
    ----------
    tree : mapping
    roots : type
    refused : collection of str
        Settings that none of them has here.
    what : str
        Name of the request in messages: ``"a stress test"``.

    Raises
    ------
    Refusal
        For a key that none has.
    """
    own = set(roots[0].settings()) if len(roots) > 1 else set()
    trees: tuple[Tree, ...] = tuple({} for _ in roots)
    for key, leaf in tree.items():
        at = place(leaf)
        if key in refused and key not in own:
            raise Refusal(f"{at if at.startswith('--') else key} is no part of {what}; leave it out")
        for root, of_root in zip(roots, trees, strict=True):
            if key in root.settings():
                of_root[key] = leaf
                break
        else:
            known = [name for root in roots for name in root.settings() if name not in refused]
            prefix = f"{at}: " if at and not at.startswith("--") else ""
            raise Refusal(f"{prefix}unknown key {key!r} of {what}; {known_names(key, known)}")
    return trees
