# SPDX-License-Identifier: Apache-2.0
"""Iterative refinement (paper, appendix C): half-way, a network repairs views of the room, which then become targets.

The camera rises and falls twice on its way along the synthesized views, which shows floors and ceilings at new angles.
The room is drawn without people, so nothing has to be masked.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from studiorecon.configuration.setting import setting
from studiorecon.errors import UserError
from studiorecon.geometry.camera_path import scene_centre, with_pose
from studiorecon.geometry.rotations import slerp
from studiorecon.scene.camera import Camera


@dataclass(frozen=True)
class Refinement:
    """Views of the half-trained room.

    Attributes:
        at: share of the iterations after which they are drawn.
        height: how far the camera rises and falls, as a share of its distance from the middle of the scene.
        weight: of these views' pixels relative to the photos'.
    """

    views: int = setting(
        0,
        "Views of the half-trained room that enhance.enhancer's network repairs and training then uses; 0 = none.",
        minimum=0,
        maximum=10000,
        paper="240, appendix C; U53",
        paper_value=240,
    )
    at: float = 0.5
    height: float = 0.15
    weight: float = 0.7


def refinement_cameras(cameras: Sequence[Camera], views: Sequence[Camera], settings: Refinement) -> list[Camera]:
    """Cameras evenly along the synthesized ``views``: rotated by slerp and moved straight between neighbours.

    They rise and fall by ``height`` of the radius of the scene's ``cameras``, and are pitched by −atan(rise / radius)
    in compensation (U53). Raises UserError with fewer than two views.
    """
    if len(views) < 2:
        raise UserError(
            f"background.refinement.views needs at least two synthesized views, and there are {len(views)}: force "
            "view_synthesis on (survey.force), or set it to 0"
        )
    radius_m = _radius_m(cameras)
    apart = [np.abs(a.camera_from_world - b.camera_from_world).max() > 1e-9 for a, b in itertools.pairwise(views)]
    distinct = [views[0], *(view for view, moved in zip(views[1:], apart) if moved)]
    distinct = distinct if len(distinct) > 1 else [views[0], views[0]]
    made = []
    for at in np.linspace(0, len(distinct) - 1, settings.views):
        low = min(int(at), len(distinct) - 2)
        one, other, share = distinct[low], distinct[low + 1], at - low
        turned = slerp(one.world_from_camera[:3, :3], other.world_from_camera[:3, :3], np.array([share]))
        rise_m = settings.height * radius_m * np.sin(2 * np.pi * 2 * at / (len(distinct) - 1))
        down = np.arctan2(rise_m, radius_m)
        # About the camera's own x, to the right: raised cameras pitch down.
        pitch = np.array([[1, 0, 0], [0, np.cos(down), np.sin(down)], [0, -np.sin(down), np.cos(down)]])
        eye_m = (1 - share) * one.centre_m + share * other.centre_m + [0, 0, rise_m]
        lens = (1 - share) * one.intrinsics + share * other.resized(one.wh).intrinsics
        made.append(with_pose(replace(one, intrinsics=lens), np.asarray(turned).reshape(3, 3) @ pitch, eye_m))
    return made


def _radius_m(cameras: Sequence[Camera]) -> float:
    """Median horizontal distance of the cameras from the middle of the scene."""
    offsets = np.stack([c.centre_m for c in cameras]) - scene_centre(cameras)
    return float(np.median(np.linalg.norm(offsets[:, :2], axis=1)))
