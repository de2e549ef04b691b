# SPDX-License-Identifier: Apache-2.0
"""Iterative refinement (paper, appendix C): half-way, views of the room as it is now are enhanced and become targets
themselves.

The camera rises and falls twice on its way round the room, or along the synthesized views, which shows what none of
those shows: floors and ceilings at other angles. The room is drawn without people, so nothing has to be masked.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

import numpy as np

from studiorecon.configuration.setting import setting
from studiorecon.errors import UserError
from studiorecon.geometry.camera_path import azimuths_rad, look_at, order_around, scene_centre, with_pose
from studiorecon.geometry.rotations import slerp
from studiorecon.images.transfer import ResidualSource, Transfer, carried_over, source
from studiorecon.scene.camera import Camera
from studiorecon.splatting.rendering import Rendering
from studiorecon.splatting.train.targets import Target

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

_PERIODS = 2
# A pixel that is less than this covered shows a hole, and a hole is nothing to learn from.
_SOLID = 0.95


@dataclass(frozen=True)
class Refinement:
    """How the room is looked at half-way.

    Attributes:
        at: share of the iterations after which they are drawn.
        height: how far the camera rises and falls, as a share of its distance from the middle of the scene.
        weight: of these views' pixels beside the photos'.
        ring_deg: the real cameras form a ring when no gap between neighbours is wider.
        transfer: how the photos' residuals are carried over.
    """

    views: int = setting(
        0,
        "Views of the half-trained room that are enhanced and learned from; 0 = none.",
        minimum=0,
        maximum=10000,
        paper="240, appendix C",
        letter=240,
    )
    at: float = 0.5
    height: float = 0.15
    weight: float = 0.7
    ring_deg: float = 150.0
    transfer: Transfer = Transfer()
    path: Literal["ring", "views"] = setting(
        "ring",
        "Where these views look from: ring = around the scene at the cameras' median distance, at its middle; views = "
        "between the poses of the synthesized views, in their order.",
        paper="interpolated between the synthesized poses, appendix on the augmented camera trajectory; U53",
        letter="views",
    )
    module: Literal["enhancer", "recursive"] = setting(
        "enhancer",
        "What repairs them where enhance.enhancer is a network: enhancer = it alone, view by view; recursive = with "
        "what became of the views before injected, as films are made (enhance.injection, enhance.flow).",
        paper="the recursive module, section Iterative Refinement, whose network is Difix3D+, appendix C",
        letter="recursive",
    )


def looked_at_from(cameras: Sequence[Camera], views: Sequence[Camera], settings: Refinement) -> list[Camera]:
    """The cameras of the refinement, as ``path`` says: around the real ``cameras``, or between the poses of the
    synthesized ``views``, in flying order. UserError when there are none to go between."""
    if settings.path == "ring":
        return refinement_cameras(cameras, settings)
    if len(views) < 2:
        raise UserError(
            f"background.refinement.path is views, but there are {len(views)} of them to look between: force "
            "view_synthesis on (survey.force), or set the path to ring"
        )
    return cameras_between(views, _radius_m(cameras), settings)


def cameras_between(views: Sequence[Camera], radius_m: float, settings: Refinement) -> list[Camera]:
    """Cameras evenly along the ``views``, two or more: turned by slerp and moved straight between neighbours, rising
    and falling by ``height`` of the scene's radius, and pitched by −atan(rise / radius) to make up for it (U53)."""
    apart = [np.abs(a.camera_from_world - b.camera_from_world).max() > 1e-9 for a, b in itertools.pairwise(views)]
    distinct = [views[0], *(view for view, moved in zip(views[1:], apart) if moved)]
    distinct = distinct if len(distinct) > 1 else [views[0], views[0]]
    made = []
    for at in np.linspace(0, len(distinct) - 1, settings.views):
        low = min(int(at), len(distinct) - 2)
        one, other, share = distinct[low], distinct[low + 1], at - low
        turned = slerp(one.world_from_camera[:3, :3], other.world_from_camera[:3, :3], np.array([share]))
        rise_m = settings.height * radius_m * np.sin(2 * np.pi * _PERIODS * at / (len(distinct) - 1))
        down = np.arctan2(rise_m, radius_m)
        # About the camera's own x, to the right: what has risen looks down.
        pitch = np.array([[1, 0, 0], [0, np.cos(down), np.sin(down)], [0, -np.sin(down), np.cos(down)]])
        eye_m = (1 - share) * one.centre_m + share * other.centre_m + [0, 0, rise_m]
        lens = (1 - share) * one.intrinsics + share * other.resized(one.wh).intrinsics
        made.append(with_pose(replace(one, intrinsics=lens), np.asarray(turned).reshape(3, 3) @ pitch, eye_m))
    return made


