"""Products of a matrix and a vector in a scalar program, so that the code of one row can serve them all.

A program has every product and sum of its own. Written out one after the other, the rows of a patient's matrices are
tens of kilobytes of code, which a processor cannot fetch as quickly as it multiplies. Rows whose numbers lie alike in
memory, and which are multiplied by the same values, are found again here; a loop over them carries out the same
operations in the same order.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from glucoloop.native.program import Program, Value

_MIN_ROWS: Final = 3
_MIN_COLUMNS: Final = 3


@dataclass(frozen=True)
class MatrixRows:
    """Sums of products, one for each row of a matrix."""

    sums: Sequence[Value]
    """Value of each row."""
    factors: Sequence[Value]
    """Values of the vector."""
    columns: Sequence[int]
    """Place of each number of a row, counted from the row's first."""
    places: Sequence[int]
    """Place in memory of each row's first number."""
    starts: Sequence[int]
    """Place in memory of the number that each sum begins with, empty if the sums begin with their products."""
    inner: frozenset[Value]
    """Products and parts of the sums, which nothing else needs."""


@dataclass(frozen=True)
class _Sum:
    start: int | None
    terms: tuple[tuple[int, Value], ...]
    """Place of a number of the matrix and the value that it is multiplied with, from the first term on."""
    inner: frozenset[Value]


def find_rows(
    program: Program, order: Sequence[Value], results: Sequence[Value], places: Mapping[Value, int]
) -> list[MatrixRows]:
    """Find rows that a loop can carry out, in values of which each comes after its arguments.

    `places` are the places in memory of the values that are stored there, of which a matrix is made.
    """
    uses = Counter(results)
    for value in order:
        uses.update(program.operations[value][1])

    def product(value: Value) -> tuple[int, Value] | None:
        operation, arguments = program.operations[value]
        if operation != "mul" or uses[value] != 1 or sum(a in places for a in arguments) != 1:
            return None
        number, factor = sorted(arguments, key=lambda a: a not in places)
        return places[number], factor

    result: dict[Value, _Sum] = {}
    for value in order:
        operation, arguments = program.operations[value]
        terms = [(a, term) for a in arguments if operation == "add" and (term := product(a)) is not None]
        if len(terms) == 2:
            result[value] = _Sum(None, tuple(sorted(term for _, term in terms)), frozenset(arguments))
        elif len(terms) == 1:
            ((added, term),) = terms
            (before,) = (a for a in arguments if a != added)
            if before in places:
                result[value] = _Sum(places[before], (term,), frozenset([added]))
            elif before in result and uses[before] == 1:
                so_far = result.pop(before)
                result[value] = _Sum(so_far.start, (*so_far.terms, term), so_far.inner | {before, added})

    alike: dict[tuple[object, ...], list[Value]] = {}
    for value, total in result.items():
        first = total.terms[0][0]
        form = tuple((place - first, factor) for place, factor in total.terms)
        alike.setdefault((total.start is None, form), []).append(value)
    rows = []
    for sums in alike.values():
        terms_of_first = result[sums[0]].terms
        if len(sums) < _MIN_ROWS or len(terms_of_first) < _MIN_COLUMNS:
            continue
        rows.append(
            MatrixRows(
                sums=sums,
                factors=[factor for _, factor in terms_of_first],
                columns=[place - terms_of_first[0][0] for place, _ in terms_of_first],
                places=[result[value].terms[0][0] for value in sums],
                starts=[start for value in sums if (start := result[value].start) is not None],
                inner=frozenset[Value]().union(*(result[value].inner for value in sums)),
            )
        )
    return rows
