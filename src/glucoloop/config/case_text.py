"""Cases of a comparison as people write them: ``careful: mpc, move_weight=1``."""

from __future__ import annotations

import tomllib


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
        raise ValueError(f"{text!r} is not a case; write one like 'mpc' or 'careful: mpc, move_weight=1'")
    keys: dict[str, object] = {}
    for position, part in enumerate(parts):
        key, equals, value = (piece.strip() for piece in part.partition("="))
        if not equals and position == 0:
            key, value = "controller", key
        if not key or not value:
            raise ValueError(f"{part!r} in the case {text!r} is not a key with a value; write it like move_weight=1")
        if key in keys:
            raise ValueError(f"{key} is given twice in the case {text!r}; leave one out")
        keys[key] = _value(value)
    return {"label": label, **keys}


def _value(text: str) -> object:
    """A number or a truth value as TOML has them, and else the text itself."""
    try:
        value = tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text
    return value if isinstance(value, bool | int | float | str) else text
