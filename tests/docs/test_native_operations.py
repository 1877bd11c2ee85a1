"""The page on speed lists the primitives that native code has, no more and no fewer."""

import re
from pathlib import Path

from glucoloop.native import flatten, primitives

SPEED = Path(__file__).parents[2] / "docs" / "speed.md"


def test_the_primitives_of_native_code_are_listed():
    text = SPEED.read_text(encoding="utf-8").split("### What native code has")[1]
    rows = [line.split("|")[2] for line in text.splitlines() if line.startswith("| ")][2:]
    listed = [name for row in rows for name in re.findall(r"`([\w-]+)`", row)]
    handled = {name.removeprefix("_do_") for name in vars(flatten.Flattener) if name.startswith("_do_")}
    tables = (flatten.ELEMENTWISE, flatten.FUNCTIONS, flatten.REDUCTIONS, flatten.MOVES, primitives.CALLS)
    listed = [name.replace("-", "_") for name in listed]  # as methods are named
    assert sorted(listed) == sorted({*handled, "gt", "ge"}.union(*tables))
