"""Checks of the arguments of public functions, derived from the annotations of their parameters.

`checked` refuses an argument of the wrong type with a sentence, and accepts numbers of NumPy and JAX where those of
Python are expected. Bounds are checked by the functions themselves; they skip values for which `is_traced` is true,
since inside ``jax.jit``, ``jax.grad`` and ``jax.vmap`` a number has no value yet.
"""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import inspect
import numbers
import re
import reprlib
import sys
import types
import typing
from collections.abc import Callable, Iterator, Mapping
from typing import Any, Final, TypeVar, cast

from glucoloop._lazy_jax import jax, jnp, np
from glucoloop.refusal import Refusal
from glucoloop.units import UNIT_BY_ENDING, ending_of

T = TypeVar("T", bound=Callable[..., Any])

_KEY_BOUNDS: Final = (-(2**63), 2**63 - 1)


class ArgumentTypeError(TypeError, Refusal):
    """An argument of the wrong type; a ValueError too, for whoever guards against arguments that are not possible."""


def is_traced(*values: object) -> bool:
    """Whether JAX is tracing any number of these values, so that it is not known yet."""
    return "jax" in sys.modules and any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(values))


@contextlib.contextmanager
def at_once(*given: object) -> Iterator[None]:
    """Compute immediately, also inside ``jax.jit``, unless one of the given values is traced."""
    if not is_traced(given) and is_traced(jnp.zeros(())):
        with jax.ensure_compile_time_eval():
            yield
    else:
        yield


def checked(target: T) -> T:
    """Check the arguments of a function, or of a class when it is made, against the annotations.

    ============================  ===================================================================
    annotation                    what is taken
    ============================  ===================================================================
    ``float``                     a number of Python, NumPy or JAX, handed on as a float; traced as is
    ``jax.Array | float``         such a number, or an array as it is
    ``int``                       a whole number of them, handed on as an int; never traced
    ``bool``, ``str``             Python's or NumPy's
    a protocol                    an object that has the protocol's members
    a class of glucoloop          an instance
    any of these or ``None``      that, or None
    anything else                 anything
    ============================  ===================================================================

    Raises
    ------
    ArgumentTypeError
        In a sentence that names the argument, what it is, and what to give instead.
    """
    if isinstance(target, type):
        made: Any = target
        made.__init__ = _checked(made.__init__, made.__name__)
        return target
    return cast(T, _checked(target, target.__name__))


def on_host(reason: str) -> Callable[[T], T]:
    """Keep a function that needs the values of its arguments out of JAX's transformations.

    Inside ``jax.jit`` it is computed at once if its arguments are known there, and else refused, with the reason why it
    cannot be traced: ``"it solves a Riccati equation with SciPy"``.
    """

    def decorate(function: T) -> T:
        @functools.wraps(function)
        def concrete(*args: Any, **kwargs: Any) -> Any:
            if is_traced(args, kwargs):
                given = inspect.signature(function).bind(*args, **kwargs).arguments
                traced = " and ".join(name for name, value in given.items() if is_traced(value))
                raise ArgumentTypeError(
                    f"{function.__name__} cannot be differentiated, mapped or compiled by JAX: {reason}; "
                    f"{traced} is traced. Call it outside of the transformation"
                )
            with at_once():
                return function(*args, **kwargs)

        return cast(T, concrete)

    return decorate


def random_key(key: object) -> jax.Array:
    """A key of JAX from a key or a whole number that fits into 64 bits."""
    if isinstance(key, jax.Array | np.ndarray):
        is_key = jnp.issubdtype(key.dtype, jax.dtypes.prng_key) and key.shape == ()
        if is_key or (key.dtype == np.uint32 and key.shape == (2,)):
            return cast(jax.Array, key)
        if is_traced(key) and key.shape == () and jnp.issubdtype(key.dtype, jnp.integer):
            return jax.random.key(key)
    if not _is_whole(key):
        raise ArgumentTypeError(f"key is {_described(key)}; give a whole number, or a key of jax.random.key")
    number = int(cast(Any, key))
    if not _KEY_BOUNDS[0] <= number <= _KEY_BOUNDS[1]:
        raise Refusal(f"a key of {number} is too large; give a whole number of at most 63 bits")
    return jax.random.key(number)


