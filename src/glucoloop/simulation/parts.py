"""Parts that users bring to a loop: prepared for JAX, or refused with a sentence."""

from __future__ import annotations

import functools
import traceback
from collections.abc import Callable, Hashable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import jax
import numpy as np

from glucoloop.arguments import ArgumentTypeError
from glucoloop.control.protocol import Controller, Decision, Observation
from glucoloop.control.tuning import check_sample_time

NEED_VALUES = (jax.errors.ConcretizationTypeError, jax.errors.TracerArrayConversionError)
_NUMBERS = (jax.Array, np.ndarray, np.generic, float, complex, int)


def sample_time_of(controller: Controller) -> float:
    """Sample time of a controller [min], which has to be a number above 0 before anything is computed."""
    sample_time: Any = controller.sample_time_min
    if not isinstance(sample_time, _NUMBERS):
        raise ArgumentTypeError(f"the controller's sample_time_min is {sample_time!r}; give a number in min, such as 5")
    check_sample_time(cast(float, sample_time))
    return float(cast(float, sample_time))


@dataclass(frozen=True)
class Fixed:
    """Part of a tree that belongs to the program and not to the numbers: its structure, and functions in it."""

    structure: Any
    places: tuple[int, ...]
    functions: tuple[Hashable, ...]
    kinds: tuple[Any, ...]
    """Classes of the nodes. JAX takes the structures of two classes with the same fields for equal, and would run one
    controller with the program of another.
    """

    def joined(self, numbers: list[Any]) -> Any:
        """The tree with the given numbers."""
        leaves = list(numbers)
        for place, function in zip(self.places, self.functions, strict=True):
            leaves.insert(place, function)
        return jax.tree.unflatten(self.structure, leaves)


def apart(tree: Any) -> tuple[list[Any], Fixed]:
    """Split a tree into its numbers and its fixed part; an object that JAX does not know is refused."""
    numbers, places, functions = [], [], []
    leaves, structure = jax.tree_util.tree_flatten_with_path(tree)
    for place, (path, leaf) in enumerate(leaves):
        if isinstance(leaf, _NUMBERS):
            numbers.append(leaf)
        elif isinstance(leaf, str) or (callable(leaf) and len(path) > 1):
            places.append(place)
            functions.append(leaf)
        else:
            raise ArgumentTypeError(
                f"{_place(path)} is an instance of {type(leaf).__name__}, which JAX cannot carry through a loop; write "
                "@jax.tree_util.register_static above its class, a frozen dataclass, or derive it from equinox.Module"
            )
    kinds = tuple(_kinds(structure))
    return numbers, Fixed(structure=structure, places=tuple(places), functions=tuple(functions), kinds=kinds)


def _kinds(structure: Any) -> Iterator[Any]:
    """Classes of the nodes of a tree, each before those inside it."""
    node = structure.node_data()
    yield None if node is None else node[0]
    for inside in structure.children():
        yield from _kinds(inside)


def needs_values(name: str, error: BaseException) -> str:
    """Sentence for code of a user that asks for the value of a number that is traced, with the place in the code."""
    package = str(Path(__file__).resolve().parents[1])
    others = [
        frame
        for frame in traceback.extract_tb(error.__traceback__)
        if "jax" not in Path(frame.filename).parts and not str(Path(frame.filename).resolve()).startswith(package)
    ]
    place = f" (line {others[-1].lineno} of {Path(others[-1].filename).name})" if others else ""
    return (
        f"{name} asks for the value of a number{place}, as `if`, `and`, `float` or NumPy do, while the loop is "
        "compiled and no number has a value; write jnp.where(condition, a, b) or jax.lax.cond in place of an `if`, `&` "
        "and `|` in place of `and` and `or`, and jax.numpy in place of numpy and math"
    )


def wrong_with(controller: Controller, observation: Observation) -> str | None:
    """Reason why a user's controller cannot be stepped in a loop, or None."""
    name = type(controller).__name__
    try:
        state = jax.eval_shape(lambda observation: controller.init(observation), observation)
        answer = jax.eval_shape(lambda state, seen: controller.step(state, seen), state, observation)
    except NEED_VALUES as error:
        return needs_values(name, error)
    if not isinstance(answer, tuple) or len(answer) != 2 or not isinstance(answer[1], Decision):
        return f"{name}.step has to return its new state and a Decision, (state, decision), and nothing else"
    after, decision = answer
    dose = decision.insulin_mU_min
    if dose.shape != observation.glucose_mg_dl.shape:
        return f"{name}.step decides on a dose of shape {dose.shape} for one person; it has to be of shape ()"
    before, then = jax.tree.structure(state), jax.tree.structure(after)
    if hash(before) != hash(then):
        return f"the state of {name} changes its structure: init makes {before}, step makes {then}"
    for (path, old), new in zip(jax.tree_util.tree_leaves_with_path(state), jax.tree.leaves(after), strict=True):
        if (old.shape, old.dtype) != (new.shape, new.dtype):
            return (
                f"the state of {name} changes its type{f' at {_place(path)}' if path else ''}: init makes {old.dtype} "
                f"of shape {old.shape}, step makes {new.dtype} of shape {new.shape}; make them the same in init"
            )
    return None


def _place(path: tuple[Any, ...]) -> str:
    place: str = jax.tree_util.keystr(path)
    return place.removeprefix(".")


def compiled_by_class(function: Callable[..., Any], static: tuple[int, ...] = ()) -> Callable[..., Any]:
    """`jax.jit` of a function of a patient, which also keeps apart classes that have the same fields (see `Fixed`).

    `static` are the places of the arguments after the patient, from 0 on, that are part of the program.
    """

    @functools.partial(jax.jit, static_argnums=(0, *(place + 2 for place in static)))
    def run(fixed: Fixed, numbers: list[Any], *others: Any) -> Any:
        return function(fixed.joined(numbers), *others)

    @functools.wraps(function)
    def call(patient: Any, *others: Any) -> Any:
        numbers, fixed = apart(patient)
        return run(fixed, numbers, *others)

    return call
