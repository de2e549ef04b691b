# SPDX-License-Identifier: Apache-2.0
"""Checks the configuration against its schema: converts values to its types, and describes mistakes.

Snakemake reads values inside ``--config section='{...}'`` as text, YAML reads an unquoted ``off`` as false and ``1e-4``
as text. The type of such a value depends on the setting, not on how it was written: ``coerce_types`` uses the
interpretation that the schema allows.
"""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Iterator, Mapping
from typing import Any

import jsonschema

from studiorecon.scene.user_values import short_text

_INTEGER = re.compile(r"[-+]?(?:0|[1-9]\d*)", re.ASCII)
_REAL = re.compile(r"[-+]?(?:(?:0|[1-9]\d*)(?:\.\d*)?|\.\d+)(?:[eE][-+]?\d+)?", re.ASCII)
_WORDS = {"true": True, "yes": True, "on": True, "false": False, "no": False, "off": False}


def coerce_types(value: Any, schema: Mapping[str, Any], root: Mapping[str, Any] | None = None) -> Any:
    """A copy of ``value`` in which every setting has the type that ``schema`` gives it, as far as possible.

    Other values stay, for ``mistakes`` to report. ``root`` is the schema that references point into.
    """
    root = schema if root is None else root
    schema = _resolve(schema, root)
    if isinstance(value, Mapping):
        made = {str(key): coerce_types(inner, _property(schema, str(key)), root) for key, inner in value.items()}
        for part in schema.get("allOf", ()):
            if "if" not in part or _valid(made, part["if"], root):
                made = coerce_types(made, part.get("then", part) if "if" in part else part, root)
        return made
    if isinstance(value, (list, tuple)):
        options = [schema, *(_resolve(option, root) for option in schema.get("oneOf", ()))]
        items: dict[str, Any] = next((option["items"] for option in options if "items" in option), {})
        return [coerce_types(item, items, root) for item in value]
    readings = list(_readings(value, schema))
    kind = {"type": schema.get("type", [])}
    # A number out of bounds is still a number, and is refused as a number.
    return next((r for part in (schema, kind) for r in readings if _valid(r, part, root)), value)


def mistakes(config: Mapping[str, Any], schema: Mapping[str, Any]) -> list[str]:
    """A sentence for every setting that breaks the schema. Unknown names come first, with the nearest known name."""
    found = sorted(
        _validator(schema, schema).iter_errors(config), key=lambda error: error.validator != "additionalProperties"
    )
    # One mistake per place is enough: a value of the wrong type breaks other rules as well.
    first = {(str(error.absolute_path), error.validator == "additionalProperties"): error for error in reversed(found)}
    return list(
        dict.fromkeys(sentence for error in found if error in first.values() for sentence in _sentences(error, schema))
    )


def walk_settings(schema: Mapping[str, Any]) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Every setting of the schema by its dotted name, sections included, with the schema's part for it."""
    for name, inner in schema.get("properties", {}).items():
        yield name, inner
        for below, part in walk_settings(inner):
            yield f"{name}.{below}", part


