"""Names of long-acting insulins, as people and apps write them."""

from __future__ import annotations

import re
from typing import Final

_LONG_ACTING: Final = re.compile(
    r"(?i)long[ -]?acting|glar(?:ig|g)in|detemir|degludec|icodec|isophane|\bnph\b|lantus|toujeo|basaglar|abasaglar|"
    r"semglee|rezvoglar|lusduna|levemir|tresiba|awiqli|insulatard|protaphane?|protamine|humulin n\b|novolin n\b|"
    r"ultralente"
)


def is_long_acting(name: str) -> bool:
    """Whether a name is that of a long-acting or intermediate insulin, as ``Lantus`` or ``insulin degludec``.

    Examples
    --------
    >>> is_long_acting("Lantus"), is_long_acting("NovoRapid")
    (True, False)
    """
    return _LONG_ACTING.search(name) is not None


_MIX: Final = re.compile(r"(?i)(\d\d) ?/ ?(\d\d)|\bmix(?:tard)? ?(\d\d)|\b(\d\d) ?R\b")
"""Numbers in the name of a premixed insulin: intermediate and rapid-acting parts, or the latter alone."""


def rapid_share(name: str) -> float:
    """Share of an insulin that acts at once: 1 of a rapid-acting or regular one, 0 of a long-acting one.

    Examples
    --------
    >>> rapid_share("insulin aspart 70/30"), rapid_share("Novolin 50R"), rapid_share("insulin glargine")
    (0.3, 0.5, 0.0)
    """
    mix = _MIX.search(name)
    if mix is None:
        return 0.0 if is_long_acting(name) else 1.0
    first, second, *alone = mix.groups()
    if first is not None:
        return min(float(first), float(second)) / 100.0
    return float(next(number for number in alone if number)) / 100.0
