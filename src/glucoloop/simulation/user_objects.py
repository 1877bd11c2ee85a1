"""Parts that users bring to a loop: prepared for JAX, or refused with a sentence.

A semilinear patient has two forms: `derivative`, and the parts that the fast integrator takes. Only `derivative` is
told the time. A patient whose constants follow the clock would lose that without a word in the fast integrator and in
native code, and so would one of whose forms is wrong: the two are compared.
"""

from __future__ import annotations

import dataclasses
import functools
import inspect
import traceback
from collections.abc import Callable, Hashable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, cast

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from glucoloop._disk_cache import kept_result
from glucoloop._kept_programs import kept_jit
from glucoloop.arguments import ArgumentTypeError, at_once, is_traced
from glucoloop.component.pytree_component import PytreeComponent
from glucoloop.control.design_case import check_sample_time
from glucoloop.control.protocol import Controller, Decision, Observation
from glucoloop.patients.capabilities import takes_exercise
from glucoloop.patients.protocol import Patient, SemilinearPatient, inputs_of
from glucoloop.pumps.protocol import Delivery, Pump
from glucoloop.refusal import Refusal
from glucoloop.sensors.protocol import Reading, Sensor
from glucoloop.units import MIN_PER_DAY

NEED_VALUES = (jax.errors.ConcretizationTypeError, jax.errors.TracerArrayConversionError)
_NUMBERS = (jax.Array, np.ndarray, np.generic, float, complex, int)
_STATES: Final = 16
_ROUNDING: Final = 1e-6
"""Largest difference of two rates, as a share of the sizes of what they are made of."""


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


class Content:
    """A tree as the key of a cache, compared by its numbers."""

    def __init__(self, tree: Any) -> None:
        numbers, fixed = apart(tree)
        self.tree = tree
        self._key = (fixed, *((np.shape(number), np.asarray(number).tobytes()) for number in numbers))

    def __hash__(self) -> int:
        return hash(self._key[1:])

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Content) and self._key == other._key


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
    if isinstance(controller, PytreeComponent) and not controller.is_designed():
        return f"{name} has settings and no design; make it with its method designed, or a function like gl.design_pid"
    wrong = _uncallable(controller, {"init": ("observation",), "step": ("state", "observation")})
    if wrong is not None:
        return wrong
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
    return _changed_state(name, "step", state, after)


def wrong_with_sensor(sensor: Sensor, glucose_mg_dl: jax.Array) -> str | None:
    """Reason why a user's sensor, or one inside of it, cannot be read in a loop, or None."""
    names = {"init": ("glucose_mg_dl", "key"), "read": ("state", "glucose_mg_dl", "key")}
    return _wrong_with_device(sensor, names, glucose_mg_dl, Reading)


def wrong_with_pump(pump: Pump, insulin_mU_min: jax.Array) -> str | None:
    """Reason why a user's pump, or one inside of it, cannot deliver in a loop, or None."""
    names = {"init": ("insulin_mU_min", "key"), "deliver": ("state", "command_mU_min", "key")}
    return _wrong_with_device(pump, names, insulin_mU_min, Delivery)


def _wrong_with_device(
    device: Any, names: Mapping[str, tuple[str, ...]], value: jax.Array, kind: type[Any]
) -> str | None:
    """Reason why a sensor or a pump cannot be used; `names` are the arguments of `init` and of its other method."""
    inner = getattr(device, "inner", None)
    wrong = None if inner is None else _wrong_with_device(inner, names, value, kind)
    wrong = wrong or _uncallable(device, names)
    if wrong is not None:
        return wrong
    name, method = type(device).__name__, list(names)[-1]

    def used(value: jax.Array, key: jax.Array) -> tuple[Any, Any]:
        state = device.init(value, key)
        return state, getattr(device, method)(state, value, key)

    try:
        state, answer = jax.eval_shape(used, value, jax.random.key(0))
    except NEED_VALUES as error:
        return needs_values(name, error)
    if not isinstance(answer, tuple) or len(answer) != 2 or not isinstance(answer[1], kind):
        return (
            f"{name}.{method} has to return its new state and a {kind.__name__}, "
            f"(state, {kind.__name__.lower()}), and nothing else"
        )
    after, result = answer
    for field in dataclasses.fields(kind):
        part = getattr(result, field.name)
        if part is not None and np.shape(part) not in ((), value.shape):
            return (
                f"{field.name} of the {kind.__name__} of {name} has shape {np.shape(part)} for one person; "
                "it has to be of shape ()"
            )
    valid = getattr(result, "valid", None)
    if valid is not None and np.dtype(getattr(valid, "dtype", type(valid))).kind == "f":
        return f"valid of the Reading of {name} is a {valid.dtype}; give a truth, as jnp.isfinite returns"
    return _changed_state(name, method, state, after)


def _uncallable(part: Any, names: Mapping[str, tuple[str, ...]]) -> str | None:
    """Reason why methods cannot be called with arguments of these names in their places, or None."""
    name = type(part).__name__
    for method, arguments in names.items():
        function = getattr(part, method, None)
        call = f"{method}({', '.join(arguments)})"
        if not callable(function):
            return f"{name} has no method {method}; write {call}"
        try:
            inspect.signature(function).bind(*arguments)
        except TypeError as error:
            return f"{name}.{method} is called as {call}, and does not take that: {error}"
        except ValueError:  # a signature that cannot be known
            continue
    return None


