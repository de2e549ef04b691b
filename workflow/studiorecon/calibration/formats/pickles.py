# SPDX-License-Identifier: Apache-2.0
"""Reads pickled arrays from other programs without running their code.

A pickle is a program that builds its content. Of everything that it may request, only the parts of numpy's arrays are
allowed. Not even those are numpy's own, which crash the interpreter on damaged input: placeholders record the parts of
an array, and arrays are built from them afterwards.
"""

from __future__ import annotations

import io
import math
import pickle
import re
from pathlib import Path
from typing import Any

import numpy as np

from studiorecon.errors import UserError
from studiorecon.scene.user_files import first_line, read_bytes, refuse_pickle_bomb

# Errors that a damaged pickle raises.
_BROKEN = (AttributeError, IndexError, ValueError, KeyError, TypeError, ImportError, OverflowError, RecursionError)
_NUMBERS = re.compile(r"b1|[iu][1248]|f[248]")


def read_pickle(path: Path) -> Any:
    """Dictionaries, lists, numbers and arrays of a ``.pkl``, or of a ``.npy`` that holds one object.

    Raises UserError when the file is cut short or requests anything but numpy arrays: a pickle can run any program.
    """
    data = read_bytes(path)
    stream = io.BytesIO(data)
    try:
        if data.startswith(b"\x93NUMPY"):
            version = np.lib.format.read_magic(stream)
            header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
            header(stream)
        refuse_pickle_bomb(data[stream.tell() :])
        value = _made(_ArraysOnly(stream).load(), {})
    except (pickle.UnpicklingError, EOFError, MemoryError, SyntaxError, *_BROKEN) as error:
        raise UserError(
            f"{path} is not a plain table of arrays ({first_line(error)}); it may be cut short, or "
            "made to run a program: it was not opened"
        ) from None
    return value.item() if isinstance(value, np.ndarray) and value.dtype == object and value.size == 1 else value


class _Type:
    """``numpy.dtype`` as it was pickled."""

    def __init__(self, code: str = "", *_: Any) -> None:
        self.code, self.order = code, "="

    def __setstate__(self, state: tuple) -> None:
        self.order = state[1]

    def made(self) -> np.dtype:
        """Raises UnpicklingError for anything but numbers."""
        if not (isinstance(self.code, str) and _NUMBERS.fullmatch(self.code) and self.order in ("<", ">", "=", "|")):
            raise pickle.UnpicklingError(f"it holds arrays of {self.code!r}")
        return np.dtype(("=" if self.order == "|" else self.order) + self.code)


class _Array:
    """``numpy.ndarray`` as it was pickled."""

    def __init__(self, *state: Any) -> None:
        self.state = state

    def __setstate__(self, state: tuple) -> None:
        self.state = state[-4:]

    def made(self, seen: dict[int, Any]) -> Any:
        """The array; raises one of ``_BROKEN`` where its parts do not fit together."""
        shape, kind, fortran, data = self.state
        count = math.prod(shape)
        if not isinstance(kind, _Type) or not all(isinstance(extent, int) and extent >= 0 for extent in shape):
            raise pickle.UnpicklingError("it holds a damaged array")
        if kind.code in ("O", "O8"):
            if not isinstance(data, list) or len(data) != count:
                raise pickle.UnpicklingError("it holds a damaged array")
            flat = np.empty(count, object)
            for index, value in enumerate(data):
                flat[index] = _made(value, seen)
        else:
            flat = np.frombuffer(data, kind.made(), count).copy()
        return flat.reshape(shape[::-1]).T if fortran else flat.reshape(shape)


def _scalar(kind: Any, data: bytes = b"") -> _Array:
    return _Array((), kind, False, data)


def _from_buffer(data: Any, kind: Any, shape: tuple, order: str) -> _Array:
    return _Array(shape, kind, order == "F", bytes(data))


def _as_latin(text: str, coding: str) -> bytes:
    if coding != "latin1":
        raise pickle.UnpicklingError(f"it holds text in {coding}")
    return text.encode("latin1")


# The building blocks of numpy's arrays, scalars and types, with our placeholders; a pickle that requests anything else
# is not data. Before numpy 2 the private modules were called numpy.core.
_STAND_INS: dict[tuple[str, str], Any] = {
    ("numpy", "ndarray"): _Array,
    ("numpy", "dtype"): _Type,
    ("numpy._core.multiarray", "_reconstruct"): lambda *_: _Array(),
    ("numpy._core.multiarray", "scalar"): _scalar,
    ("numpy._core.numeric", "_frombuffer"): _from_buffer,
    ("_codecs", "encode"): _as_latin,
    ("__builtin__", "bytes"): lambda: b"",
}


class _ArraysOnly(pickle.Unpickler):
    def find_class(self, module: str, name: str) -> Any:
        known = _STAND_INS.get((module.replace("numpy.core.", "numpy._core."), name))
        if known is None:
            raise pickle.UnpicklingError(f"it asks for {module}.{name}")
        return known


def _made(value: Any, seen: dict[int, Any]) -> Any:
    """``value`` with arrays for placeholders; repeated objects are built once (a file can name one a billion times)."""
    if id(value) in seen:
        return seen[id(value)]
    if isinstance(value, _Array):
        array = value.made(seen)
        found = array if array.shape or array.dtype == object else array[()]
    elif isinstance(value, dict):
        found = seen[id(value)] = {}
        found.update({_made(key, seen): _made(held, seen) for key, held in value.items()})
    elif isinstance(value, list):
        found = seen[id(value)] = []
        found.extend(_made(held, seen) for held in value)
    elif isinstance(value, tuple):
        found = tuple(_made(held, seen) for held in value)
    elif value is None or isinstance(value, (str, bytes, bool, int, float, set, frozenset)):
        return value
    else:
        raise pickle.UnpicklingError(f"it holds a {type(value).__name__}")
    return seen.setdefault(id(value), found)
