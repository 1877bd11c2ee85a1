"""Text of a case of a comparison: ``careful: mpc, move_weight=1``."""

from __future__ import annotations

from glucoloop.parts.keyed_values import keyed_values, value_of
from glucoloop.refusal import Refusal


def parse_case(text: str) -> dict[str, object]:
    """Keys of a case from ``[LABEL:] [CONTROLLER,] [KEY=VALUE, ...]``; without a label, the rest is the label.

    Raises
    ------
    ValueError
        For an empty case or label, a key without a value, or a key that is given twice.
    """
    label, colon, rest = text.partition(":")
    # A colon inside a value, as in a path, does not end a label.
    if not colon or "=" in label or "," in label:
        label, rest = text, text
    label = label.strip()
    parts = [part.strip() for part in rest.split(",")]
    if not label or parts == [""]:
        raise Refusal(f"{text!r} is not a case; write one like 'mpc' or 'careful: mpc, move_weight=1'")
    named = {} if "=" in parts[0] or not parts[0] else {"controller": value_of(parts.pop(0))}
    keys = keyed_values(parts, f"case {text!r}", "move_weight=1")
    if named and "controller" in keys:
        raise Refusal(f"controller is given twice in the case {text!r}; leave one out")
    return {"label": label, **named, **keys}
