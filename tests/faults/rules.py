# SPDX-License-Identifier: Apache-2.0
"""Rules of damage: what happens to a field, to a mapping, and to a file, whatever noun it belongs to."""

from __future__ import annotations

import copy
import gzip
import math
import os
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tests.made.file_contents import FORMS


@dataclass(frozen=True)
class Variant:
    """A damaged file: by which rule, where, and what it holds now; None: it is gone; else what makes it something
    else than a file."""

    rule: str
    place: str
    data: bytes | Callable[[Path], object] | None

    def lay(self, path: Path) -> None:
        """Put it in the place of what is there."""
        if path.is_dir() and not path.is_symlink():
            path.rmdir()
        path.unlink(missing_ok=True)
        if callable(self.data):
            self.data(path)
        elif self.data is not None:
            path.write_bytes(self.data)


class Skip(Exception):
    """The rule says nothing about such a value."""


def _is_numbers(value: Any) -> bool:
    if isinstance(value, np.ndarray):
        return value.dtype.kind in "fiu"
    if isinstance(value, bool) or value is None:
        return False
    if isinstance(value, list) and value:
        return all(_is_numbers(v) for v in value) and len({np.shape(v) for v in value}) == 1
    return isinstance(value, (int, float))


def _numbers(change: Callable[[np.ndarray], Any]) -> Callable[[Any], Any]:
    def changed(value: Any) -> Any:
        if not _is_numbers(value):
            raise Skip
        was = np.asarray(value)
        now = change(was.copy())
        if isinstance(now, np.ndarray) and isinstance(value, np.ndarray) and now.dtype.kind == was.dtype.kind:
            now = now.astype(was.dtype)
        if (
            isinstance(now, np.ndarray)
            and now.shape == was.shape
            and np.array_equal(now, was, equal_nan=now.dtype.kind == "f")
        ):
            raise Skip
        return now if isinstance(value, np.ndarray) or not isinstance(now, (np.ndarray, np.generic)) else now.tolist()

    return changed


def _with_first(replaced: Callable[[np.ndarray], Any]) -> Callable[[np.ndarray], np.ndarray]:
    """The first number becomes another one; in whole numbers, which have no such, nothing."""

    def changed(values: np.ndarray) -> np.ndarray:
        if not values.size:
            raise Skip
        if values.dtype.kind != "f":
            values = values.astype(float)
        values.reshape(-1)[0] = replaced(values)
        return values

    return changed


def _floats_only(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[np.ndarray], np.ndarray]:
    def changed(values: np.ndarray) -> np.ndarray:
        if values.dtype.kind != "f":
            raise Skip
        return change(values)

    return changed


def _whole(values: np.ndarray) -> np.ndarray:
    if values.dtype.kind not in "iu" or not values.size:
        raise Skip
    return values + 0.5


def _beyond(values: np.ndarray) -> np.ndarray:
    if not values.size:
        raise Skip
    values.reshape(-1)[0] = 1e30 if values.dtype.kind == "f" else np.iinfo(values.dtype).max
    return values


def _rows(change: Callable[[Any], Any]) -> Callable[[Any], Any]:
    def changed(value: Any) -> Any:
        if not (isinstance(value, list) or (isinstance(value, np.ndarray) and value.ndim)) or not len(value):
            raise Skip
        return change(value)

    return changed


def _signed(values: np.ndarray) -> np.ndarray:
    if values.dtype.kind == "u":
        raise Skip
    return -values


