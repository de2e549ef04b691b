# SPDX-License-Identifier: Apache-2.0
"""The first pass of one camera: the plane of the whole catalogue that best explains each pixel.

Writes ``depth/<camera>.sweep.npz``: planes (L, 4) and the (H, W) index of each pixel's plane, its cost, whether the
pixel is confident, and values common to the scene: floor height, wall yaw, exposure gains.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.camera_files.colmap import camera_named, read_model
from studiorecon.configuration.setting import setting
from studiorecon.depth.layout.yaw import match_yaw
from studiorecon.depth.stereo.labelling import label_planes
from studiorecon.depth.stereo.matching import UNKNOWN
from studiorecon.depth.stereo.planes import plane_hypotheses, rig_centre, wall_yaw
from studiorecon.depth.stereo.plates import Picture, best_score, equalise_exposure, floor_and_gains, read_pictures
from studiorecon.depth.sweep_settings import FirstLook, Matching
from studiorecon.progress import progress, say
from studiorecon.scene.files import write_npz
from studiorecon.signature import Written

if TYPE_CHECKING:
    from jaxtyping import Float

# Cost of a plane where no other camera can judge it, or out of range.
UNJUDGED = 0.75
IMPOSSIBLE = 2.0
# A pixel votes for its plane when the plane's cost is below this.
CONFIDENT = 0.35
# Least share of line length that must agree on a yaw; evenly spread lines give 0.03.
_MIN_YAW_SUPPORT = 0.12


@dataclass(frozen=True)
class Settings(Matching, FirstLook):
    """The planes: up to ``furniture_m``, in the range ``ceiling_m``, and walls up to ``reach_m`` from the centre.

    ``sweep_penalty`` is the cost of a change of plane between neighbouring pixels.
    """

    horizontal_step_m: float = setting(
        0.04,
        "Step between horizontal planes up to table height; twice that near the ceiling.",
        unit="m",
        above=0,
    )
    wall_step_m: float = setting(
        0.06,
        "Step between walls near the cameras; grows with the square of the distance beyond 4.5 m.",
        unit="m",
        above=0,
    )
    furniture_m: float = 1.3
    ceiling_m: tuple[float, float] = (2.2, 3.2)
    reach_m: float = 10.0
    sweep_penalty: float = 0.6


def best_costs(
    pictures: list[Picture], index: int, planes: Float[np.ndarray, "L 4"], settings: Settings
) -> Float[np.ndarray, "H W L"]:
    """Float32 cost of every plane in one picture: 1 - agreement with the camera that agrees best."""
    picture = pictures[index]
    cost = np.full((*picture.known.shape, len(planes)), IMPOSSIBLE, np.float32)
    for k, plane in enumerate(progress(planes, f"planes seen by {picture.camera.name}")):
        seen = picture.depth(plane, settings) > 0
        best = best_score(pictures, index, plane, settings)
        cost[..., k] = np.where(seen, np.where(best > UNKNOWN, np.clip(1 - best, 0, 1.2), UNJUDGED), IMPOSSIBLE)
    return cost


def run(settings: Settings, camera: str, model: Path, plates: list[Path], sweep: Written) -> None:
    """Sweep the planes through one camera's plate and write its votes."""
    cameras = read_model(model.parent)
    names = [c.name for c in cameras]
    camera_named(cameras, camera, model)
    pictures = read_pictures(cameras, plates, settings.sweep_width)
    floor_m, gains, pairs = floor_and_gains(pictures, settings)
    pictures = equalise_exposure(pictures, gains)
    index = names.index(camera)
    say(
        f"exposure of {camera} is {gains[index].mean():.3f} of the rig's mean, from {pairs} "
        f"views of the floor at z = {floor_m:.2f} m"
    )
    yaw_rad, support = wall_yaw([p.camera for p in pictures], [p.rgb for p in pictures], [p.known for p in pictures])
    if support < _MIN_YAW_SUPPORT:
        yaw_rad = match_yaw(pictures, floor_m, settings.reach_m, settings)
        say(
            f"straight lines have no common direction (support {support:.2f}): walls at {np.degrees(yaw_rad):.0f}° and "
            "perpendicular to it match best"
        )
    else:
        say(f"straight lines run at {np.degrees(yaw_rad):.1f}° and perpendicular to it (support {support:.2f})")
    planes = plane_hypotheses(
        rig_centre(cameras),
        yaw_rad,
        floor_m,
        horizontal_step_m=settings.horizontal_step_m,
        wall_step_m=settings.wall_step_m,
        furniture_m=settings.furniture_m,
        ceiling_m=settings.ceiling_m,
        reach_m=settings.reach_m,
    )
    cost = best_costs(pictures, index, planes, settings)
    chosen = label_planes(cost, pictures[index].rgb, settings.sweep_penalty)
    chosen_cost = np.take_along_axis(cost, chosen[..., None], axis=-1)[..., 0]
    confident = (chosen_cost < CONFIDENT) & pictures[index].known & pictures[index].textured(settings.window)
    say(f"{camera}: {confident.mean():.0%} of the pixels match one of {len(planes)} planes")
    write_npz(
        sweep,
        {
            "planes": planes,
            "chosen": chosen.astype(np.int16),
            "cost": chosen_cost,
            "confident": confident,
            "floor_m": floor_m,
            "yaw_rad": yaw_rad,
            "gains": gains,
        },
    )
