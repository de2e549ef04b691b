# SPDX-License-Identifier: Apache-2.0
"""The schema of a file between two steps: declared field by field, checked by one function.

The module of a data type declares a schema next to its writer, such as ``{"fps": real(above=0, unit="frames per
second"), "times_s": real("N", such=ASCENDING)}``. Equal letters in shapes mean equal sizes within one mapping and those
inside it. ``check`` does not change the values.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from typing import Any, TypeVar

import numpy as np

from studiorecon.arrays import require
from studiorecon.scene.user_values import short_text

T = TypeVar("T")
LARGEST = 1e9
"""No step writes a larger number."""
# No scene reaches 100 km, even where a calibration's lengths are millimetres; no capture lasts twelve days; no rotation
# has 160 turns; no camera here takes a million pictures a second.
FAR_M, _LONG_S, _TURNED_RAD, _FASTEST_FPS = 1e5, 1e6, 1e3, 1e6


@dataclass(frozen=True)
class ArrayProperty:
    """A property of a whole array, in words."""

    words: str
    holds: Callable[[Any], bool]


@dataclass(frozen=True)
class Numbers:
    """Numbers of one kind; "" is a single one, "N 3" a table of rows of three, "..." of any shape.

    ``low`` and ``high`` belong to the range, ``above`` does not. ``gaps`` allows NaN, infinities and null.
    """

    kind: str
    shape: str = ""
    low: float = -LARGEST
    high: float = LARGEST
    above: float = -LARGEST
    unit: str = ""
    gaps: bool = False
    such: ArrayProperty | None = None

    @property
    def words(self) -> str:
        """The expected value, as the rest of a sentence."""
        what = {"f": "numbers", "i": "whole numbers", "b": "true or false"}[self.kind]
        least = max(self.above, self.low)
        bounds = {
            (True, True): f" from {least:g} to {self.high:g}",
            (True, False): f" {'above' if self.above > self.low else 'of at least'} {least:g}",
            (False, True): f" up to {self.high:g}",
            (False, False): "",
        }[least > -LARGEST, self.high < LARGEST]
        return what + bounds + (f" {self.unit}" if self.unit else "") + (f", {self.such.words}" if self.such else "")


@dataclass(frozen=True)
class Text:
    """Text; one of ``choices``, if given."""

    choices: tuple[str, ...] = ()


@dataclass(frozen=True)
class OptionalField:
    """A value that may be missing or null."""

    inner: Schema


@dataclass(frozen=True)
class ListOf:
    """A list of values of one kind, or a row of texts in an npz."""

    inner: Schema


@dataclass(frozen=True)
class MappingOf:
    """A mapping from arbitrary names to values of one kind."""

    inner: Schema


@dataclass(frozen=True)
class Anything:
    """A value that no step computes with."""


@dataclass(frozen=True)
class AtLeast:
    """A mapping with these fields, and perhaps others, with which no step computes."""

    fields: Mapping[str, Any]


Schema = Numbers | Text | OptionalField | ListOf | MappingOf | Anything | AtLeast | Mapping[str, Any]


def real(shape: str = "", **limits: Any) -> Numbers:
    """Real numbers, finite unless ``gaps``."""
    return Numbers("f", shape, **limits)


def metres(shape: str = "", **limits: Any) -> Numbers:
    """Lengths and positions."""
    return real(shape, **({"low": -FAR_M, "high": FAR_M, "unit": "m"} | limits))


def seconds(shape: str = "", **limits: Any) -> Numbers:
    """Times."""
    return real(shape, **({"low": -_LONG_S, "high": _LONG_S, "unit": "s"} | limits))


def radians(shape: str = "", **limits: Any) -> Numbers:
    """Angles, and rotations about an axis."""
    return real(shape, **({"low": -_TURNED_RAD, "high": _TURNED_RAD, "unit": "rad"} | limits))


def frame_rate() -> Numbers:
    """Frames per second."""
    return real(above=0, high=_FASTEST_FPS, unit="frames per second")


def whole(shape: str = "", **limits: Any) -> Numbers:
    """Whole numbers."""
    return Numbers("i", shape, **limits)


def flag(shape: str = "") -> Numbers:
    """True or false."""
    return Numbers("b", shape)


def text(*choices: str) -> Text:
    """Text, any or one of ``choices``."""
    return Text(choices)


def _is_rigid(matrix: np.ndarray) -> bool:
    turn = matrix[..., :3, :3]
    straight = np.abs(turn @ np.swapaxes(turn, -1, -2) - np.eye(3)).max(initial=0) < _ROTATION
    below = matrix.shape[-1] == 3 or np.array_equal(
        matrix[..., 3, :], np.broadcast_to([0, 0, 0, 1], matrix[..., 3, :].shape)
    )
    return bool(straight and below and (np.linalg.det(turn) > 0).all())


def _is_intrinsic(matrix: np.ndarray) -> bool:
    return bool(
        matrix[0, 0] > 0 and matrix[1, 1] > 0 and np.array_equal(matrix[[1, 2, 2, 2], [0, 0, 1, 2]], [0, 0, 0, 1])
    )


# Calibrations give rotations to three digits; wrong signs or orders cause far larger errors.
_ROTATION = 0.02
RIGID = ArrayProperty("a rotation, and 0 0 0 1 in the last row", _is_rigid)
ROTATION = ArrayProperty("rotations", _is_rigid)
INTRINSIC = ArrayProperty("focal lengths above 0, and 0 below the diagonal, whose last is 1", _is_intrinsic)
KNOWN_OR_INFINITE = ArrayProperty("none of them NaN", lambda values: not np.isnan(values).any())
ASCENDING = ArrayProperty("in ascending order", lambda values: bool((np.diff(values, axis=0) >= 0).all()))
UNIT_NORMALS = ArrayProperty(
    "normals of length 1 in front", lambda planes: bool((np.abs((planes[:, :3] ** 2).sum(-1) - 1) < _ROTATION).all())
)
CONFIDENT = ArrayProperty(
    "confidences from 0 to 1 in the last column, and finite positions where they are above 0",
    lambda keypoints: bool(
        (np.abs(keypoints[..., 2] - 0.5) <= 0.5).all() and np.isfinite(keypoints[keypoints[..., 2] > 0]).all()
    ),
)


def record(kind: type[T], value: Mapping[str, Any]) -> T:
    """The dataclass that a file holds: lists become arrays or tuples as it annotates them, an npz's single values
    Python's; what is missing has its default."""
    made: dict[str, Any] = {}
    for field in fields(kind):  # type: ignore[arg-type]
        annotated = str(field.type)
        held: Any = value.get(field.name)
        if field.name not in value or (held is None and "None" not in annotated):
            continue
        if isinstance(held, list):
            held = np.array(held, np.float64) if "np.ndarray" in annotated else held
            held = tuple(held) if annotated.startswith("tuple") else held
        elif isinstance(held, np.ndarray) and not held.shape:
            held = held.item()
        made[field.name] = float(held) if annotated == "float" else held
    return kind(**made)


