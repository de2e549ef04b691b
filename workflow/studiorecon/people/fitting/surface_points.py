# SPDX-License-Identifier: Apache-2.0
"""Surface points of one person from a network's bodies in every camera (paper: the vertex term; U33).

Vertices are not detected: these are projections of monocular bodies, a prior on which cameras agree by chance or not.
They are triangulated as keypoints are, and the fit weighs all of them together at most as much as the keypoints.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.body.fitting.fit import SurfacePoints
from studiorecon.body.model import BodyModel
from studiorecon.people.fitting.points import Triangulation, triangulate_keypoints
from studiorecon.progress import say
from studiorecon.scene.camera import Camera
from studiorecon.scene.people import Detections

if TYPE_CHECKING:
    from jaxtyping import Float, Integer

# Points that are triangulated at once: those of a minute's take would fill gigabytes.
_AT_ONCE = 500_000


def triangulate_surface(
    person: str,
    detections: Sequence[Detections],
    identities: Mapping[tuple[str, int], str],
    cameras: Sequence[Camera],
    body: BodyModel,
    frames: int,
    settings: Triangulation,
    unverified_sigma_m: float,
    count: int,
) -> SurfacePoints | None:
    """Triangulated points of the skin from networks' bodies; None without bodies, or for another shape space than
    theirs.

    ``cameras`` belong to the ``detections``. Shapes of SMPL mean nothing in another body's shape space. ``count``
    vertices represent all; 0 = all of them.
    """
    seen = [
        d.body_pose is not None and d.body_root is not None and d.body_shape is not None and d.pelvis is not None
        for d in detections
    ]
    if sum(seen) < 2:
        return None
    if not body.identity.startswith("smpl"):
        say(
            f"{person}: the network's bodies are SMPL's, this scene's are {body.identity}: "
            "only their joints count, not their surfaces"
        )
        return None
    among = body.proxy_vertices
    vertices = among[np.linspace(0, len(among) - 1, min(count or len(among), len(among))).astype(int)]
    chosen = [surest_detections(person, d, identities, frames) if own else {} for d, own in zip(detections, seen)]
    at_once, points_m, sigma_m = max(1, _AT_ONCE // len(vertices)), [], []
    for first in range(0, frames, at_once):
        span = range(first, min(first + at_once, frames))
        pixels = np.full((len(detections), len(span), len(vertices), 3), np.nan)
        pixels[..., 2] = 0.0
        for view, (found, camera, mine) in enumerate(zip(detections, cameras, chosen)):
            for frame in mine.keys() & set(span):
                d, sure = mine[frame]
                pixels[view, frame - first] = np.column_stack(
                    [skin_px(found, d, camera, body, vertices), np.full(len(vertices), sure)]
                )
        points = triangulate_keypoints([], pixels, list(cameras), settings, unverified_sigma_m)
        points_m.append(points.points_m)
        sigma_m.append(points.sigma_m)
    return SurfacePoints(vertices, np.concatenate(points_m), np.concatenate(sigma_m))


def surest_detections(
    person: str, found: Detections, identities: Mapping[tuple[str, int], str], frames: int
) -> dict[int, tuple[int, float]]:
    """Frame → the person's detection with the most confident keypoint, and that confidence; the first of equals."""
    surest: dict[int, tuple[int, float]] = {}
    assert found.pelvis is not None
    for d in range(len(found.frame)):
        frame, sure = int(found.frame[d]), float(found.keypoints[d, :, 2].max(initial=0.0))
        mine = identities.get((found.camera, int(found.track[d])), "") == person and 0 <= frame < frames
        if mine and sure > surest.get(frame, (-1, 0.0))[1] and np.isfinite(found.pelvis[d]).all():
            surest[frame] = d, sure
    return surest


def skin_px(
    found: Detections, detection: int, camera: Camera, body: BodyModel, vertices: Integer[np.ndarray, " S"]
) -> Float[np.ndarray, "S 2"]:
    """Pixels of ``vertices`` of a network's body for one ``detection``; NaN for those behind the camera."""
    assert found.body_root is not None
    assert found.body_pose is not None
    assert found.pelvis is not None
    assert found.body_shape is not None
    pose = np.concatenate([found.body_root[detection][None], found.body_pose[detection]]).reshape(1, 72)
    own = replace(camera, camera_from_world=np.eye(4))
    pelvis_m = own.unproject(found.pelvis[detection, :2], found.pelvis[detection, 2])
    return own.project(body.vertices(pose, found.body_shape[detection][: body.shapes], pelvis_m[None], vertices)[0])[0]
