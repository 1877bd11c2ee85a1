"""Small C functions that generated code calls; only those that are called are written."""

from __future__ import annotations

import functools
import importlib.resources
import re
from collections.abc import Iterable
from typing import Final

from glucoloop.native.targets.c.numbers import Format

COLUMNS: Final = 10
"""Number of columns that functions of matrices take at once, whose sums stay in registers."""


def template(name: str) -> str:
    """A file in C that generated code is made of."""
    return (importlib.resources.files("glucoloop.native.targets.c") / "templates" / name).read_text(encoding="utf-8")


def _for_each_column(result: re.Match[str]) -> str:
    """A line that is marked, for each of the columns."""
    # MISRA C:2012, rule 2.2: nothing is added to the first place.
    texts = (result[2].replace(" + #", f" + {i}" if i else "").replace("#", str(i)) for i in range(COLUMNS))
    return "\n".join(f"{result[1]}{text}" for text in texts)


@functools.cache
def _sources() -> dict[str, str]:
    """Text of each function by its name."""
    text = re.sub(r"^( *)@each@ (.*)$", _for_each_column, template("helpers.c"), flags=re.MULTILINE)
    functions = text.replace("@COLUMNS@", str(COLUMNS)).strip().split("\n\n")
    return {re.findall(r"^static \S+ (\w+)\(", function, re.MULTILINE)[0]: function for function in functions}


def helpers(text: Iterable[str], format: Format) -> list[str]:
    """Definitions of the functions that lines of C call, each after those that it calls itself."""
    sources, needed = _sources(), set[str]()
    waiting = ["\n".join(text)]
    while waiting:
        for name in set(re.findall(r"\bgl_\w+(?=\()", waiting.pop())) & sources.keys() - needed:
            needed.add(name)
            waiting.append(sources[name])
    lines: list[str] = []
    for name, source in sources.items():
        if name in needed:
            lines += [*_filled(source, format).splitlines(), ""]
    return lines


def _filled(source: str, format: Format) -> str:
    shift = format.mantissa_bits
    texts = {
        "real": format.type,
        "f": format.suffix,
        "bits": format.bits,
        "u": format.bits_suffix,
        "shift": str(shift),
        "signbit": str(31 if format.type == "float" else 63),
        "bias": str(format.bias),
        "mask": str(2 * format.bias + 1),
        "magic": f"0x1p+{shift}{format.suffix}",
        "MAX": "FLT_MAX" if format.type == "float" else "DBL_MAX",
    }
    return re.sub(r"@(\w+)@", lambda result: texts[result.group(1)], source)