def find_schema(schema: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    """The part of the schema for one setting, by its dotted name; empty if the schema has none."""
    for step in name.split("."):
        schema = _property(schema, step)
    return schema


def _readings(value: Any, schema: Mapping[str, Any]) -> Iterator[Any]:
    """Possible interpretations of a scalar, likeliest first."""
    if isinstance(value, float) and value.is_integer() and schema.get("type") == "integer":
        yield int(value)
    yield value
    if isinstance(value, str):
        # Neither 010, which YAML 1.1 reads as 8, nor 1_000.
        if _INTEGER.fullmatch(value):
            yield int(value)
        elif _REAL.fullmatch(value):
            yield float(value)
        if value.lower() in _WORDS:
            yield _WORDS[value.lower()]
    elif isinstance(value, bool):
        yield "on" if value else "off"
    elif isinstance(value, int):
        yield str(value)
    elif value is None:
        yield ""


def _property(schema: Mapping[str, Any], key: str) -> Mapping[str, Any]:
    beyond = schema.get("additionalProperties")
    return schema.get("properties", {}).get(key, beyond if isinstance(beyond, Mapping) else {})


def _resolve(schema: Mapping[str, Any], root: Mapping[str, Any]) -> Mapping[str, Any]:
    while "$ref" in schema:
        place: Any = root
        for name in schema["$ref"].removeprefix("#/").split("/"):
            place = place[name]
        schema = place
    return schema


_Finite = jsonschema.validators.extend(
    jsonschema.Draft202012Validator,
    type_checker=jsonschema.Draft202012Validator.TYPE_CHECKER.redefine(
        "number", lambda _, value: type(value) is int or (type(value) is float and math.isfinite(value))
    ),
)


def _validator(schema: Mapping[str, Any], root: Mapping[str, Any]) -> Any:
    return _Finite({**schema, "$defs": root.get("$defs", {})})


def _valid(value: Any, schema: Mapping[str, Any], root: Mapping[str, Any]) -> bool:
    return _validator(schema, root).is_valid(value)


def _sentences(error: jsonschema.ValidationError, schema: Mapping[str, Any]) -> Iterator[str]:
    path = [str(step) for step in error.absolute_path]
    where = ".".join(path) or "the configuration"
    found = f"setting {where} is {short_text(error.instance)}"
    if error.validator == "additionalProperties":
        known = list(error.schema.get("properties", {}))
        for name in error.instance:
            if name not in known:
                yield f"there is no setting {'.'.join([*path, name])}{_nearest(name, path, known, schema)}"
    elif error.validator == "required":
        missing = ", ".join(name for name in error.validator_value if name not in error.instance)
        yield f"setting {where} lacks {missing}{_choices(error.schema, missing)}"
    elif error.validator == "enum" and "propertyNames" in error.absolute_schema_path:
        if "description" in error.schema:
            near = difflib.get_close_matches(str(error.instance), error.validator_value, 1)
            meant = f"; did you mean {near[0]}?" if near else f": {', '.join(error.validator_value)}"
            yield f"setting {where} has {error.instance}, but {error.schema['description']}{meant}"
            return
        yield (
            "there is no setting "
            f"{where}.{error.instance}{_nearest(str(error.instance), path, error.validator_value, schema)}"
        )
    elif error.validator == "enum":
        near = difflib.get_close_matches(str(error.instance), list(map(str, error.validator_value)), 1)
        meant = f"; did you mean {near[0]}?" if near else ""
        yield f"{found}; it must be one of {', '.join(map(str, error.validator_value))}{meant}"
    elif error.validator == "type" and error.instance is None and error.validator_value == "object":
        yield f"setting {where} is empty; leave it out, or say {where}: {{}} where nothing in it is to change"
    elif error.validator == "type":
        wanted = error.validator_value if isinstance(error.validator_value, list) else [error.validator_value]
        yield f"{found}; it must be {' or '.join(_KINDS[kind] for kind in wanted)}"
    elif error.validator in _BOUNDS:
        yield f"{found}; it must be {_BOUNDS[error.validator]} {error.validator_value}"
    elif error.validator in ("minItems", "maxItems"):
        bound = "at least" if error.validator == "minItems" else "at most"
        yield f"setting {where} has {len(error.instance)} entries; it must have {bound} {error.validator_value}"
    elif "description" in error.schema:
        yield f"{found}, but it must fit: {error.schema['description'].rstrip('.')}"
    else:
        yield f"setting {where}: {error.message}"


_BOUNDS = {
    "minimum": "at least",
    "maximum": "at most",
    "exclusiveMinimum": "more than",
    "exclusiveMaximum": "less than",
}
_KINDS = {
    "object": "a section with settings of its own",
    "array": "a list",
    "integer": "a whole number",
    "number": "a number",
    "boolean": "true or false",
    "string": "text",
}


def _choices(schema: Mapping[str, Any], name: str) -> str:
    choices = schema.get("properties", {}).get(name, {}).get("enum")
    return f", which is one of {', '.join(choices)}" if choices else ""


def _nearest(name: str, path: list[str], known: list[str], schema: Mapping[str, Any]) -> str:
    """The probable meaning of an unknown name: a similar neighbour, or the same name in another section."""
    near = [".".join([*path, close]) for close in difflib.get_close_matches(name, known, 1)]
    elsewhere = [full for full, _ in walk_settings(schema) if full.rpartition(".")[2] == name]
    inside = [full for full in elsewhere if path and full.startswith(f"{path[0]}.")]
    found = near or inside[:3] or elsewhere[:3]
    if found:
        return f"; did you mean {' or '.join(found)}?"
    return f"; {'.'.join(path) or 'the configuration'} holds {', '.join(known)}" if len(known) <= 20 else ""
