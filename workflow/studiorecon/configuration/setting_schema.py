# SPDX-License-Identifier: Apache-2.0
"""A setting as JSON schema."""

from __future__ import annotations

import dataclasses
import typing
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from studiorecon.configuration.setting import Setting, literal_choices, plain_value, union_members

_TYPES = {bool: "boolean", int: "integer", float: "number", str: "string"}
_BOUNDS = {"minimum": "minimum", "above": "exclusiveMinimum", "maximum": "maximum", "below": "exclusiveMaximum"}


def section_schema(settings: Iterable[Setting], meaning: str, required: bool = True) -> dict[str, Any]:
    """The schema of a mapping that holds these settings and no others."""
    properties = {setting.name: build_schema(setting) for setting in settings}
    demanded = {"required": list(properties)} if required else {}
    return {"description": meaning, "type": "object", "additionalProperties": False, **demanded} | {
        "properties": properties
    }


def build_schema(setting: Setting) -> dict[str, Any]:
    """The schema of one setting or section."""
    about = setting.description
    if setting.is_section:
        return section_schema(setting.inner(), about.meaning)
    default = {} if setting.default is dataclasses.MISSING else {"default": plain_value(setting.default)}
    return _shape(setting) | default


def _shape(setting: Setting) -> dict[str, Any]:
    about = setting.description
    if about.shape is not None:
        return {"description": about.meaning, **about.shape}
    if choices := literal_choices(setting):
        return {"description": about.meaning, "enum": list(choices)}
    # Other types that code may put there (an array) cannot be in a configuration.
    kinds = [kind for kind in union_members(setting.kind) if kind in _TYPES or typing.get_origin(kind)]
    options = [_type_schema(kind, setting) for kind in kinds]
    if len(options) > 1 and all(set(option) == {"type"} for option in options):
        options = [{"type": [option["type"] for option in options]}]
    return {"description": about.meaning, **(options[0] if len(options) == 1 else {"oneOf": options})}


def _type_schema(kind: Any, setting: Setting) -> dict[str, Any]:
    origin, inner = typing.get_origin(kind), typing.get_args(kind)
    if origin is typing.Literal:
        return {"enum": list(inner)}
    if origin is tuple:
        return {
            "type": "array",
            "items": _type_schema(inner[0], setting),
            **({} if Ellipsis in inner else {"minItems": len(inner), "maxItems": len(inner)}),
        }
    if origin in (dict, Mapping):
        return {"type": "object", "additionalProperties": _type_schema(inner[1], setting)}
    if origin in (list, Sequence):
        return {"type": "array", "items": _type_schema(inner[0], setting)}
    found: dict[str, Any] = {"type": _TYPES[kind]}
    if kind in (int, float):
        found |= {
            word: bound for name, word in _BOUNDS.items() if (bound := getattr(setting.description, name)) is not None
        }
        if setting.description.odd:
            found["not"] = {"multipleOf": 2}
    return found
