"""Write the page that lists the public names of Python: ``python docs/public_api.py`` after one is added or changed.

The tests compare the page with the program, so that no public name or argument changes unseen.
"""

import inspect
import re
from enum import EnumType
from pathlib import Path
from types import ModuleType
from typing import Any

PAGE = Path(__file__).parent / "public-api.md"
MODULES = ("glucoloop", "glucoloop.plugin")
_HEAD = """# Public names

These names of Python are what is stable: [versions and formats](policies.md) says how one of them may change.
A program imports `glucoloop`, and a component of one's own also `glucoloop.plugin`.
The modules that are listed first hold what is needed less often; their contents may change in a minor version.
A class is listed with its arguments, and with the methods that it declares itself.
"""


def page() -> str:
    """Text of the page."""
    import glucoloop
    from glucoloop import plugin

    sections = [_HEAD]
    for name, module in zip(MODULES, (glucoloop, plugin), strict=True):
        things = {key: getattr(module, key) for key in sorted(module.__all__, key=str.lower)}
        listed = [line for key, thing in things.items() for line in _lines(key, thing)]
        sections.append("\n".join([f"## `{name}`", "", *_modules(things), "```text", *listed, "```", ""]))
    return "\n".join(sections)


def _modules(things: dict[str, Any]) -> list[str]:
    names = [f"`{name}`" for name, thing in things.items() if isinstance(thing, ModuleType)]
    return [f"Modules: {', '.join(names)}.", ""] if names else []


def _lines(name: str, thing: Any) -> list[str]:
    if isinstance(thing, ModuleType):
        return []
    if not callable(thing) or (inspect.isclass(thing) and issubclass(thing, Exception)):
        return [name]
    if isinstance(thing, EnumType):
        return [f"{name}: {', '.join(thing.__members__)}"]
    methods = vars(thing).items() if inspect.isclass(thing) else ()
    return [
        name if getattr(thing, "_is_protocol", False) else name + _signature(thing),
        *(
            f"    .{key}{_signature(getattr(thing, key))}"
            for key, method in methods
            if not key.startswith("_") and inspect.isfunction(getattr(method, "__func__", method))
        ),
    ]


def _signature(thing: Any) -> str:
    """Names of the arguments with simple defaults, without annotations."""
    plain = [
        parameter.replace(annotation=parameter.empty, default=_default(parameter.default))
        for parameter in inspect.signature(thing).parameters.values()
        if parameter.name != "self" and not parameter.name.startswith("_")
    ]
    return re.sub(r"'\.\.\.'", "...", str(inspect.Signature(plain)))


def _default(value: Any) -> Any:
    simple = value is inspect.Parameter.empty or value is None or isinstance(value, bool | int | float | str)
    return value if simple or value == () else "..."


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
