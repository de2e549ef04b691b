# SPDX-License-Identifier: Apache-2.0
"""The provenance of every Gaussian; the truth map of every film is rendered from these marks."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from studiorecon.scene.files import write_npz
from studiorecon.scene.schema import Numbers, whole
from studiorecon.scene.step_files import read

if TYPE_CHECKING:
    from jaxtyping import Integer

MEASURED = 0
"""A training camera saw it."""
INFERRED = 1
"""Not seen itself, but its place or colour follows from seen parts: a default wall, the mirror image of an arm."""
INVENTED = 2
"""Painted in so that there is no hole."""


def provenance_schema(shape: str) -> Numbers:
    """The schema of an array of marks."""
    return whole(shape, low=MEASURED, high=INVENTED)


def write_provenance(path: Path, marks: Integer[np.ndarray, " N"]) -> None:
    """Write the marks of a PLY's Gaussians, in its order."""
    write_npz(path, {"provenance": marks})


def read_provenance(path: Path, count: int) -> Integer[np.ndarray, " N"]:
    """Marks of ``count`` Gaussians; raises UserError as ``step_files.read`` does, also for another number of marks."""
    held: dict[str, Any] = read(path, {"provenance": provenance_schema("N")}, sizes={"N": count})
    return np.asarray(held["provenance"], np.uint8)
