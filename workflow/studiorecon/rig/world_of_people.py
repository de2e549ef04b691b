# SPDX-License-Identifier: Apache-2.0
"""The world of cameras that were estimated from people: metres, up and the floor."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.errors import UserError
from studiorecon.rig.estimate import RigEstimate
from studiorecon.rig.from_tracks import bone_factor, scale_camera
from studiorecon.rig.gravity import world_from_people
from studiorecon.rig.metric_scale import GivenLengths, Scale, scale_from_lengths
from studiorecon.scene.camera import Camera

if TYPE_CHECKING:
    from jaxtyping import Num

# Sigma of adults' sizes, as a share.
_OF_A_MEAN_BODY = 0.05


def align_to_people(
    found: RigEstimate, template_m: Num[np.ndarray, "12 3"], given: GivenLengths, stature: float
) -> tuple[list[Camera], str, Scale]:
    """The cameras of ``found`` in metres, z up, the floor at 0; how up was found, and the scale.

    ``template_m``: (12, 3) stable keypoints of the mean body, ``stature`` its height in metres. Raises UserError where
    nobody is visible from ankles to shoulders, and for ``given`` lengths as ``scale_from_lengths`` does.
    """
    rig, points = found.rig, found.points_m
    by_bones = Scale(
        bone_factor(points, rig.points, rig.seen, template_m) or 1.0,
        _OF_A_MEAN_BODY,
        "lengths come from the bones of a mean body and may be 5 % off; write a measured one into capture.yaml: "
        "height_m: {p0: 1.78}, or distance_m: [CAMERA, CAMERA, METRES]",
    )

    def upright(scale: Scale) -> tuple[np.ndarray, str]:
        seen = rig.seen
        world = world_from_people(points * scale.factor, seen.group, seen.frame, seen.keypoint, found.room_directions)
        if world is None:
            raise UserError(
                "no person is visible from ankles to shoulders, so the up direction is unknown; move "
                "the cameras back, or bring a calibration"
            )
        return world

    # The order of p0, p1, … depends on people's positions in the world that association will use.
    turned = points @ upright(by_bones)[0][:3, :3].T
    measured = scale_from_lengths(given, found.cameras, turned, rig.points, rig.seen, template_m, stature)
    scale = measured or by_bones
    world_from_rig, how = upright(scale)
    cameras = []
    for camera in found.cameras:
        pose = scale_camera(camera, scale.factor).camera_from_world @ np.linalg.inv(world_from_rig)
        cameras.append(replace(camera, camera_from_world=pose))
    return cameras, how, scale
