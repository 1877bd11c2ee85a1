"""Records: a pytree of arrays as a C structure whose fields are named after the tree."""

from __future__ import annotations

import keyword
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import jax
import numpy as np
import numpy.typing as npt

from glucoloop.native.targets.c.numbers import REAL, TRUTH, WHOLE, Format, kind_of


@dataclass(frozen=True)
class Field:
    """One field of a structure."""

    name: str
    path: str
    """Path of the field in the tree."""
    kind: str
    shape: tuple[int, ...]

    @property
    def size(self) -> int:
        """Count of numbers in the field."""
        return math.prod(self.shape)

    @property
    def is_array(self) -> bool:
        """Whether it is an array in C."""
        return self.shape != ()


@dataclass(frozen=True)
class Structure:
    """A structure that a function takes or fills by a pointer."""

    pointer: str
    """Name of the pointer in the function."""
    fields: Sequence[Field]

    @property
    def layout(self) -> list[Field]:
        """Fields that are not empty, as they lie in memory: real numbers first, then whole ones of 32 bits."""
        return sorted((field for field in self.fields if field.size), key=lambda field: field.kind != REAL)

    def element(self, field: Field, index: int | str = 0) -> str:
        """An element of a field, as C text."""
        place = f"{self.pointer}->{field.name}"
        return f"{place}[{index}]" if field.is_array else place

    def elements(self) -> list[tuple[str, str]]:
        """All elements in order: C text and kind."""
        return [(self.element(field, i), field.kind) for field in self.fields for i in range(field.size)]

    def memory(self, precision: str) -> np.dtype[Any]:
        """Places in memory, the lowest byte of a number first; see `declaration`."""
        real = np.dtype(precision).newbyteorder("<")
        parts = [(field.name, real if field.kind == REAL else np.dtype("<i4"), (field.size,)) for field in self.layout]
        filling = [("reserved", np.dtype("<i4"), (1,))]
        whole = np.dtype(parts or filling)
        return np.dtype([*parts, *filling]) if whole.itemsize % real.itemsize else whole

    def filled(self, leaves: Sequence[Any], precision: str) -> npt.NDArray[Any]:
        """The structure in memory, with the leaves of the tree."""
        room = np.zeros((), self.memory(precision))
        for field, leaf in zip(self.fields, leaves, strict=True):
            if field.size:
                room[field.name] = np.ravel(leaf)
        return room

    def leaves(self, room: npt.NDArray[Any], precision: str) -> list[npt.NDArray[Any]]:
        """Leaves of the tree of a structure in memory."""
        none = np.zeros(0, precision)
        return [np.array(room[f.name] if f.size else none).reshape(f.shape) for f in self.fields]


def record(pointer: str, tree: Any) -> Structure:
    """A structure for a pytree of arrays or shapes; empty arrays have no field, but keep their place in `fields`."""
    names: dict[str, int] = {}
    fields = []
    for path, leaf in jax.tree_util.tree_leaves_with_path(tree):
        name = _identifier(*(_part(key) for key in path))
        names[name] = names.get(name, 0) + 1
        if names[name] > 1:
            name = f"{name}_{names[name]}"
        fields.append(Field(name, jax.tree_util.keystr(path).lstrip("."), kind_of(leaf.dtype), tuple(leaf.shape)))
    return Structure(pointer, fields)


def declaration(
    name: str, structure: Structure, format: Format, comment: str, meanings: Mapping[str, str] | None = None
) -> list[str]:
    """The structure in C, with `Structure.held` in their order, so that there is no gap inside.

    The comment of a field is its meaning, or else the form of its numbers where the type does not tell it.
    """
    lines = [f"/* {comment} */", "typedef struct", "{"]
    for field in structure.layout:
        type_name = format.type if field.kind == REAL else "int32_t"
        size = f"[{field.size}]" if field.is_array else ""
        shape = f"shape {field.shape}, row by row" if len(field.shape) > 1 else ""
        truth = "0: no, otherwise: yes" if field.kind == TRUTH else ""
        whole = "a whole number" if field.kind == WHOLE else ""
        remark = "; ".join(text for text in (shape, truth, whole) if text)
        remark = remark if meanings is None else meanings.get(field.name, remark)
        lines.append(f"  {type_name} {field.name}{size};" + (f" /* {remark} */" if remark else ""))
    words = sum(field.size for field in structure.layout if field.kind != REAL)
    if format.type == "double" and words % 2:
        lines.append("  int32_t reserved; /* fills the structure to a multiple of 8 bytes; 0 */")
    if not structure.layout:
        lines.append("  int32_t reserved; /* this controller has no state; 0 */")
    return [*lines, f"}} {name};"]


def _part(key: Any) -> str:
    """One step of a path through a tree."""
    for attribute in ("name", "key", "idx"):
        if hasattr(key, attribute):
            return str(getattr(key, attribute))
    return str(key)


_C_WORDS: Final = frozenset(
    re.findall(r"\w+", """
    auto break case char const continue default do double else enum extern float for goto if inline int long
    register restrict return short signed sizeof static struct switch typedef union unsigned void volatile while
    bool
    """)
)  # fmt: skip


def _identifier(*parts: object) -> str:
    """A name in C of the parts of a path."""
    text = re.sub(r"\W+", "_", "_".join(str(part) for part in parts)).strip("_")
    text = text or "value"
    return f"n{text}" if text[0].isdigit() or text in _C_WORDS or keyword.iskeyword(text) else text
