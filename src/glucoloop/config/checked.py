"""Check of a record of keys: a value of another type or out of its bounds is refused in one sentence."""

from __future__ import annotations

import dataclasses
import functools
import math
import typing
from collections.abc import Mapping
from typing import Annotated, Any, Final, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError, create_model

from glucoloop.config.key import Declared, declared
from glucoloop.config.sentences import one_sentence
from glucoloop.refusal import Refusal

STRICT: Final = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)

Record = TypeVar("Record")


def checked(record: type[Record], keys: Mapping[str, object], names: Mapping[str, str] | None = None) -> Record:
    """Build a record from its keys.

    Parameters
    ----------
    record : type
        Record of keys, see `config.key`.
    keys : mapping
    names : mapping, optional
        Name under which the user gave each key, for messages.

    Raises
    ------
    ValueError
        For a key that the record does not have, a value of another type, or one out of its bounds.
    """
    kind: Any = record
    model = _model(kind)
    try:
        found = model.model_validate({key: tuple(v) if isinstance(v, list) else v for key, v in keys.items()})
    except ValidationError as error:
        raise Refusal(one_sentence(error, model, names)) from None
    return record(**{name: getattr(found, name) for name in declared(kind)})


@functools.cache
def _model(record: type) -> type[BaseModel]:
    """The record as a model of Pydantic, which checks types and bounds."""
    hints = typing.get_type_hints(record)
    fields: dict[str, Any] = {}
    for field in dataclasses.fields(record):
        of = declared(record)[field.name]
        default: Any = ... if field.default is dataclasses.MISSING else field.default
        if field.default_factory is not dataclasses.MISSING:
            default = Field(default_factory=field.default_factory)
        fields[field.name] = (_bounded(of, hints[field.name]), default)
    return typing.cast(type[BaseModel], create_model(record.__name__, __config__=STRICT, **fields))


def _bounded(of: Declared, hint: Any) -> Any:
    if of.key is None:
        return hint
    sides = {"ge": of.key.at_least, "le": of.key.at_most, "gt": of.key.above, "lt": of.key.below}
    finite: dict[str, Any] = {side: bound for side, bound in sides.items() if math.isfinite(bound)}
    bounds: Any = Field(**finite)
    if of.many:
        many: Any = tuple[Annotated[of.kind, bounds], ...]  # type: ignore[name-defined]
        return Annotated[many | None if of.optional else many, of.key]
    return Annotated[hint, bounds, of.key]
