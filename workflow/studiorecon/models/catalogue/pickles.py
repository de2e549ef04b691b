# SPDX-License-Identifier: Apache-2.0
"""Reads pickles of arrays, and runs none of their code except numpy's and scipy's constructors.

Body models are published as such files, some with arrays of chumpy, whose package no longer imports.
"""

from __future__ import annotations

import importlib
import io
import pickle
import zipfile
from collections.abc import Iterable
from pathlib import Path
from typing import IO, Any

import numpy as np

from studiorecon.models.catalogue.checksums import other_file
from studiorecon.scene.user_files import refuse_pickle_bomb

# The only names that a pickle may use, by the last part of their module: constructors of arrays and of empty objects.
_ALLOWED = {
    "numpy": {"ndarray", "dtype"},
    "multiarray": {"_reconstruct", "scalar"},
    "numeric": {"_frombuffer"},
    "_codecs": {"encode"},
    "copyreg": {"_reconstructor"},
    "builtins": {"object"},
}
_SPARSE = {"csc_matrix", "csr_matrix", "coo_matrix"}


class Chumpy:
    """Replaces any chumpy object: keeps its state, of which ``x`` is the array."""

    def __setstate__(self, state: Any) -> None:
        self.__dict__.update(state if isinstance(state, dict) else {"x": state})


class _Arrays(pickle.Unpickler):
    def find_class(self, module: str, name: str) -> Any:
        if module.split(".")[0] == "chumpy":
            return Chumpy
        if module.startswith("scipy.sparse") and name in _SPARSE:
            return getattr(importlib.import_module("scipy.sparse"), name)
        # Python 3 renamed modules of Python 2, and numpy 2 those of numpy 1.
        module = {"copy_reg": "copyreg", "__builtin__": "builtins"}.get(module, module)
        if name not in _ALLOWED.get(module.split(".")[-1], set()):
            raise pickle.UnpicklingError(f"it asks for {module}.{name}")
        if module.startswith("numpy.core") and np.lib.NumpyVersion(np.__version__) >= "2.0.0":
            module = module.replace("numpy.core", "numpy._core")
        return getattr(importlib.import_module(module), name)


def read_arrays(stream: IO[bytes]) -> Any:
    """The contents of a pickle; raises UnpicklingError unless it holds arrays only, or any error of foreign bytes."""
    data = stream.read()
    refuse_pickle_bomb(data)
    return _Arrays(io.BytesIO(data), encoding="latin1").load()


def require_safe_pickles(paths: Iterable[Path]) -> None:
    """Raises UserError for the first of these .pkl and .npz files that would run code when it is unpickled."""
    for path in paths:
        try:
            if path.suffix == ".npz":
                with zipfile.ZipFile(path) as members:
                    for name in members.namelist():
                        with members.open(name) as stream:
                            _vetted_array(stream)
            else:
                with open(path, "rb") as stream:
                    read_arrays(stream)
        except Exception as error:  # unpickling foreign bytes can raise any error
            what = f"{type(error).__name__}: {error}"
            raise other_file(path, f"is no file of plain or chumpy arrays ({what}), and would be unpickled") from None


def _vetted_array(stream: IO[bytes]) -> None:
    """Checks the pickle in a member of an .npz, which numpy writes for arrays of objects only."""
    version = np.lib.format.read_magic(stream)
    header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    if header(stream)[2].hasobject:
        read_arrays(stream)
