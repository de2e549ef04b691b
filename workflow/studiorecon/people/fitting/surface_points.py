# SPDX-License-Identifier: Apache-2.0
"""Surface points of one person from the bodies that a network saw in every camera (paper: the vertex term;
U33).

Nobody detects vertices: these are projections of monocular bodies, a prior that all cameras happen to agree on or not.
They are triangulated as keypoints are, and the fit lets all of them together count for at most as much as the
keypoints.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from studiorecon.body.fitting.fit import SurfacePoints
from studiorecon.body.model import BodyModel
from studiorecon.people.fitting.points import Triangulation, lift
from studiorecon.progress import say
from studiorecon.scene.camera import Camera
from studiorecon.scene.people import Detections

# Vertices that stand for the whole surface.
_POINTS = 100


def surface_of(
    person: str,
    detections: Sequence[Detections],
    identities: Mapping[tuple[str, int], str],
    cameras: Sequence[Camera],
    body: BodyModel,
    frames: int,
    settings: Triangulation,
    unverified_sigma_m: float,
) -> SurfacePoints | None:
    """Triangulated points of the skin, where networks brought bodies; None where they did not, or for another shape
    space than theirs.

    ``cameras`` belong to the ``detections``. Shapes of SMPL mean nothing in another body's shape space.
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
    vertices = body.proxy_vertices[
        np.linspace(0, len(body.proxy_vertices) - 1, min(_POINTS, len(body.proxy_vertices))).astype(int)
    ]
    pixels = np.full((len(detections), frames, len(vertices), 3), np.nan)
    pixels[..., 2] = 0.0
    for view, (found, camera) in enumerate(zip(detections, cameras)):
        if not seen[view]:
            continue
        for d in range(len(found.frame)):
            frame, sure = int(found.frame[d]), float(found.keypoints[d, :, 2].max(initial=0.0))
            assert found.pelvis is not None
            mine = identities.get((found.camera, int(found.track[d])), "") == person and 0 <= frame < frames
            if mine and sure > pixels[view, frame, :, 2].max() and np.isfinite(found.pelvis[d]).all():
                pixels[view, frame] = np.column_stack(
                    [skin_px(found, d, camera, body, vertices), np.full(len(vertices), sure)]
                )
    points = lift([], pixels, list(cameras), settings, unverified_sigma_m)
    return SurfacePoints(vertices, points.points_m, points.sigma_m)


def skin_px(found: Detections, detection: int, camera: Camera, body: BodyModel, vertices: np.ndarray) -> np.ndarray:
    """(S, 2) pixels of some ``vertices`` (S,) of the body that a network saw as one ``detection``; NaN for those behind
    the camera."""
    assert found.body_root is not None
    assert found.body_pose is not None
    assert found.pelvis is not None
    assert found.body_shape is not None
    pose = np.concatenate([found.body_root[detection][None], found.body_pose[detection]]).reshape(1, 72)
    own = replace(camera, camera_from_world=np.eye(4))
    pelvis_m = own.unproject(found.pelvis[detection, :2], found.pelvis[detection, 2])
    return own.project(body.vertices(pose, found.body_shape[detection][: body.shapes], pelvis_m[None], vertices)[0])[0]
