# SPDX-License-Identifier: Apache-2.0
"""Damage of files, by class: what a copy, an editor, a spreadsheet or somebody hostile does to them."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

import numpy as np

# What stands where something else belongs.
WRONG: list[Any] = [
    None, "text", "", True, -1, 10**400, 1e308, float("nan"), float("inf"), [], {}, [[]], [None], {"x": {}}, ["a", [1]],
    "$(touch x)", "../..", [1e308] * 6, [[1, 2], [3]],
]  # fmt: skip
NAMES = [
    "$(touch x)", "`touch x`", "a&b", "..", ".", "/etc", "-rf", "a\nb", "a;b", "a{b}", "", "a" * 101, "a  b",
]  # fmt: skip
ENCODINGS: dict[str, Any] = {
    "empty": lambda data: b"",
    "half": lambda data: data[: len(data) // 2],
    "utf-16": lambda data: data.decode("utf-8", "replace").encode("utf-16"),
    "latin-1": lambda data: b"\xe4\xf6" + data,
    "zeros": lambda data: bytes(len(data)),
    "zero inside": lambda data: data[:5] + b"\0" + data[5:],
    "deep": lambda data: b"[" * 100_000,
    "pickle": lambda data: b"cos\nsystem\n(S'touch x'\ntR.",
    "html": lambda data: b"<html>404</html>",
}
HARMLESS: dict[str, Any] = {
    "byte order mark": lambda data: b"\xef\xbb\xbf" + data,
    "CRLF": lambda data: data.replace(b"\n", b"\r\n"),
}


def bytes_changed(data: bytes, rng: np.random.Generator) -> bytes:
    """One to four places of ``data`` changed, taken out, doubled or filled."""
    changed = bytearray(data)
    for _ in range(rng.integers(1, 5)):
        at = int(rng.integers(0, len(changed) + 1))
        length = int(rng.integers(1, 9))
        kind = rng.integers(0, 4)
        if kind == 0 and at < len(changed):
            changed[at] = int(rng.integers(0, 256))
        elif kind == 1:
            del changed[at : at + length]
        elif kind == 2:
            changed[at:at] = changed[at : at + length]
        else:
            changed[at:at] = rng.choice(np.frombuffer(b'[]{}",:-e9\n\t\xff\0', np.uint8), length).tobytes()
    return bytes(changed)


def places(value: Any, path: tuple = ()) -> Iterator[tuple]:
    """The path of every value inside of ``value``, itself first."""
    yield path
    inner = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, below in inner:
        yield from places(below, (*path, key))


def structure_changed(value: Any, rng: np.random.Generator) -> Any:
    """A copy of ``value`` in which one place, of any depth, is gone or holds something else."""
    copy = json.loads(json.dumps(value))
    every = list(places(copy))
    depth = rng.choice(sorted({len(path) for path in every}))
    chosen = [path for path in every if len(path) == depth]
    path = chosen[int(rng.integers(0, len(chosen)))]
    wrong = WRONG[int(rng.integers(0, len(WRONG)))]
    if not path:
        return wrong
    holder = copy
    for key in path[:-1]:
        holder = holder[key]
    if rng.random() < 0.25:
        del holder[path[-1]]
    else:
        holder[path[-1]] = wrong
    return copy
