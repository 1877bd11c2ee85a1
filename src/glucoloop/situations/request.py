"""Reading of what is asked for from a tree of given values, in two steps: bounds and types at once, then the rest.

The first step needs no numerical library, so that a refusal comes at once; the second completes what was given by
defaults, which imports the patient.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeVar

from glucoloop.component.base import Component
from glucoloop.component.grammar import plain
from glucoloop.component.request import Request, completed, read

P = TypeVar("P", bound=Component)


def read_root(root: type[P], tree: Mapping[str, Any], *, allow_unusual: bool = False) -> Request[P]:
    """A request with bounds and types checked; implausible values are refused unless they were allowed."""
    prepared = getattr(root, "prepared", dict)(tree)
    return read(root, prepared, allow_unusual=allow_unusual or plain(tree.get("allow_unusual")) is True, source="")


def configuration_from(root: type[P], tree: Mapping[str, Any]) -> P:
    """A configuration from a tree of given values; what is at odds, or implausible together, is refused."""
    whole = completed(read_root(root, tree))
    if hasattr(whole, "refuse_unusual") and not getattr(whole, "allow_unusual", False):
        whole.refuse_unusual()
    return whole
