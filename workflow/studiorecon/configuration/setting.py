# SPDX-License-Identifier: Apache-2.0
"""Declares a setting: a field of a frozen dataclass with its default, meaning, unit, bounds and the paper's value.

A field without ``setting`` is a constant of its code, and not in the configuration. A field whose type is a dataclass
with settings of its own is a section; a dataclass without any is a group of constants.
"""

from __future__ import annotations

import copy
import dataclasses
import inspect
import types
import typing
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Description:
    """The description of a setting, in addition to its type and default.

    Attributes:
        meaning: in words; of a section, its subject.
        unit: of the value, as it is written after a number.
        minimum, maximum: smallest and largest value, or of every entry of a list.
        above, below: the same, exclusive.
        paper: the paper's value with its source, and the reading (U04) of an ambiguous passage.
        paper_value: the value that the paper gives; None = there is none, and ``configuration.paper_settings`` says
            why.
        odd: only odd numbers.
        choices: the possible values of a text, if its type does not name them.
        shape: JSON schema for constraints that the type cannot express.
    """

    meaning: str
    unit: str = ""
    minimum: float | None = None
    above: float | None = None
    maximum: float | None = None
    below: float | None = None
    paper: str = ""
    paper_value: Any = None
    odd: bool = False
    choices: tuple[str, ...] = ()
    shape: Mapping[str, Any] | None = None


@dataclass(frozen=True)
class Setting:
    """One setting or section, independent of the place of its declaration.

    Attributes:
        name: its key.
        kind: its type, as annotated.
        default: its default value; the default dataclass for a section.
        description: its description.
    """

    name: str
    kind: Any
    default: Any
    description: Description

    @property
    def is_section(self) -> bool:
        """Whether it holds settings instead of a value."""
        return dataclasses.is_dataclass(self.default)

    def inner(self) -> list[Setting]:
        """The settings of a section, with the defaults from this one."""
        return list(settings_in(type(self.default), self.default))


def setting(default: Any, meaning: str, **described: Any) -> Any:
    """A dataclass field that is a setting; see ``Description`` for the other arguments."""
    metadata = {"setting": Description(meaning, **described)}
    if isinstance(default, (dict, list)):
        return dataclasses.field(default_factory=lambda: copy.deepcopy(default), metadata=metadata)
    return dataclasses.field(default=default, metadata=metadata)


def is_setting(field: dataclasses.Field[Any]) -> bool:
    """Whether a field of a dataclass is a setting, not a constant."""
    return "setting" in field.metadata


def settings_in(kind: type, values: Any = None, declared: bool = False) -> Iterator[Setting]:
    """The settings of a dataclass in their order; ``values`` replaces its own defaults.

    With ``declared`` only those of its own body, without inherited ones.
    """
    hints = typing.get_type_hints(kind)
    for field in dataclasses.fields(kind):
        if not is_setting(field) or (declared and field.name not in inspect.get_annotations(kind)):
            continue
        default = field_default(field) if values is None else getattr(values, field.name)
        yield Setting(field.name, hints[field.name], default, field.metadata["setting"])


def field_default(field: dataclasses.Field[Any]) -> Any:
    """A field's default, ``dataclasses.MISSING`` where it has none."""
    if field.default_factory is not dataclasses.MISSING:
        return field.default_factory()
    return field.default


def plain_value(value: Any) -> Any:
    """A default in the types of YAML and JSON: sections as mappings of their settings, tuples as lists."""
    if dataclasses.is_dataclass(value):
        return {inner.name: plain_value(inner.default) for inner in settings_in(type(value), value)}
    if isinstance(value, Mapping):
        return {key: plain_value(inner) for key, inner in value.items()}
    return [plain_value(item) for item in value] if isinstance(value, (tuple, list)) else value


def union_members(kind: Any) -> tuple[Any, ...]:
    """The types of a union, or the type alone."""
    return typing.get_args(kind) if typing.get_origin(kind) in (typing.Union, types.UnionType) else (kind,)


def literal_choices(setting: Setting) -> tuple[str, ...]:
    """The words that a setting may have, if it allows nothing else."""
    if setting.description.choices:
        return setting.description.choices
    return typing.get_args(setting.kind) if typing.get_origin(setting.kind) is typing.Literal else ()