def check(value: Any, schema: Schema, name: str = "", sizes: Mapping[str, int] | None = None) -> None:
    """Raises ValueError with the field below ``name`` whose value does not match ``schema``, and the expected value.

    ``sizes``: letters of shapes that are known already.
    """
    _check(value, schema, name, dict(sizes or {}))


def _check(value: Any, schema: Schema, name: str, sizes: dict[str, int]) -> None:
    match schema:
        case OptionalField(inner):
            if value is not None:
                _check(value, inner, name, sizes)
        case Text(choices):
            plain = (
                str(value) if isinstance(value, np.ndarray) and value.dtype.kind == "U" and not value.shape else value
            )
            if not isinstance(plain, str) or (choices and plain not in choices):
                raise ValueError(f"{_at(name)}{short_text(plain)}, expected {' or '.join(choices) or 'text'}")
        case Numbers():
            sizes |= _numbers(value, schema, name or "it", sizes)
        case ListOf(inner):
            if not (isinstance(value, list) or (isinstance(value, np.ndarray) and value.ndim == 1)):
                raise ValueError(f"{_at(name)}{short_text(value)}, expected a list")
            for index, each in enumerate(value):
                _check(each, inner, f"{name}[{index}]", dict(sizes))
        case MappingOf(inner):
            for key, each in _mapping(value, name).items():
                _check(each, inner, f"{name}.{key}".lstrip("."), dict(sizes))
        case AtLeast(fields):
            _check({key: one for key, one in _mapping(value, name).items() if key in fields}, fields, name, sizes)
        case Mapping():
            held = _mapping(value, name)
            if unknown := [key for key in held if key not in schema]:
                raise ValueError(f"{name or 'it'} has the unknown field {short_text(unknown[0])}")
            own = dict(sizes)
            for key, inner in schema.items():
                if key in held:
                    _check(held[key], inner, f"{name}.{key}".lstrip("."), own)
                elif not isinstance(inner, OptionalField):
                    raise ValueError(f"{name or 'it'} has no {key!r}")