def _radius_m(cameras: Sequence[Camera]) -> float:
    """Median horizontal distance of the cameras from the middle of the scene."""
    offsets = np.stack([c.centre_m for c in cameras]) - scene_centre(cameras)
    return float(np.median(np.linalg.norm(offsets[:, :2], axis=1)))


def refinement_cameras(cameras: Sequence[Camera], settings: Refinement) -> list[Camera]:
    """Cameras along the ring of the real ones, at their median distance, rising and falling twice (U53).

    Looking at the middle from everywhere is what compensates the pitch: −atan(h / r). Where the real cameras are no
    ring, the views stay on their arc.
    """
    centre_m = scene_centre(cameras)
    offsets = np.stack([c.centre_m - centre_m for c in cameras])
    radius_m = float(np.median(np.linalg.norm(offsets[:, :2], axis=1)))
    level_m = float(np.median(offsets[:, 2]))
    order, gap = order_around(cameras, centre_m, closed=False)
    azimuth = azimuths_rad(cameras, centre_m)
    begin, reach = azimuth[order[0]], 2 * np.pi - gap
    ring = gap <= np.radians(settings.ring_deg)
    done = np.arange(settings.views) / settings.views if ring else np.linspace(0, 1, settings.views)
    around = begin + done * (2 * np.pi if ring else reach)
    rise_m = settings.height * radius_m * np.sin(2 * np.pi * _PERIODS * done)
    nearest = [int(np.argmin(np.abs(np.angle(np.exp(1j * (azimuth - a)))))) for a in around]
    made = []
    for angle, up_m, near in zip(around, rise_m, nearest):
        eye_m = centre_m + np.array([radius_m * np.cos(angle), radius_m * np.sin(angle), level_m + up_m])
        made.append(with_pose(cameras[near], look_at(eye_m, centre_m), eye_m))
    return made


def refined_targets(
    cameras: Sequence[Camera],
    photos: Sequence[tuple[Camera, Float[np.ndarray, "H W 3"], Bool[np.ndarray, "H W"]]],
    settings: Refinement,
    draw: Callable[[Camera], Rendering],
) -> tuple[list[Target], float]:
    """A target per camera: the room as ``draw`` shows it, plus what it misses at the ``photos`` (camera, rgb, known)
    that see it too.

    Pixels that no photo sees, and holes, weigh nothing: there the picture could only teach what it already shows. Also
    the share of pixels that do weigh.
    """
    sources: list[ResidualSource] = []
    for camera, rgb, known in photos:
        shown = draw(camera)
        render = np.clip(shown.rgb, 0, 1) * np.float32(255)
        # As the picture shows itself where nothing is known: a residual of nothing, and no surface to carry it from.
        photo = np.where(known[..., None], rgb * np.float32(255), render)
        sources.append(source(camera, photo, render, np.where(known, shown.depth_m, 0), settings.transfer))
    targets, counted = [], 0.0
    for camera in cameras:
        shown = draw(camera)
        residual, cover = carried_over(camera, shown.depth_m, sources, settings.transfer)
        weight = np.where(shown.alpha >= _SOLID, settings.weight * np.minimum(cover, 1), 0).astype(np.float32)
        counted += float((weight > 0).mean())
        targets.append(
            Target(
                camera, np.clip(shown.rgb + np.minimum(cover, 1)[..., None] * residual, 0, 1).astype(np.float32), weight
            )
        )
    return targets, counted / max(len(targets), 1)