def _changed_state(name: str, method: str, state: Any, after: Any) -> str | None:
    """Reason why a state cannot follow another one in a loop, or None."""
    before, then = jax.tree.structure(state), jax.tree.structure(after)
    if hash(before) != hash(then):
        return f"the state of {name} changes its structure: init makes {before}, {method} makes {then}"
    for (path, old), new in zip(jax.tree_util.tree_leaves_with_path(state), jax.tree.leaves(after), strict=True):
        if (old.shape, old.dtype) != (new.shape, new.dtype):
            return (
                f"the state of {name} changes its type{f' at {_place(path)}' if path else ''}: init makes {old.dtype} "
                f"of shape {old.shape}, {method} makes {new.dtype} of shape {new.shape}; make them the same in init"
            )
    return None


def _place(path: tuple[Any, ...]) -> str:
    place: str = jax.tree_util.keystr(path)
    return place.removeprefix(".")


def compiled_by_class(function: Callable[..., Any], static: tuple[int, ...] = ()) -> Callable[..., Any]:
    """`jax.jit` of a function of a patient, which also keeps apart classes that have the same fields (see `Fixed`).

    `static` are the places of the arguments after the patient, from 0 on, that are part of the program.
    """

    @kept_jit(static_argnums=(0, *(place + 2 for place in static)), science=function)
    def run(fixed: Fixed, numbers: list[Any], *others: Any) -> Any:
        return function(fixed.joined(numbers), *others)

    @functools.wraps(function)
    def call(patient: Any, *others: Any) -> Any:
        numbers, fixed = apart(patient)
        return run(fixed, numbers, *others)

    return call


def refuse_two_patients(patient: SemilinearPatient) -> None:
    """Refuse a patient whose two forms differ at random states and times of a day."""
    result = _compared(patient)
    if result is None or not result[0]:
        return
    _, clock, message = result
    mend = "Leave the integrator out, or take Explicit() or Adaptive()" if clock else "Make both forms the same"
    because = (
        "its derivative follows the time, of which transport, kinetics and driven_derivative are not told"
        if clock
        else "its derivative is not what transport, kinetics, effects and driven_derivative make"
    )
    raise Refusal(
        f"{type(patient).__name__} is another patient for the fast integrator and for native code than for the "
        f"adaptive one: {because}. {message}. {mend}"
    )


def goes_fast(patient: Patient) -> bool:
    """Whether a patient has the parts of the exponential integrator, and no others.

    Those parts are told neither the time nor exercise.
    """
    if not isinstance(patient, SemilinearPatient) or takes_exercise(patient):
        return False
    result = _compared(patient)
    return result is None or not (result[0] and result[1])


def _compared(patient: SemilinearPatient) -> tuple[bool, bool, str] | None:
    """Whether the forms differ, whether the derivative follows the time, and an example; None of a traced patient."""
    if is_traced(patient):
        return None
    return _comparison(Content(patient))


@functools.lru_cache(maxsize=64)
def _comparison(content: Content) -> tuple[bool, bool, str]:
    return kept_result(_forms_compared, content.tree)


def _forms_compared(patient: SemilinearPatient) -> tuple[bool, bool, str]:
    rng = np.random.default_rng(0)
    with at_once():
        work, basal = np.asarray(patient.working_state()), float(np.max(patient.basal_insulin_mU_min))
        x = work[None] * rng.uniform(0.7, 1.3, (_STATES, *work.shape))
        t_min = np.linspace(0.0, MIN_PER_DAY, _STATES, endpoint=False)
        insulin, meal = basal * rng.uniform(0.0, 3.0, _STATES), rng.uniform(0.0, 300.0, _STATES)
        by_derivative, split, size = (np.asarray(part) for part in _rates(patient, t_min, x, insulin, meal))
        at_midnight = np.asarray(_rates(patient, 0.0 * t_min, x, insulin, meal)[0])
    clock = bool(_differ(by_derivative, at_midnight, size).any())
    differ = _differ(by_derivative, split, size)
    if not differ.any():
        return False, clock, ""
    where, state = np.argwhere(differ)[0]
    return (
        True,
        clock,
        (
            f"At {t_min[where]:g} min after the start, the rate of state {state} of (slow, driven) is "
            f"{by_derivative[where, state]:.6g} per minute by the derivative and {split[where, state]:.6g} by the "
            "others"
        ),
    )


def _differ(a: npt.NDArray[Any], b: npt.NDArray[Any], size: npt.NDArray[Any]) -> npt.NDArray[np.bool_]:
    result: npt.NDArray[np.bool_] = np.abs(a - b) > _ROUNDING * size
    return result


@compiled_by_class
@functools.partial(jax.vmap, in_axes=(None, 0, 0, 0, 0))
def _rates(
    patient: SemilinearPatient, t_min: jax.Array, x: jax.Array, insulin: jax.Array, meal: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Rates of slow and driven block by the derivative and by the parts, and the sizes of what they are made of."""
    derivative = patient.derivative(t_min, x, inputs_of(insulin, meal))
    _, by_derivative = jax.jvp(patient.split, (x,), (derivative,))
    y, z = patient.split(x)
    parts = patient.transport(y), patient.kinetics(y, patient.effects(z), meal)
    driven = patient.driven_derivative(z, insulin)
    size = jnp.concatenate([sum(map(jnp.abs, parts), start=jnp.abs(y) * 1e-3), jnp.abs(driven) + jnp.abs(z) * 1e-3])
    return jnp.concatenate(by_derivative), jnp.concatenate([parts[0] + parts[1], driven]), size
