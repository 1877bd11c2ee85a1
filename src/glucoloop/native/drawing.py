"""Computations that depend only on random keys, which are postponed, to be drawn before the loop."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import jax

from glucoloop.native import primitives


class Drawn:
    """An array that depends only on random keys, so that it can be computed before the loop: its shape and type."""

    def __init__(self, aval: Any) -> None:
        self.aval = aval


@dataclass(frozen=True, eq=False)
class Drawing:
    """Computations from random keys before the loop, equation by equation."""

    keys: Sequence[Drawn]
    equations: Sequence[tuple[Any, Sequence[Any], Sequence[Drawn]]]
    """Equation, its inputs (`Drawn` or numbers), and its outputs."""
    wanted: Sequence[Drawn]
    """Arrays that the loop needs."""

    def __call__(self, *keys: Any) -> list[jax.Array]:
        """The wanted arrays, of one person at one sample; JAX can trace it."""
        output: dict[int, Any] = {id(variable): key for variable, key in zip(self.keys, keys, strict=True)}

        def read(given: Any) -> Any:
            return output[id(given)] if isinstance(given, Drawn) else given

        for equation, inputs, outputs in self.equations:
            results = primitives.bind(equation, [read(given) for given in inputs])
            output.update((id(variable), result) for variable, result in zip(outputs, results, strict=True))
        return [output[id(variable)] for variable in self.wanted]
