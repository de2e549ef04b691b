# SPDX-License-Identifier: Apache-2.0
"""An early film of the room before any training: the plates on the planes of the sweeps.

Writes ``depth/preview.mp4``: from camera to camera at the sweep's size, without people and without furniture that no
camera was confident of; unseen surfaces are grey. It is only for viewing; no step uses it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.camera_files.colmap import read_model
from studiorecon.depth.layout.votes import read_sweeps
from studiorecon.depth.stereo.plates import Picture, equalise_exposure, read_pictures
from studiorecon.depth.sweep_settings import FirstLook
from studiorecon.footage.video import to_bytes, write_watchable
from studiorecon.geometry.camera_path import LARGEST_GAP_RAD, gaps_around, interpolate_cameras, scene_centre
from studiorecon.progress import progress, say
from studiorecon.scene.camera import Camera
from studiorecon.scene.gaussians import Gaussians, concatenate
from studiorecon.scene.room import read_room
from studiorecon.signature import Written
from studiorecon.splatting.cpu.rasterise import Rasteriser
from studiorecon.splatting.seeds import finest_pixels, seeds_from_depth

if TYPE_CHECKING:
    from jaxtyping import Float, Integer

# Seconds of one round from the first camera, and pictures a second: walking speed.
_AROUND_S, _FPS = 8.0, 12
_SIZE, _OPACITY, _NEAR_M = 0.6, 0.95, 0.05
_UNSEEN_RGB = (0.5, 0.5, 0.5)


@dataclass(frozen=True)
class Settings(FirstLook):
    """The size of the film."""


def discs_from_depths(pictures: Sequence[Picture], depths_m: Sequence[Float[np.ndarray, "H W"]]) -> Gaussians:
    """A disc for every pixel whose picture has the highest resolution of its surface."""
    known = [p.known & (depth_m > 0) for p, depth_m in zip(pictures, depths_m)]
    wanted = finest_pixels([p.camera for p in pictures], depths_m, known)
    return concatenate(
        [
            seeds_from_depth(p.camera, p.rgb, own, depth_m, 1, _SIZE, _OPACITY, 0)[0]
            for p, depth_m, own in zip(pictures, depths_m, wanted)
        ]
    )


def preview_path(cameras: Sequence[Camera]) -> list[Camera]:
    """One round past every camera, or there and back if they are in an arc; a single camera stays.

    All pictures have the size of the first camera's, and the median lens of all.
    """
    wh = cameras[0].wh
    focal_px = float(np.median([np.mean(c.focal_px) / c.wh[0] for c in cameras])) * wh[0]
    lens = np.array([[focal_px, 0, wh[0] / 2], [0, focal_px, wh[1] / 2], [0, 0, 1]])
    cameras = [replace(c, wh=wh, intrinsics=lens) for c in cameras]
    centre_m, gaps = scene_centre(cameras), gaps_around(cameras)
    widest = int(np.argmax([gap.rad for gap in gaps]))
    is_open = gaps[widest].rad > LARGEST_GAP_RAD
    legs = [*gaps[widest + 1 :], *gaps[:widest]] if is_open else gaps
    if not legs:
        return [cameras[0]] * _FPS
    count = max(2, round(_AROUND_S * _FPS / len(legs) / (2 if is_open else 1)))
    way: list[Camera] = []
    for leg in legs:
        start, end = cameras[leg.first], cameras[leg.second]
        way += interpolate_cameras(start, end, count + 1, centre_m, rotations="slerp", clearance=1.0)[0][:-1]
    if not is_open:
        return way
    way.append(cameras[legs[-1].second])
    return [*way, *way[-2:0:-1]]


def draw_views(room: Gaussians, cameras: Sequence[Camera]) -> Iterator[Integer[np.ndarray, "H W 3"]]:
    """Yields (H, W, 3) uint8 of every camera."""
    rasteriser = Rasteriser(near_m=_NEAR_M)
    for camera in progress(cameras, "pictures"):
        yield to_bytes(rasteriser.forward(room, camera, background_rgb=_UNSEEN_RGB).rgb)


def run(settings: Settings, model: Path, plates: list[Path], sweeps: list[Path], box: Path, film: Written) -> None:
    """Film the room ``box`` with the plates on it, and in front of it the confident planes of the ``sweeps``."""
    cameras = read_model(model.parent)
    swept, fitted = read_sweeps(sweeps, len(cameras)), read_room(box)
    pictures = equalise_exposure(read_pictures(cameras, plates, settings.sweep_width), swept.gains)
    depths_m = swept.votes.inside_room(pictures, fitted).depths_m(pictures, fitted)
    room, path = discs_from_depths(pictures, depths_m), preview_path([p.camera for p in pictures])
    write_watchable(film, draw_views(room, path), _FPS)
    say(f"preview of the room without people: {film} ({len(path)} pictures of {room.count} Gaussians, untrained)")
