# SPDX-License-Identifier: Apache-2.0
"""EgoHumans and Harmony4D: a COLMAP model with the similarity that makes it metric.

``colmap/workplace/{cameras,images}.txt`` with ``colmap_from_aria_transforms.pkl`` (glasses → 4×4 from their frame to
COLMAP's, scaled) or ``scale.npy`` (4×4 from COLMAP's frame to the metric one).
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from studiorecon.calibration.formats import colmap_files
from studiorecon.calibration.formats.pickles import read_pickle
from studiorecon.calibration.formats.reading import CalibrationFormat, Reading, merged_static
from studiorecon.camera_files.colmap_models import posed_pictures
from studiorecon.camera_files.raw_camera import RawCamera, camera_from_world_of_rows
from studiorecon.errors import UserError
from studiorecon.scene.user_files import read_npy

_ANCHOR = "aria01"
_SUFFIXES = (".pkl", ".npy")


def recognises(files: list[Path]) -> bool:
    model = [f for f in files if f.suffix not in _SUFFIXES]
    return len(files) - len(model) == 1 and colmap_files.recognises(model)


def read(files: list[Path]) -> Reading:
    """The static cameras in metres; the glasses' own cameras, which move, are left out.

    With X_colmap = S X_metric and S = [cR0 | t0], x = R1 X_colmap + t1 becomes R1 R0 X + (R1 t0 + t1) / c.
    """
    similarity_file = next(f for f in files if f.suffix in _SUFFIXES)
    model = [f for f in files if f.suffix not in _SUFFIXES]
    colmap_from_metric = _similarity(similarity_file)
    everything = posed_pictures(model)
    exo = [c for c in everything if not c.name.lower().startswith("aria")]
    notes: list[str] = []
    if len(exo) < len(everything):
        notes.append("the pictures of the glasses were left out: their cameras move")
    scale = float(np.linalg.norm(colmap_from_metric[:3, :3], axis=0).mean())
    notes.append(f"{similarity_file.name} makes the COLMAP model metric: one metre is {scale:.4g} of its units")
    metric = [_metric(c, colmap_from_metric, f"camera {c.name} in {model[0].parent}") for c in exo]
    return Reading("EgoHumans/Harmony4D", merged_static(metric, notes), "m", tuple(notes))


def _similarity(path: Path) -> np.ndarray:
    """(4, 4) from the metric frame to COLMAP's."""
    if path.suffix == ".npy":
        matrix = np.asarray(read_npy(path), dtype=np.float64)
        if matrix.shape != (4, 4) or abs(np.linalg.det(matrix)) < 1e-12:
            raise UserError(
                f"{path} is {matrix.shape}; it must hold the 4×4 transform from COLMAP's frame to the metric one"
            )
        return np.linalg.inv(matrix)
    table = read_pickle(path)
    if not isinstance(table, dict) or not table:
        raise UserError(f"{path} holds no table of glasses; it must map {_ANCHOR} to a 4×4 transform")
    if _ANCHOR not in table:
        raise UserError(
            f"{path} has no {_ANCHOR} (it has {', '.join(map(str, table))}); rename the "
            f"anchor of this sequence to {_ANCHOR}"
        )
    matrix = np.asarray(table[_ANCHOR], dtype=np.float64)
    return np.vstack([matrix[:3], [0, 0, 0, 1]])


def _metric(camera: RawCamera, colmap_from_metric: np.ndarray, where: str) -> RawCamera:
    pose = camera.camera_from_world @ colmap_from_metric
    return replace(camera, camera_from_world=camera_from_world_of_rows(pose, where)[0])


FORMAT = CalibrationFormat(
    "egohumans",
    "EgoHumans, Harmony4D",
    "`colmap/workplace`",
    tuple(
        ("colmap/workplace/cameras.txt", "colmap/workplace/images.txt", f"colmap/workplace/{similarity}")
        for similarity in ("scale.npy", "colmap_from_aria_transforms.pkl")
    ),
    recognises,
    read,
)