def _mapping(value: Any, name: str) -> Mapping[str, Any]:
    if not isinstance(value, Mapping):
        raise ValueError(f"{_at(name)}{short_text(value)}, expected names and their values")
    return value


def _at(name: str) -> str:
    return f"{name or 'it'} is "


def _numbers(value: Any, field: Numbers, name: str, sizes: Mapping[str, int]) -> dict[str, int]:
    """The sizes of all letters, including those of this field."""
    array = value if isinstance(value, np.ndarray) else _of_lists(value, field, name)
    if array.dtype.kind not in {"f": "fiu", "i": "iu", "b": "b"}[field.kind]:
        raise ValueError(f"{name} holds {array.dtype}, expected {field.words}")
    letters = [... if part == "..." else int(part) if part.isdigit() else part for part in field.shape.split()]
    found = require(name, array, tuple(letters), sizes)
    if field.kind == "b":
        return found
    finite = np.isfinite(array)
    if not field.gaps and not finite.all():
        raise ValueError(f"{int((~finite).sum())} of {array.size} numbers of {name} are not finite")
    outside = finite & ~((array >= field.low) & (array <= field.high) & (array > field.above))
    if outside.any():
        raise ValueError(f"{name} holds {array[outside].flat[0]:g}, expected {field.words}")
    if field.such is not None and not field.such.holds(array):
        raise ValueError(f"{name} does not hold {field.words}")
    return found


def _of_lists(value: Any, field: Numbers, name: str) -> np.ndarray:
    """The array of a number or of nested lists, as in JSON."""
    try:
        things = np.array(value, dtype=object)
        flat = things.reshape(-1).tolist()
        kinds = {"f": (int, float), "i": (int,), "b": (bool,)}[field.kind]
        if any(not isinstance(v, kinds) or (field.kind != "b" and isinstance(v, bool)) for v in flat if v is not None):
            raise TypeError
        if field.kind != "f":
            array = np.array(flat, dtype={"i": np.int64, "b": bool}[field.kind])
        else:
            array = np.array([math.nan if v is None else v for v in flat], dtype=np.float64)
            if np.isinf(array).any():  # non-finite numbers are written as null
                raise ValueError
    except (TypeError, ValueError, OverflowError, RecursionError):
        raise ValueError(f"{name} is {short_text(value)}, expected {field.words}") from None
    # An empty list does not determine the lengths of its rows.
    extents = field.shape.split()
    if not flat and things.ndim < len(extents):
        return array.reshape(0, *(int(part) if part.isdigit() else 0 for part in extents[1:]))
    return array.reshape(things.shape)
