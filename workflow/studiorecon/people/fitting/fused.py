# SPDX-License-Identifier: Apache-2.0
"""One person's body as every camera's network saw it by itself, averaged: the paper's ablation "without multi-view
refinement" (appendix, sensitivity to poses).

Nothing is triangulated and nothing fitted: what one picture says of a joint or of the pelvis's depth stays as wrong as
it is, but for the mean over cameras.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.body.model import BodyModel
from studiorecon.errors import UserError
from studiorecon.geometry import rotations
from studiorecon.people.fitting.surface_points import surest
from studiorecon.scene.camera import Camera
from studiorecon.scene.people import Detections

if TYPE_CHECKING:
    from jaxtyping import Float, Integer

_INSTEAD = "set people.fit.solver to levenberg_marquardt"


@dataclass(frozen=True)
class Fused:
    """The mean body of every frame.

    Attributes:
        local: (T, 24, 3, 3) rotations of the joints in their parents' axes, the root's in the world's.
        trans_m: (T, 3) pelvis in the world; ``betas``: (B,) mean shape of all pictures.
        sigma_m: (T, 24) how far the cameras' own joints lie from the mean's: standard error per coordinate.
        cameras: (T,) how many cameras saw the person; 0 = not measured.
    """

    local: Float[np.ndarray, "T 24 3 3"]
    trans_m: Float[np.ndarray, "T 3"]
    betas: Float[np.ndarray, " B"]
    sigma_m: Float[np.ndarray, "T 24"]
    cameras: Integer[np.ndarray, " T"]


def fused(
    person: str,
    detections: Sequence[Detections],
    identities: Mapping[tuple[str, int], str],
    cameras: Sequence[Camera],
    body: BodyModel,
    frames: int,
) -> Fused:
    """The mean over ``cameras`` (those of the ``detections``) of what a network saw of ``person`` in each.

    Frames that one camera alone sees have the deviation of those that several see. Raises UserError where no network
    brought bodies, where they are another body model's, or where no frame has two cameras.
    """
    if not body.identity.startswith("smpl"):
        raise UserError(
            f"person {person}: a network's bodies are SMPL's and this scene's body is {body.identity}; name SMPL's own "
            f"file as body, or {_INSTEAD}"
        )
    turns = np.full((len(cameras), frames, 24, 3, 3), np.nan)
    places_m, shapes = np.full((len(cameras), frames, 3), np.nan), []
    for view, (found, camera) in enumerate(zip(detections, cameras, strict=True)):
        if found.body_pose is None or found.body_root is None or found.body_shape is None or found.pelvis is None:
            continue
        for frame, (d, _) in surest(person, found, identities, frames).items():
            turns[view, frame] = rotations.exp(np.concatenate([found.body_root[d][None], found.body_pose[d]]))
            turns[view, frame, 0] = camera.rotation_camera_from_world.T @ turns[view, frame, 0]
            places_m[view, frame] = camera.unproject(found.pelvis[d, :2], found.pelvis[d, 2])
            shapes.append(found.body_shape[d][: body.shapes])
    seen = np.isfinite(places_m[..., 0])
    if not (seen.sum(0) >= 2).any():
        raise UserError(
            f"person {person}: no two cameras' networks bring a body of the same frame (frames 0–{frames - 1}), and "
            f"bodies are to be averaged; {_INSTEAD}"
        )
    betas = np.mean(shapes, axis=0)
    local, trans_m = np.tile(np.eye(3), (frames, 24, 1, 1)), np.zeros((frames, 3))
    sigma_m = np.full((frames, 24), np.nan)
    for frame in np.flatnonzero(seen.any(0)).tolist():
        own = turns[seen[:, frame], frame]
        local[frame] = rotations.mean(np.swapaxes(own, 0, 1))[0]
        trans_m[frame] = places_m[seen[:, frame], frame].mean(0)
        if len(own) > 1:
            poses = rotations.log(np.concatenate([own, local[frame][None]])).reshape(-1, 72)
            joints = body.joints(poses, betas, np.vstack([places_m[seen[:, frame], frame], trans_m[frame]]))
            squared = ((joints[:-1] - joints[-1]) ** 2).mean(-1).sum(0) / (len(own) - 1)
            sigma_m[frame] = np.sqrt(squared / len(own))
    usual = np.sqrt(np.nanmean(sigma_m**2, axis=0) * np.nanmean(seen.sum(0)[seen.sum(0) > 1]))
    return Fused(local, trans_m, betas, np.where(np.isnan(sigma_m), usual, sigma_m), seen.sum(0))
