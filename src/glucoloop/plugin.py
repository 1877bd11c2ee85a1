"""Names that a component of one's own imports: classes that it extends, and values that it takes and gives.

A sensor, for example, is a class that extends `SensorComponent`, with its settings as fields that `About` describes,
and gives a `Reading`. The page "Add your own" has a whole example of each kind. These names, and those of `glucoloop`
itself, are what is stable; the page "Versions and formats" says how they may change.
"""

import ast
import importlib
from pathlib import Path
from typing import Any, Final

_MODULES: Final = {
    name.name: statement.module
    for statement in ast.parse(Path(__file__).with_suffix(".pyi").read_text(encoding="utf-8")).body
    if isinstance(statement, ast.ImportFrom) and statement.module is not None
    for name in statement.names
}
"""Module of each name, from the stub of this module; it is imported when the name is first used."""
__all__ = sorted(_MODULES)


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(importlib.import_module(_MODULES[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return __all__
