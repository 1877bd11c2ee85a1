"""JSON that every parser accepts: a number that is not finite becomes null."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any

import glucoloop


def json_text(value: object) -> str:
    """Indented JSON of plain values."""
    return json.dumps(_finite(value), indent=2, allow_nan=False, ensure_ascii=False)


def with_version(report: Mapping[str, Any]) -> dict[str, Any]:
    """A report with the version that made it, first."""
    return {"version": glucoloop.__version__, **report}


def _finite(value: Any) -> Any:
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(key): _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    return value
