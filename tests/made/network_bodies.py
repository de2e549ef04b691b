# SPDX-License-Identifier: Apache-2.0
"""People as a network of bodies sees them in every camera by itself, planted: each picture wrong in its own way."""

from __future__ import annotations

import numpy as np
from studiorecon.body.model import BodyModel
from studiorecon.geometry import rotations
from studiorecon.keypoints.layouts import LAYOUTS
from studiorecon.scene.camera import Camera
from studiorecon.scene.people import Detections

# The network's own error per picture: degrees per joint, deviations of the shape.
TURN_DEG, SHAPE = 4.0, 0.3
# What is left of the keypoints: the trunk, without arms and lower legs.
FEW = tuple(
    f"{n}_joint"
    for n in ("pelvis", "neck", "left_hip", "right_hip", "left_knee", "right_knee", "left_shoulder", "right_shoulder")
)


def seen_by_a_network(
    body: BodyModel, truth: tuple[np.ndarray, np.ndarray, np.ndarray], cameras: list[Camera], depth_off: float = 0.0
) -> list[Detections]:
    """What a network says in every camera of poses (T, 72), betas and places (T, 3): true keypoints but few, and a body
    that is off anew in every picture, its depth by ``depth_off`` (a share of it, deviation)."""
    poses, betas, trans = truth
    frames = len(poses)
    rng, layout = np.random.default_rng(7), LAYOUTS["comotion27"]
    names = list(layout.keypoints)
    known = layout.among(body.keypoint_names)
    points = body.keypoints([names[k] for k in known], poses, betas, trans)
    made = []
    for camera in cameras:
        keypoints = np.full((frames, len(names), 3), np.nan)
        keypoints[..., 2] = 0.0
        pixels, _ = camera.project(points)
        for k, name in enumerate(names[k] for k in known):
            if name in FEW:
                keypoints[:, known[k], :2] = pixels[:, k] + rng.normal(0, 0.5, (frames, 2))
                keypoints[:, known[k], 2] = 0.9
        turned = rotations.exp(poses.reshape(frames, 24, 3)) @ rotations.exp(
            np.radians(TURN_DEG) * rng.normal(size=(frames, 24, 3)) / 3**0.5
        )
        turned[:, 0] = camera.rotation_camera_from_world @ turned[:, 0]
        own = rotations.log(turned)
        pelvis, depth_m = camera.project(trans)
        wrong = np.random.default_rng(11 + len(made)).normal(size=frames)
        made.append(
            Detections(
                camera.name,
                "comotion27",
                np.arange(frames),
                np.zeros(frames, int),
                keypoints,
                own[:, 1:],
                np.column_stack([pelvis, depth_m * (1 + depth_off * wrong)]),
                own[:, 0],
                betas + SHAPE * rng.normal(size=(frames, body.shapes)),
            )
        )
    return made