def converted(name: str, value: object, annotation: Any, function: str) -> Any:
    """An argument as `checked` hands it on; ArgumentTypeError for one of the wrong type."""
    return _Argument(name, value, function).taken(annotation)


def _checked(function: Callable[..., Any], name: str) -> Callable[..., Any]:
    signature = inspect.signature(function)
    parameters = tuple(signature.parameters)

    @functools.cache
    def annotations() -> Mapping[str, Any]:
        # At the first call, since modules are not complete when they are imported.
        return typing.get_type_hints(function)

    @functools.wraps(function)
    def check(*args: Any, **kwargs: Any) -> Any:
        try:
            given = signature.bind(*args, **kwargs)
        except TypeError:
            return function(*args, **kwargs)  # Python says itself what is missing or too much
        hints = annotations()
        for parameter, value in given.arguments.items():
            if parameter in hints and parameter != "return":
                argument = _Argument(parameter, value, name, parameters, hints)
                given.arguments[parameter] = argument.taken(hints[parameter])
        return function(*given.args, **given.kwargs)

    return check


@dataclasses.dataclass(slots=True)
class _Argument:
    """One argument of one call."""

    name: str
    value: Any
    function: str
    parameters: tuple[str, ...] = ()
    """Names of all parameters of the function."""
    hints: Mapping[str, Any] = dataclasses.field(default_factory=dict)

    def taken(self, annotation: Any) -> Any:
        """The value as its function wants it."""
        if typing.get_origin(annotation) in (types.UnionType, typing.Union):
            kinds = [kind for kind in typing.get_args(annotation) if kind is not type(None)]
            if (self.value is None and len(kinds) < len(typing.get_args(annotation))) or len(kinds) > 1:
                if self.value is not None and all(map(_is_ours, kinds)):
                    for kind in () if any(_is_a(self.value, kind) for kind in kinds) else kinds:
                        self._refuse_other(kind)
                as_it_is = set(kinds) != {float, jax.Array} or isinstance(self.value, jax.Array | np.ndarray)
                if not any(map(_is_ours, kinds)):
                    self._refuse_swapped()
                return self.value if as_it_is else self._number()
            annotation = kinds[0]
        if annotation is float:
            return self._number()
        if annotation is int:
            return self._whole_number()
        if annotation is bool and not isinstance(self.value, bool | np.bool_):
            raise self._refusal("; give True or False")
        if annotation is bool:
            return bool(self.value)
        if annotation is str or _is_ours(annotation):
            self._refuse_other(annotation)
        return self.value

    def _number(self) -> Any:
        value = self.value
        if isinstance(value, jax.Array | np.ndarray):
            real = jnp.issubdtype(value.dtype, jnp.floating) or jnp.issubdtype(value.dtype, jnp.integer)
            if real and value.shape == ():
                return value if is_traced(value) else float(value)
            if real:
                raise ArgumentTypeError(
                    f"{self.name} is an array of shape {value.shape}; give one number{self._unit()}, "
                    "and use jax.vmap for many"
                )
        elif isinstance(value, numbers.Real) and not isinstance(value, bool | np.bool_):
            try:
                return float(value)
            except OverflowError:
                raise Refusal(f"{self.name} of {reprlib.repr(value)} is too large for a float") from None
        begins = re.match(r"\s*[-+]?\d+(\.\d+)?", value) if isinstance(value, str) else None
        example = "" if begins is None else f", such as {float(begins[0]):g}"
        raise self._refusal(f"; give a number{self._unit()}{example}")

    def _whole_number(self) -> int:
        if is_traced(self.value):
            raise ArgumentTypeError(
                f"{self.name} is traced by JAX, but it decides what is computed; "
                "give a plain int, outside of the transformation or by static_argnames"
            )
        if not _is_whole(self.value):
            raise self._refusal(f"; give a whole number{self._unit()}")
        return int(self.value)

    def _refuse_other(self, kind: type) -> None:
        """Refuse what is no instance of a class or lacks members of a protocol, and say what would do."""
        if _is_a(self.value, kind):
            return
        without = ""
        wanted = "a text" if kind is str else f"an instance of {kind.__name__}"
        if _is_protocol(kind):
            lacking, members = _lacking(self.value, kind), _members(kind)
            without = f" without {_names_text(lacking)}" if len(lacking) < len(members) else ""
            name = re.sub(r"(?<!^)(?=[A-Z])", " ", kind.__name__).lower()
            wanted = f"{'an' if name[0] in 'aeiou' else 'a'} {name}, an object with {_names_text(members)}"
        self._refuse_swapped()
        record = dataclasses.is_dataclass(self.value) and not isinstance(self.value, type)
        fields = dataclasses.fields(self.value) if record else ()
        part = next((field.name for field in fields if _is_a(getattr(self.value, field.name), kind)), None)
        raise self._refusal(f"{without}; give {wanted if part is None else f'its part .{part}'}")

    def _refuse_swapped(self) -> None:
        """Refuse an object of a class that another argument wants."""
        for other, annotation in self.hints.items():
            kinds = (annotation, *typing.get_args(annotation))
            if other not in (self.name, "return") and any(_is_ours(kind) and _is_a(self.value, kind) for kind in kinds):
                order = ", ".join(self.parameters)
                raise self._refusal(f", which would do as {other}; the arguments are {self.function}({order})")

    def _refusal(self, rest: str) -> ArgumentTypeError:
        return ArgumentTypeError(f"{self.name} is {_described(self.value)}{rest}")

    def _unit(self) -> str:
        unit = UNIT_BY_ENDING.get(ending_of(self.name), "")
        return f" in {unit}" if unit else ""


