"""Allocation of all arrays in one workspace: each has a place that others use before and after it."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

_MARK: Final = re.compile(r"§(\d+)\+(\d+)§")
"""Pattern of an element of an array without a place yet: number of the array, and of the element."""


_ATTEMPTS: Final = 100
"""Largest number of orders in which arrays are given their places."""

_Lives = dict[int, tuple[int, int]]
"""First and last line of each array, by its number."""


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
    place: dict[int, int] = {}
    total: dict[str, int] = {}
    for kind in dict.fromkeys(array.kind for array in arrays if array.number in lives):
        of_kind = [array for array in arrays if array.kind == kind and array.number in lives]
        places_of_kind, total[kind] = _packed(of_kind, lives)
        place.update(places_of_kind)

    def replacement(result: re.Match[str]) -> str:
        return str(place[int(result.group(1))] + int(result.group(2)))

    return [_MARK.sub(replacement, line).replace(" + 0]", "]") for line in lines], total


def _packed(arrays: Sequence[Array], lives: _Lives) -> tuple[dict[int, int], int]:
    """A place for each array, and the size of all.

    The largest come first. While gaps remain, those that lie beyond what is needed at any one line come before all
    others in another attempt, and the best attempt counts.
    """
    needed = max(
        sum(other.size for other in arrays if lives[other.number][0] <= line <= lives[other.number][1])
        for line in {lives[array.number][0] for array in arrays}
    )
    order = sorted(arrays, key=lambda array: (-array.size, lives[array.number]))
    best = result = _in_order(order, lives)
    for _ in range(1, _ATTEMPTS):
        if best[1] == needed:
            break
        beyond = [array for array in order if result[0][array.number] + array.size > needed]
        order = [*beyond, *(array for array in order if array not in beyond)]
        result = _in_order(order, lives)
        best = min(best, result, key=lambda of_order: of_order[1])
    return best


def _in_order(order: Sequence[Array], lives: _Lives) -> tuple[dict[int, int], int]:
    """The first place that is free for each array, one after the other, and the size of all."""
    place: dict[int, int] = {}
    total = 0
    for array in order:
        first, last = lives[array.number]
        occupied = sorted(
            (place[other.number], place[other.number] + other.size)
            for other in order[: len(place)]
            if lives[other.number][0] <= last and lives[other.number][1] >= first
        )
        at = 0
        for begin, end in occupied:
            if begin - at >= array.size:
                break
            at = max(at, end)
        place[array.number] = at
        total = max(total, at + array.size)
    return place, total


def _lives(lines: Sequence[str]) -> _Lives:
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
        for result in _MARK.finditer(line):
            number = int(result.group(1))
            first, _ = lives.get(number, (i, i))
            lives[number] = (first, i)
    for begin, end in loops:  # inner ones come before those around them
        for number, (first, last) in lives.items():
            inside = first <= end and last >= begin
            if inside and not (first > begin and last < end):
                lives[number] = (min(first, begin), max(last, end))
    return lives
