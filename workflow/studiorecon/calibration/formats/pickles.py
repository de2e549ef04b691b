# SPDX-License-Identifier: Apache-2.0
"""Pickled arrays of other people, read without running their code."""

from __future__ import annotations

import io
import pickle
from pathlib import Path
from typing import Any

import numpy as np

from studiorecon.errors import UserError
from studiorecon.scene.outside import read_bytes

# What numpy's own arrays, scalars and types are made of; a pickle that asks for anything else is not data.
_HARMLESS = {
    ("numpy", "ndarray"),
    ("numpy", "dtype"),
    ("numpy.core.multiarray", "_reconstruct"),
    ("numpy.core.multiarray", "scalar"),
    ("numpy._core.multiarray", "_reconstruct"),
    ("numpy._core.multiarray", "scalar"),
    ("_codecs", "encode"),
}

# What a damaged pickle ends in.
_BROKEN = (AttributeError, IndexError, ValueError, KeyError, TypeError, ImportError, OverflowError, RecursionError)


class _ArraysOnly(pickle.Unpickler):
    def find_class(self, module: str, name: str) -> Any:
        if (module, name) not in _HARMLESS:
            raise pickle.UnpicklingError(f"it asks for {module}.{name}")
        return super().find_class(module.replace("numpy.core.", "numpy._core."), name)


def read_pickle(path: Path) -> Any:
    """Dictionaries, lists, numbers and arrays of a ``.pkl``, or of a ``.npy`` that holds one object.

    Raises UserError when the file is cut short or asks for anything but numpy arrays: a pickle can run any program.
    """
    data = read_bytes(path)
    stream = io.BytesIO(data)
    if data.startswith(b"\x93NUMPY"):
        version = np.lib.format.read_magic(stream)
        header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        header(stream)
    try:
        value = _ArraysOnly(stream).load()
    except (pickle.UnpicklingError, EOFError, MemoryError, *_BROKEN) as error:
        raise UserError(
            f"{path} is not a plain table of arrays ({error}); it may be cut short, or "
            "made to run a program: it was not opened"
        ) from None
    return value.item() if isinstance(value, np.ndarray) and value.dtype == object and value.size == 1 else value