def _is_ours(annotation: Any) -> bool:
    return isinstance(annotation, type) and annotation.__module__.startswith("glucoloop")


def _is_a(value: object, kind: type) -> bool:
    return not _lacking(value, kind) if _is_protocol(kind) else isinstance(value, kind)


def _is_protocol(kind: type) -> bool:
    return bool(getattr(kind, "_is_protocol", False))


def _members(protocol: type) -> list[str]:
    return [name for name in dir(protocol) if not name.startswith("_")]


def _lacking(value: object, protocol: type) -> list[str]:
    """Members of a protocol that an object lacks; a class lacks the members of its instances."""
    return [name for name in _members(protocol) if isinstance(value, type) or not _has(value, name, protocol)]


def _has(value: object, name: str, protocol: type) -> bool:
    try:
        # a component that nobody has made yet has None there
        return getattr(value, name) is not None or _may_be_none(protocol, name)
    except AttributeError:
        return False
    except Exception:
        return True  # somebody else's property that fails is there


def _may_be_none(protocol: type, name: str) -> bool:
    getter = getattr(inspect.getattr_static(protocol, name, None), "fget", None)
    annotation = getter.__annotations__.get("return", "") if getter else protocol.__annotations__.get(name, "")
    return "None" in str(annotation)


def _is_whole(value: object) -> bool:
    if isinstance(value, jax.Array | np.ndarray):
        return value.shape == () and bool(jnp.issubdtype(value.dtype, jnp.integer))
    return isinstance(value, numbers.Integral) and not isinstance(value, bool)


def _described(value: object) -> str:
    """A value and its type, in words."""
    if value is None:
        return "None"
    if isinstance(value, type):
        return f"the class {value.__name__}, not an instance of it"
    if is_traced(value):
        return "a number that JAX traces"
    kind = type(value).__name__
    kind = f"{'an' if kind[0] in 'aeiouAEIO' else 'a'} {kind}"
    shown = isinstance(value, str | numbers.Number | np.generic | list | tuple | dict)
    return f"{_SHORT.repr(value)}, {kind}" if shown else kind


_SHORT: Final = reprlib.Repr()
_SHORT.maxstring = _SHORT.maxother = 60


def _names_text(names: list[str]) -> str:
    return " and ".join(filter(None, [", ".join(names[:-1]), names[-1]]))
