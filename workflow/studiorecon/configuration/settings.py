# SPDX-License-Identifier: Apache-2.0
"""Converts the JSON settings of one step to a frozen dataclass, with errors in sentences."""

from __future__ import annotations

import dataclasses
import sys
import types
import typing
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, TypeVar

from studiorecon.configuration.setting import field_default
from studiorecon.errors import UserError

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

T = TypeVar("T", bound="DataclassInstance")


def load(cls: type[T], values: Mapping[str, Any], where: str, default: T | None = None) -> T:
    """The dataclass ``cls`` filled from ``values``; ``where`` (``"depth.sweep"``) names the place in messages.

    Missing values come from ``default``, else from the fields' own defaults. Keys that ``cls`` does not have are
    ignored: a section may serve several steps. Nested dataclasses are filled from nested mappings. Raises UserError for
    a missing key of a field without a default, or a value of the wrong type.
    """
    hints = typing.get_type_hints(cls)
    filled = {}
    for field in dataclasses.fields(cls):
        if field.name not in values and default is not None:
            filled[field.name] = getattr(default, field.name)
            continue
        if field.name not in values:
            if field_default(field) is not dataclasses.MISSING:
                continue
            raise UserError(
                f"setting {where}.{field.name} is missing; config/config.yaml holds every setting with its default"
            )
        own = getattr(default, field.name) if default is not None else field_default(field)
        filled[field.name] = _convert(values[field.name], hints[field.name], f"{where}.{field.name}", own)
    return cls(**filled)


def _convert(value: Any, kind: Any, where: str, default: Any = None) -> Any:
    origin = typing.get_origin(kind)
    if origin in (typing.Union, types.UnionType):
        options = typing.get_args(kind)
        if value is None and type(None) in options:
            return None
        failures = []
        for option in options:
            if option is type(None):
                continue
            try:
                return _convert(value, option, where)
            except UserError as refusal:
                failures.append(str(refusal))
        raise UserError(failures[0])
    if origin is typing.Literal:
        choices = typing.get_args(kind)
        if value not in choices:
            raise UserError(f"setting {where} is {value!r}; it must be one of {', '.join(map(str, choices))}")
        return value
    if isinstance(kind, type) and dataclasses.is_dataclass(kind):
        if not isinstance(value, Mapping):
            raise UserError(f"setting {where} must be a section with keys, not {value!r}")
        return load(kind, value, where, default if isinstance(default, kind) else None)
    if origin in (tuple, list, Sequence):
        if isinstance(value, str) or not isinstance(value, Sequence):
            raise UserError(f"setting {where} must be a list, not {value!r}")
        inner = [a for a in typing.get_args(kind) if a is not Ellipsis]
        if origin is tuple and Ellipsis not in typing.get_args(kind):
            if len(value) != len(inner):
                raise UserError(f"setting {where} must have {len(inner)} entries, not {len(value)}")
            return tuple(_convert(v, k, where) for v, k in zip(value, inner))
        items = [_convert(v, inner[0] if inner else Any, where) for v in value]
        return items if origin is list else tuple(items)
    if origin in (dict, Mapping) or kind is dict:
        if not isinstance(value, Mapping):
            raise UserError(f"setting {where} must be a section with keys, not {value!r}")
        names = literal_keys(kind)
        return {k: v for k, v in value.items() if not names or k in names}
    if kind is Any:
        return value
    return _scalar(value, kind, where)


def literal_keys(kind: Any) -> tuple[str, ...]:
    """The keys that ``Mapping[Literal["a", "b"], V]`` names, for a step that reads part of a mapping; else none."""
    keys = typing.get_args(kind)[:1]
    return typing.get_args(keys[0]) if keys and typing.get_origin(keys[0]) is typing.Literal else ()


def _scalar(value: Any, kind: type, where: str) -> Any:
    # bool is an int in Python, and YAML reads 1e-4 as a string: both user errors deserve a sentence of their own.
    number = isinstance(value, (int, float)) and not isinstance(value, bool)
    if kind is float and number and abs(value) <= sys.float_info.max:
        return float(value)
    if kind is int and isinstance(value, int) and not isinstance(value, bool):
        return value
    if kind in (bool, str) and isinstance(value, kind):
        return value
    raise UserError(f"setting {where} is {value!r:.60}; it must be {_NAMES.get(kind, str(kind))}")


_NAMES = {float: "a number (write 1.0e-4, not 1e-4)", int: "a whole number", bool: "true or false", str: "text"}
