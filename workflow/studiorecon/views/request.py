# SPDX-License-Identifier: Apache-2.0
"""``views.request``: makes a network's request for one gap, and checks it by rendering before it costs a GPU hour.

Key frames are the clean plates of the training cameras, without people, or the first pictures as filmed
(``first_moment``). Pixels that were never seen empty, have no depth or are near a jump in it are masked.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from studiorecon.footage.video import to_float
from studiorecon.models.loading import adapter
from studiorecon.models.protocols import KeyFrame
from studiorecon.progress import say, warn
from studiorecon.scene.camera import Camera
from studiorecon.scene.factors import read_factors
from studiorecon.scene.files import write_npz
from studiorecon.signature import Written
from studiorecon.views.first_moment import FirstMomentPeople, first_pictures
from studiorecon.views.forward_warp import WarpSource
from studiorecon.views.frame import NetworkFrame, fit_network_frame
from studiorecon.views.synthesize import paint_holes, read_photos, read_segment
from studiorecon.views.warp_settings import ViewSource, Warping


@dataclass(frozen=True)
class Settings(ViewSource, Warping):
    """The network, and the photos in its input."""


def key_frame(photo: WarpSource, frame: NetworkFrame, radius: int) -> KeyFrame:
    """A photo at the network's size; unmeasured colours are painted from their rim, since frame 0 seeds the film."""
    whole = (
        to_float(paint_holes(photo.rgb, photo.usable.astype(np.float32), radius))
        if not photo.usable.all()
        else photo.rgb
    )
    rgb = np.where(photo.usable[..., None], photo.rgb, whole)
    return KeyFrame(
        frame.camera(photo.camera),
        np.clip(frame.colours(rgb), 0, 1),
        frame.values(photo.depth_m).astype(np.float32),
        frame.values(photo.usable),
    )


def nearest_photos(path: list[Camera], photos: list[WarpSource], count: int) -> list[WarpSource]:
    """The ``count`` photos nearest to the middle of the path, in their order, always with the one at its start."""
    middle_m = path[len(path) // 2].centre_m
    distance = [np.linalg.norm(photo.camera.centre_m - middle_m) for photo in photos]
    picked = [photos[i] for i in sorted(np.argsort(distance, kind="stable")[:count])]
    start = min(photos, key=lambda p: float(np.abs(p.camera.camera_from_world - path[0].camera_from_world).max()))
    return picked if any(p is start for p in picked) else [start, *picked[: len(picked) - 1]]


def run(
    settings: Settings,
    segment: str,
    path: Path,
    model: Path,
    plates: list[Path],
    depths: list[Path],
    gains: list[Path],
    videos: list[Path],
    masks: list[Path],
    fits: list[Path],
    body: Path | None,
    reference: str,
    request: Written,
) -> None:
    """Write the checked request (npz) of one gap.

    ``videos`` (with ``masks``, ``fits`` and their ``body``) are given only if their first pictures are the key frames.
    ``reference``: the source of ``depths`` (``depth.reference``).
    """
    photos = read_photos(model, plates, depths, gains, settings.depth_jump)
    if settings.key_frames == "first_frames":
        standing, factors = FirstMomentPeople.read(fits, body), read_factors(gains)
        measured = reference == "calibration"
        photos = first_pictures(photos, videos, masks, standing, factors, settings.depth_jump, measured)
    way, _ = read_segment(path, segment)
    network = adapter("view synthesizer", settings.synthesizer)
    frame = fit_network_frame(way[0].hw, network.hw)
    count = min(len(photos), network.most_key_frames)
    if count < len(photos):
        warn(
            f"segment {segment}: of {len(photos)} photos the {count} nearest are its key frames: the network takes no "
            "more at once"
        )
    key_frames = [key_frame(photo, frame, settings.inpaint_radius) for photo in nearest_photos(way, photos, count)]
    made = network.request(key_frames, [frame.camera(camera) for camera in way])
    network.check(made)
    found = network.evidence(made)
    say(
        f"segment {segment}: {len(key_frames)} key frames, {len(way)} views, lengths × {float(made['scene_scale']):.3g}"
    )
    say(found)
    write_npz(request, made)
