# SPDX-License-Identifier: Apache-2.0
"""``models.smpl``: converts SMPL's own pickle to an .npz of plain arrays, without chumpy or smplx.

The pickle of SMPL v1.1.0 holds chumpy arrays, whose package no longer imports, and 300 shape directions, of which the
first ten are kept. Reading it runs none of its code except numpy's and scipy's constructors.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from studiorecon.errors import UserError
from studiorecon.models.catalogue.card import Card, Memory, Runtime, Terms, WeightFile
from studiorecon.models.catalogue.pickles import Chumpy, read_arrays
from studiorecon.progress import say
from studiorecon.scene.files import write_npz
from studiorecon.signature import Written

if TYPE_CHECKING:
    from jaxtyping import Shaped

CARD = Card(
    name="smpl",
    title="SMPL (smplx)",
    kind="body model",
    terms=Terms(
        code="MPI non-commercial",
        weights="MPI non-commercial, patented",
        commercial="no",
        condition="commercial licences through Meshcapade",
        alternative="the bundled body (setting body)",
    ),
    weights=(WeightFile("smpl/SMPL_NEUTRAL.pkl", "SMPL v1.1.0, by registration with MPI", how="hand", gated=True),),
    runtime=Runtime(image="comotion", python=">=3.10", torch=">=2.0", pins=("smplx==0.1.28",), commit="0.1.28"),
    memory=Memory(None, "runs on a CPU"),
    tried="random weights",
    unchecked="SMPL's file",
)
CARDS = (CARD,)


JOINTS, SHAPES = 24, 10
_ARRAYS = ("v_template", "shapedirs", "posedirs", "J_regressor", "weights", "kintree_table", "f")


def read_pickle(path: Path) -> dict[str, Any]:
    """The entries of a body's pickle; raises UserError unless it is a pickle of arrays only."""
    try:
        with open(path, "rb") as stream:
            return dict(read_arrays(stream))
    except FileNotFoundError:
        raise UserError(
            f"body {path} is missing; SMPL needs a registration with MPI; resources/body.npz is bundled"
        ) from None
    except Exception as error:  # unpickling foreign bytes can raise any error
        raise UserError(
            f"body {path} is not a pickle of plain or chumpy arrays ({type(error).__name__}: {error})"
        ) from None


def postprocess(entries: dict[str, Any], path: Path) -> dict[str, Shaped[np.ndarray, " ..."]]:
    """The arrays of an SMPL .npz from a pickle's entries, with ten shape directions and the joint regressor dense.

    Raises UserError for another body.
    """
    missing = [name for name in _ARRAYS if name not in entries]
    if missing:
        raise UserError(f"body {path} has no {', '.join(missing)}: it is not SMPL's")
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
            raise UserError(
                f"{name} of body {path} has shape {arrays[name].shape}, expected {shape}: SMPL "
                f"has {JOINTS} joints (SMPL-X is another)"
            )
    if arrays["shapedirs"].ndim != 3 or arrays["shapedirs"].shape[2] < SHAPES:
        raise UserError(
            f"shapedirs of body {path} has shape {arrays['shapedirs'].shape}, "
            f"expected ({vertices}, 3, {SHAPES} or more)"
        )
    arrays["shapedirs"] = arrays["shapedirs"][..., :SHAPES]
    return arrays


def _plain(value: Any) -> np.ndarray:
    if isinstance(value, Chumpy):
        value = value.__dict__.get("x", value.__dict__.get("a"))
    return np.asarray(value.toarray() if hasattr(value, "toarray") else value)


def run(pickle: Path, body: Written) -> None:
    """Write ``body`` (npz) from SMPL's ``pickle``."""
    arrays = postprocess(read_pickle(pickle), pickle)
    say(
        f"{pickle.name}: {len(arrays['v_template'])} vertices, {SHAPES} shape directions; "
        "terms: MPI non-commercial, never to be passed on"
    )
    write_npz(body, arrays)
