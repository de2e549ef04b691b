# SPDX-License-Identifier: Apache-2.0
"""``views.request``: what GEN3C is asked for one segment, checked by rendering its cache before any GPU hour is spent on it.

Key frames are the clean plates of the training cameras, so nobody is in them; pixels that were never seen empty, or have no depth or lie
beside a jump in it, are masked.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from studiorecon.errors import Refusal
from studiorecon.images.video import to_float
from studiorecon.models import gen3c
from studiorecon.models.gen3c import KeyFrame
from studiorecon.models.gen3c_request import check_evidence, check_form, evidence
from studiorecon.progress import say
from studiorecon.scene.camera import Camera
from studiorecon.scene.files import write_npz
from studiorecon.views.forward import Source
from studiorecon.views.frame import Frame, frame_of
from studiorecon.views.synthesize import nearest_sources, paint_holes, read_photos, read_segment


@dataclass(frozen=True)
class Settings:
    """Which photos are given to the network; see config.yaml."""

    sources: int
    depth_jump: float
    inpaint_radius: int


def key_frame(photo: Source, frame: Frame, radius: int) -> KeyFrame:
    """A photo at the network's size; colours that were never measured are painted from their rim, since frame 0 seeds the film."""
    whole = to_float(paint_holes(photo.rgb, photo.usable.astype(np.float32), radius)) if not photo.usable.all() else photo.rgb
    rgb = np.where(photo.usable[..., None], photo.rgb, whole)
    return KeyFrame(
        frame.camera(photo.camera),
        np.clip(frame.colours(rgb), 0, 1),
        frame.values(photo.depth_m).astype(np.float32),
        frame.values(photo.usable),
    )


def chosen(path: list[Camera], photos: list[Source], count: int) -> list[Source]:
    """The ``count`` photos nearest to the middle of the path (all when 0), always with the one that the path starts at."""
    picked = nearest_sources(path[len(path) // 2], photos, count)
    start = min(photos, key=lambda p: float(np.abs(p.camera.camera_from_world - path[0].camera_from_world).max()))
    return picked if any(p is start for p in picked) else [start, *picked[: len(picked) - 1]]


def run(
    settings: Settings, segment: str, path: Path, model: Path, plates: list[Path], depth: list[Path], exposure: list[Path], request: Path
) -> None:
    """Write the checked request (npz) of one segment."""
    photos = read_photos(model, plates, depth, exposure, settings.depth_jump)
    way, _ = read_segment(path, segment)
    frame = frame_of(way[0].hw, gen3c.HW)
    key_frames = [key_frame(photo, frame, settings.inpaint_radius) for photo in chosen(way, photos, settings.sources)]
    try:
        made = gen3c.pre(key_frames, [frame.camera(camera) for camera in way])
        check_form(made)
        found = evidence(made)
        check_evidence(found)
    except Refusal as refusal:
        raise Refusal(f"segment {segment}: {refusal}") from None
    say(f"segment {segment}: {len(key_frames)} key frames, {len(way)} views, lengths × {float(made['scene_scale']):.3g}")
    say(
        f"rendered again, the first key frame is {found.own_error_levels:.2f} levels off itself, key frames agree in depth within "
        f"{found.depth_agreement:.1%}, and {found.coverage.min():.0%} or more of every view is shown by one"
    )
    write_npz(request, made)
