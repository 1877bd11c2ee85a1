"""Allocation of all arrays in one workspace: each has a place that others use before and after it."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

_MARK: Final = re.compile(r"§(\d+)\+(\d+)§")
"""Pattern of an element of an array without a place yet: number of the array, and of the element."""


def mark(number: int, element: int) -> str:
    """Text of an element of an array that has no place yet."""
    return f"§{number}+{element}§"


@dataclass(frozen=True)
class Array:
    """An array of the workspace."""

    number: int
    kind: str
    size: int


def placed(lines: Sequence[str], arrays: Sequence[Array]) -> tuple[list[str], dict[str, int]]:
    """Lines with the places of all arrays, and the size of the workspace for each kind.

    Two arrays share a place if one is no longer needed where the other is first written. What a loop needs from before
    it, or what is needed after it, is kept for the whole loop.
    """
    lives = _lives(lines)
    size_of = {array.number: array for array in arrays}
    place: dict[int, int] = {}
    total: dict[str, int] = {}
    done: dict[str, list[int]] = {}
    for number in sorted(lives, key=lambda n: (-size_of[n].size, lives[n])):
        array, (first, last) = size_of[number], lives[number]
        taken = sorted(
            (place[other], place[other] + size_of[other].size)
            for other in done.get(array.kind, [])
            if lives[other][0] <= last and lives[other][1] >= first
        )
        at = 0
        for begin, end in taken:
            if begin - at >= array.size:
                break
            at = max(at, end)
        place[number] = at
        done.setdefault(array.kind, []).append(number)
        total[array.kind] = max(total.get(array.kind, 0), at + array.size)

    def put(found: re.Match[str]) -> str:
        return str(place[int(found.group(1))] + int(found.group(2)))

    return [_tidy(_MARK.sub(put, line)) for line in lines], total


def _tidy(line: str) -> str:
    return re.sub(r" \+ 0\]", "]", line)


def _lives(lines: Sequence[str]) -> dict[int, tuple[int, int]]:
    """The first and the last line of each array."""
    lives: dict[int, tuple[int, int]] = {}
    loops: list[tuple[int, int]] = []
    opened: list[tuple[int, bool]] = []
    for i, line in enumerate(lines):
        if line == "{":
            before = lines[i - 1] if i else ""
            opened.append((i - 1, before.startswith(("for ", "while "))))
        elif line.startswith("}"):
            begin, is_loop = opened.pop()
            if is_loop:
                loops.append((begin, i))
        for found in _MARK.finditer(line):
            number = int(found.group(1))
            first, _ = lives.get(number, (i, i))
            lives[number] = (first, i)
    for begin, end in loops:  # inner ones come before those around them
        for number, (first, last) in lives.items():
            inside = first <= end and last >= begin
            if inside and not (first > begin and last < end):
                lives[number] = (min(first, begin), max(last, end))
    return lives
