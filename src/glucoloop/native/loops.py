"""Rounds of a loop in a scalar program, from a function that computes one round: what is carried is found out."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence

import numpy as np
import numpy.typing as npt

from glucoloop.native.program import SAMPLE, Home, LoopForm, Program, Value

Values = npt.NDArray[np.int64]
"""An array whose elements are places in the program."""


class LoopMaker:
    """Writes loops into a program, one inside another."""

    def __init__(self, program: Program) -> None:
        self._program = program
        self._home: Home = ()
        self._numbers = itertools.count()

    def __call__(
        self,
        round_: Callable[[list[Values], list[Values]], tuple[list[Values], list[Values]]],
        start: Sequence[Values],
        rows: Sequence[Values],
        length: int | None,
    ) -> tuple[list[Values], list[Values]]:
        """Values that the last round of a loop carries on, and the results of all rounds.

        What no round changes, and what is always equal to another part of what is carried, is not carried. That is
        supposed of all at first, for as long as a round does not contradict it.
        """
        p, outside = self._program, self._home
        self._home = home = (*outside, next(self._numbers))
        first = _joined(start)
        each = np.array([_joined([array[k] for array in rows]) for k in range(length or 0)], np.int64).T
        row_inputs = {
            i: p.input(("row", home, i), SAMPLE, p.types[numbers[0]], home)
            for i, numbers in enumerate(each.tolist())
            if len(set(numbers)) > 1
        }
        row = np.array([row_inputs.get(i, int(of_row[0])) for i, of_row in enumerate(each)], np.int64)
        number: list[int | None] = [None] * first.size
        """Number of the carried value that each is; None of what does not change."""
        if length is None:  # the truth that ends the loop stands for itself
            number[-1] = first.size - 1
        while True:
            carry = {n: p.input(("carried", home, n), SAMPLE, p.types[first[n]], home) for n in number if n is not None}
            inputs = [int(x) if n is None else carry[n] for x, n in zip(first, number, strict=True)]
            following, outputs = round_(_apart(np.array(inputs, np.int64), start), _apart(row, [r[0] for r in rows]))
            after, before = _joined(following).tolist(), number
            states = list(zip(before, first.tolist(), after, strict=True))
            number = [None if n is None and x == then else states.index((n, x, then)) for n, x, then in states]
            if number == before:
                break
        self._home = outside
        results = _joined(outputs)
        changing = dict.fromkeys(int(v) for v in results if p.homes[v] == home)
        over = (len(carry) - 1, False) if length is None else None
        if not changing:
            over = over or self._settling(list(carry.values()), [after[n] for n in carry])
        loop = LoopForm(home, length, over, tuple(carry.values()), tuple(row_inputs.values()))
        arguments = [
            *(int(first[n]) for n in carry),
            *(after[n] for n in carry),
            *(int(x) for k in range(length or 0) for x in each[list(row_inputs), k]),
            *changing,
        ]
        value = p.loop(loop, arguments)
        part = {n: p.part(value, i) for i, n in enumerate(carry)}
        ends = [int(x) if n is None else part[n] for x, n in zip(first, number, strict=True)]
        place = {v: i for i, v in enumerate(changing)}

        def at(k: int) -> Values:
            begin = len(carry) + k * len(changing)
            return np.array([p.part(value, begin + place[v]) if v in place else v for v in results.tolist()], np.int64)

        of_rounds = [_apart(at(k), outputs) for k in range(length or 0)]
        stacked = [np.stack(parts) for parts in zip(*of_rounds, strict=True)]
        return _apart(np.array(ends, np.int64), start), stacked

    def _settling(self, carry: Sequence[Value], following: Sequence[Value]) -> tuple[int, bool] | None:
        """Place of a truth, and that it holds, with which a round leaves all that is carried as it is."""
        formed = [self._program.operations[v] for v in following]
        for place, truth in enumerate(carry):
            if all(form[0] == "select" and form[1][:2] == (truth, v) for form, v in zip(formed, carry, strict=True)):
                return place, True
        return None


def _joined(arrays: Sequence[Values]) -> Values:
    """The elements of arrays, one array after the other."""
    return np.concatenate([np.zeros(0, np.int64), *(array.ravel() for array in arrays)])


def _apart(flat: Values, like: Sequence[Values]) -> list[Values]:
    """Elements as arrays of the shapes of others."""
    ends = np.cumsum([array.size for array in like])
    return [flat[end - array.size : end].reshape(array.shape) for array, end in zip(like, ends, strict=True)]
