# SPDX-License-Identifier: Apache-2.0
"""``models.smpl``: SMPL's own pickle as an .npz of plain arrays, which every step reads; nothing of chumpy or of smplx is needed for it.

The pickle of SMPL v1.1.0 holds chumpy arrays, whose package no longer imports, and 300 shape directions of which the first ten are kept.
It is read without running any of its code but numpy's and scipy's constructors.
"""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any

import numpy as np

from studiorecon.errors import Refusal
from studiorecon.progress import say
from studiorecon.scene.files import write_npz

JOINTS, SHAPES = 24, 10
_ARRAYS = ("v_template", "shapedirs", "posedirs", "J_regressor", "weights", "kintree_table", "f")
# The only names a body's pickle may ask for, by the last part of their module: constructors of arrays and of empty objects.
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
    """Stands for any chumpy object: keeps its state, of which ``x`` is the array."""

    def __setstate__(self, state: Any) -> None:
        self.__dict__.update(state if isinstance(state, dict) else {"x": state})


def read_pickle(path: Path) -> dict[str, Any]:
    """The entries of a body's pickle; Refusal when it is none, or asks for anything but arrays."""
    import pickle

    class Arrays(pickle.Unpickler):
        def find_class(self, module: str, name: str) -> Any:
            if module.split(".")[0] == "chumpy":
                return Chumpy
            if module.startswith("scipy.sparse") and name in _SPARSE:
                return getattr(importlib.import_module("scipy.sparse"), name)
            # Names of Python 2 have moved, and so has what numpy 1 wrote.
            module = {"copy_reg": "copyreg", "__builtin__": "builtins"}.get(module, module)
            if name not in _ALLOWED.get(module.split(".")[-1], set()):
                raise pickle.UnpicklingError(f"it asks for {module}.{name}")
            if module.startswith("numpy.core") and np.lib.NumpyVersion(np.__version__) >= "2.0.0":
                module = module.replace("numpy.core", "numpy._core")
            return getattr(importlib.import_module(module), name)

    try:
        with open(path, "rb") as stream:
            return dict(Arrays(stream, encoding="latin1").load())
    except FileNotFoundError:
        raise Refusal(f"body {path} is missing; SMPL is to be had by registration with MPI, resources/body.npz is bundled") from None
    except Exception as error:  # unpickling foreign bytes raises anything
        raise Refusal(f"body {path} is not a pickle of plain or chumpy arrays ({type(error).__name__}: {error})") from None


def post(entries: dict[str, Any], path: Path) -> dict[str, np.ndarray]:
    """The arrays of an SMPL .npz from a pickle's entries, ten shape directions, the joint regressor dense; Refusal for another body."""
    missing = [name for name in _ARRAYS if name not in entries]
    if missing:
        raise Refusal(f"body {path} has no {', '.join(missing)}: it is not SMPL's")
    arrays = {name: _plain(entries[name]) for name in _ARRAYS}
    vertices = len(arrays["v_template"])
    expected = {
        "v_template": (vertices, 3),
        "posedirs": (vertices, 3, 9 * (JOINTS - 1)),
        "J_regressor": (JOINTS, vertices),
        "weights": (vertices, JOINTS),
        "kintree_table": (2, JOINTS),
    }
    for name, shape in expected.items():
        if arrays[name].shape != shape:
            raise Refusal(
                f"{name} of body {path} has shape {arrays[name].shape}, expected {shape}: SMPL has {JOINTS} joints (SMPL-X is another)"
            )
    if arrays["shapedirs"].ndim != 3 or arrays["shapedirs"].shape[2] < SHAPES:
        raise Refusal(f"shapedirs of body {path} has shape {arrays['shapedirs'].shape}, expected ({vertices}, 3, {SHAPES} or more)")
    arrays["shapedirs"] = arrays["shapedirs"][..., :SHAPES]
    return arrays


def _plain(value: Any) -> np.ndarray:
    if isinstance(value, Chumpy):
        value = value.__dict__.get("x", value.__dict__.get("a"))
    return np.asarray(value.toarray() if hasattr(value, "toarray") else value)


def run(pickle: Path, body: Path) -> None:
    """Write ``body`` (npz) from SMPL's ``pickle``."""
    arrays = post(read_pickle(pickle), pickle)
    say(f"{pickle.name}: {len(arrays['v_template'])} vertices, {SHAPES} shape directions; terms: MPI non-commercial, never to be passed on")
    write_npz(body, arrays)