def _another_type(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return np.full(value.shape, "x") if value.dtype.kind != "U" else np.zeros(value.shape)
    return {} if isinstance(value, list) else [] if isinstance(value, dict) else 7 if isinstance(value, str) else "x"


def _reversed(value: Any) -> Any:
    if len(value) < 2 or (
        isinstance(value, np.ndarray) and np.array_equal(value, value[::-1], equal_nan=value.dtype.kind == "f")
    ):
        raise Skip
    return value[::-1]


def _of_pictures(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[np.ndarray], np.ndarray]:
    def changed(values: np.ndarray) -> np.ndarray:
        if values.ndim < 2 or min(values.shape[:2]) < 8:
            raise Skip
        return change(values) if values.ndim < 4 else np.array([change(value) for value in values])

    return changed


def _swapped(values: np.ndarray) -> np.ndarray:
    """x and y of points."""
    if values.ndim < 2 or values.shape[-1] not in (2, 3):
        raise Skip
    return np.concatenate([values[..., [1, 0]], values[..., 2:]], axis=-1)


def _first(word: Any) -> Callable[[Any], Any]:
    """The first number is ``word`` instead: in text, which can hold anything."""

    def changed(value: Any) -> Any:
        if isinstance(value, np.ndarray) or not _is_numbers(value):
            raise Skip
        return [changed(value[0]), *value[1:]] if isinstance(value, list) else word

    return changed


def _deep(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        raise Skip
    for _ in range(400):
        value = [value]
    return value


def _cast(values: np.ndarray) -> np.ndarray:
    with np.errstate(invalid="ignore"):  # of no number
        return values.astype(np.int64)


def _with_last_row(values: np.ndarray) -> np.ndarray:
    """A pose with a last row that scales it."""
    if values.shape != (3, 4):
        raise Skip
    return np.vstack([values, [0, 0, 0, 2]])


def _bare(value: Any) -> Any:
    """A matrix without its header: its numbers alone."""
    if not isinstance(value, dict) or "data" not in value:
        raise Skip
    return value["data"]


def _frozen(rows: Any) -> Any:
    """The second half stands still at its first row."""
    half = len(rows) // 2
    still = [*rows[:half], *[rows[half]] * (len(rows) - half)]
    return np.array(still, rows.dtype) if isinstance(rows, np.ndarray) else still


def _text(value: Any) -> Any:
    if isinstance(value, np.ndarray) and value.dtype.kind == "U" and not value.ndim:
        return np.array("nobody")
    if not isinstance(value, str) or not value:
        raise Skip
    return "nobody"


FIELD: dict[str, Callable[[Any], Any]] = {
    "type": _another_type,
    "shape": _numbers(lambda values: values[..., None] if values.ndim else values.reshape(1, 1)),
    "finite": _numbers(_floats_only(_with_first(lambda values: math.nan))),
    "infinite": _numbers(_floats_only(_with_first(lambda values: math.inf))),
    "whole": _numbers(_whole),
    "range": _numbers(_beyond),
    "count": _rows(lambda rows: rows[:-1]),
    "doubled": _rows(lambda rows: [*rows, rows[-1]] if isinstance(rows, list) else np.concatenate([rows, rows[-1:]])),
    "sign": _numbers(_signed),
    "unit": _numbers(_floats_only(lambda values: values * 1000)),
    "order": _rows(_reversed),
    "text": _text,
    "null": _first(None),
    "truth": _first(True),
    "NaN in words": _first("NaN"),
    "decimal comma": _first("1,5"),
    "endless": _first(10**400),
    "deep": _deep,
    "zero": _numbers(lambda values: values * 0),
    "cast": _numbers(_floats_only(_cast)),
    "complex": _numbers(_floats_only(lambda values: values + 0j)),
    "bare": _bare,
    "last row": _numbers(_with_last_row),
    "byte order": _numbers(lambda values: values.byteswap()),
    "frozen": _rows(_frozen),
    "late": _rows(lambda rows: [*rows[-1:], *rows[:-1]] if isinstance(rows, list) else np.roll(rows, 1, axis=0)),
    "mirrored": _numbers(_of_pictures(lambda values: values[:, ::-1])),
    "swapped": _numbers(_swapped),
}
FILE: dict[str, Callable[[bytes], bytes]] = {
    "file: empty": lambda data: b"",
    "file: half": lambda data: data[: len(data) // 2],
    "file: its end": lambda data: data[: -max(len(data) // 50, 2)],
    "file: zeros": lambda data: bytes(len(data)),
    "file: a page": lambda data: b"<html>404</html>",
    "file: a pickle": lambda data: b"cos\nsystem\n(S'touch x'\ntR.",
    "file: deep": lambda data: b"[" * 100_000,
    "file: twice": lambda data: data + data,
    "file: packed": gzip.compress,
    "file: a hole": lambda data: data[: len(data) // 3] + bytes(len(data) // 3) + data[len(data) // 3 * 2 :],
    "encoding: decimal commas": lambda data: re.sub(rb"(\d)\.(\d)", rb"\1,\2", data),
    "encoding: utf-16": lambda data: data.decode("utf-8", "replace").encode("utf-16"),
    "encoding: latin-1": lambda data: b"\xe4\xf6" + data,
}
HARMLESS: dict[str, Callable[[bytes], bytes]] = {
    "byte order mark": lambda data: b"\xef\xbb\xbf" + data,
    "CRLF": lambda data: data.replace(b"\n", b"\r\n"),
}
PLACES: dict[str, Callable[[Path], object]] = {
    "place: a folder": Path.mkdir,
    "place: a loop of links": lambda path: path.symlink_to(path.name),
    "place: a link to nothing": lambda path: path.symlink_to("nowhere"),
    "place: a pipe": os.mkfifo,
    "place: closed": lambda path: (path.write_bytes(b"{}"), path.chmod(0)),
}
NAMES = [
    "$(touch x)", "`touch x`", "a&b", "..", ".", "/etc", "-rf", "a\nb", "a;b", "a{b}", "", "a" * 101, "a  b", "a:b",
    "\u202ea", "a\u200bb", "\N{CAMERA}1", "cam" * 20, "take_" + "ab" * 21,
]  # fmt: skip


def places(tree: Any, path: tuple = ()) -> Iterator[tuple]:
    """The way to every field; of a list of things that are no numbers, to its first and its last."""
    yield path
    if isinstance(tree, dict):
        for key, below in tree.items():
            yield from places(below, (*path, key))
    elif isinstance(tree, list) and not _is_numbers(tree):
        for index in dict.fromkeys((0, len(tree) - 1)) if tree else ():
            yield from places(tree[index], (*path, index))


def at(tree: Any, path: tuple) -> Any:
    for key in path:
        tree = tree[key]
    return tree


def _replaced(tree: Any, path: tuple, value: Any) -> Any:
    if not path:
        return value
    made = copy.deepcopy(tree)
    at(made, path[:-1])[path[-1]] = value
    return made


def _trees(tree: Any) -> Iterator[tuple[str, tuple, Any]]:
    """Rule, place and tree of every damage of fields."""
    for path in places(tree):
        value = at(tree, path)
        for rule, change in FIELD.items():
            try:
                yield rule, path, _replaced(tree, path, change(value))
            except Skip:
                continue
        if isinstance(value, dict):
            arrays = path == () and any(isinstance(v, np.ndarray) for v in value.values())
            yield "unknown", path, _replaced(tree, path, {**value, "unheard": np.zeros(1) if arrays else 1})
            for key in value:
                other = {k.swapcase() if k == key else k: v for k, v in value.items() if isinstance(k, str)}
                yield "respelled", (*path, key), _replaced(tree, path, other)
                yield "missing", (*path, key), _replaced(tree, path, {k: v for k, v in value.items() if k != key})


def variants(suffix: str, whole: bytes, other: bytes | None = None) -> Iterator[Variant]:
    """Every damage of a file: of its fields, of the whole of it, and put in the place of ``other`` (its content)."""
    yield Variant("file: gone", "", None)
    yield from (Variant(rule, "", put) for rule, put in PLACES.items())
    yield from (Variant(rule, "", change(whole)) for rule, change in FILE.items())
    if other is not None:
        yield Variant("exchanged", "", other)
    if (form := FORMS.get(suffix)) is None:
        return
    tree = form.taken(whole)
    for rule, path, damaged in _trees(tree):
        try:
            data = form.put(damaged)
        except Exception:  # no file of this form can hold it
            continue
        if data != whole:
            yield Variant(rule, ".".join(map(str, path)), data)
    if suffix == ".json" and isinstance(tree, dict):
        for key in tree:
            first = f'"{key}":'
            yield Variant("doubled key", key, whole.replace(first.encode(), f"{first} 1,\n {first}".encode(), 1))


def bytes_changed(data: bytes, rng: np.random.Generator) -> bytes:
    """One to four places of ``data`` changed, taken out, doubled or filled."""
    changed = bytearray(data)
    for _ in range(rng.integers(1, 5)):
        place, length = int(rng.integers(0, len(changed) + 1)), int(rng.integers(1, 9))
        kind = rng.integers(0, 4)
        if kind == 0 and place < len(changed):
            changed[place] = int(rng.integers(0, 256))
        elif kind == 1:
            del changed[place : place + length]
        elif kind == 2:
            changed[place:place] = changed[place : place + length]
        else:
            changed[place:place] = rng.choice(np.frombuffer(b'[]{}",:-e9\n\t\xff\0', np.uint8), length).tobytes()
    return bytes(changed)
