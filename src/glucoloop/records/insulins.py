"""Names of long-acting insulins, as people and apps write them."""

from __future__ import annotations

import re
from typing import Final

_LONG_ACTING: Final = re.compile(
    r"(?i)long[ -]?acting|glargin|detemir|degludec|icodec|isophane|\bnph\b|lantus|toujeo|basaglar|abasaglar|semglee|"
    r"rezvoglar|lusduna|levemir|tresiba|awiqli|insulatard|protaphane?|protamine|humulin n\b|novolin n\b|ultralente"
)


def is_long_acting(name: str) -> bool:
    """Whether a name is that of a long-acting or intermediate insulin, as ``Lantus`` or ``insulin degludec``.

    Examples
    --------
    >>> is_long_acting("Lantus"), is_long_acting("NovoRapid")
    (True, False)
    """
    return _LONG_ACTING.search(name) is not None
