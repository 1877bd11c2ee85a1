"""Records: frozen dataclasses that JAX can trace, and their leaves that differ between people.

Declaring one does not import JAX.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Sequence
from typing import Any, TypeVar, dataclass_transform

from glucoloop._lazy_jax import jax, jnp, once_imported

T = TypeVar("T")


def static(**kwargs: Any) -> Any:
    """A field that is part of the program, not of the data: it is hashed, never traced."""
    return dataclasses.field(metadata={"static": True}, **kwargs)


@dataclass_transform(frozen_default=True, kw_only_default=True, field_specifiers=(static, dataclasses.field))
def pytree(cls: type[T]) -> type[T]:
    """Make a class a frozen, keyword-only dataclass and register it as a JAX pytree.

    Fields declared with `static` become metadata: changing one recompiles what uses the record.
    """
    cls = dataclasses.dataclass(frozen=True, kw_only=True)(cls)
    fields = dataclasses.fields(cls)  # type: ignore[arg-type]
    meta = tuple(f.name for f in fields if f.metadata.get("static", False))
    data = tuple(f.name for f in fields if f.name not in meta)
    register(cls, lambda: (data, meta), lambda values: cls(**values))
    return cls


def register(
    cls: type[T], names: Callable[[], tuple[Iterable[str], Iterable[str]]], made_of: Callable[[dict[str, Any]], T]
) -> None:
    """Register a class as a pytree, as soon as JAX is imported.

    Parameters
    ----------
    names : callable
        Function that gives the names of the attributes that are data, and of those that are part of the program.
    made_of : callable
        Function that makes an object of the class of the values of these attributes, whatever they are.
    """

    def flatten(record: T) -> tuple[tuple[Any, ...], tuple[Any, ...]]:
        data, meta = names()
        return tuple(getattr(record, name) for name in data), tuple(getattr(record, name) for name in meta)

    def flatten_with_keys(record: T) -> tuple[tuple[tuple[Any, Any], ...], tuple[Any, ...]]:
        children, aux = flatten(record)
        return tuple(zip(map(jax.tree_util.GetAttrKey, names()[0]), children, strict=True)), aux

    def unflatten(aux: tuple[Any, ...], children: Iterable[Any]) -> T:
        data, meta = names()
        return made_of({**dict(zip(meta, aux, strict=True)), **dict(zip(data, children, strict=True))})

    # Not register_dataclass: jaxlib (0.10) takes the structures of two such classes for equal whatever the classes,
    # so that, where hashes collide, a function compiled for one runs for the other.
    once_imported(lambda: jax.tree_util.register_pytree_with_keys(cls, flatten_with_keys, unflatten, flatten))


def varying(many: Any, one: Any) -> list[bool]:
    """Whether each leaf has one number per person."""
    leaves = zip(jax.tree.leaves(many), jax.tree.leaves(one), strict=True)
    return [jnp.ndim(a) > jnp.ndim(b) for a, b in leaves]


def chosen(tree: Any, varies: Sequence[bool]) -> list[jax.Array]:
    """Leaves that vary between people."""
    return [jnp.asarray(leaf) for leaf, differs in zip(jax.tree.leaves(tree), varies, strict=True) if differs]


def replaced(tree: Any, varies: Sequence[bool], values: Sequence[Any]) -> Any:
    """A tree with other leaves where they vary."""
    leaves, structure = jax.tree.flatten(tree)
    new = iter(values)
    return jax.tree.unflatten(structure, [next(new) if v else leaf for leaf, v in zip(leaves, varies, strict=True)])
