# SPDX-License-Identifier: Apache-2.0
"""One camera's footage → lossless, undistorted frames at working size, and what was done to get them.

Reads ``width`` and ``picture_fps``. Resizing and undistortion are one sampling of the source frame, averaged over as many
samples as the frame shrinks by, so that nothing is filtered twice and nothing aliases.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from studiorecon.capture.lenses import lens_of
from studiorecon.errors import Refusal
from studiorecon.geometry.lens import WorkingView, working_view, working_wh
from studiorecon.images.footage import Source, decode, digest, open_source, uneven
from studiorecon.images.video import write_lossless
from studiorecon.progress import progress, say, warn
from studiorecon.scene.camera import Lens
from studiorecon.scene.capture import Footage, write_footage


@dataclass(frozen=True)
class Settings:
    """How large the working frames are.

    Attributes:
        width: pixels along the longer side, so that portrait and landscape footage cost the same; 0 = as filmed.
        picture_fps: frame rate of footage that is a folder of pictures.
    """

    width: int
    picture_fps: float


def working_size(source_wh: tuple[int, int], longer_side: int) -> tuple[int, int]:
    """(w, h) of the working frames: the longer side has ``longer_side`` pixels (0 = as filmed), never more than the source has."""
    shrink = min(1.0, longer_side / max(source_wh)) if longer_side else 1.0
    return working_wh(source_wh, max(2, round(source_wh[0] * shrink)))


def describe_changes(source: Source, lens: Lens, view: WorkingView, first: int) -> list[str]:
    """Sentences: everything that sets the working frames apart from the file."""
    changes = list(source.notes)
    if source.rotation_deg:
        changes.append(f"turned by {source.rotation_deg} degrees counter-clockwise, as its rotation tag asks")
    if source.wh != view.wh:
        changes.append(f"resized from {source.wh[0]}×{source.wh[1]} to {view.wh[0]}×{view.wh[1]}")
    if np.any(lens.distortion != 0):
        changes.append(f"lens distortion removed ({lens.model} {', '.join(f'{c:.4g}' for c in lens.distortion)})")
    if not np.array_equal(lens.calibration_from_video, np.eye(2, 3)):
        changes.append("pixels of the video were mapped to those of the calibration, as pixel_maps in capture.yaml says")
    if first:
        changes.append(f"starts at frame {first} of the source")
    return changes


def run(
    settings: Settings, source: Path, calibration: Path, camera: str, held_out: int, first: int, count: int, video: Path, footage: Path
) -> None:
    """Decode, undistort and resize frames ``first`` … of ``source``; write ``video`` (lossless) and ``footage`` (JSON)."""
    opened = open_source(source, settings.picture_fps)
    lens = lens_of(calibration, camera)
    view = working_view(lens, opened.wh, working_size(opened.wh, settings.width))

    times_s: list[float] = []

    def pictures() -> Iterator[np.ndarray]:
        total = count or (max(opened.declared_frames - first, 0) if opened.declared_frames else None)
        for frame in progress(decode(opened, first, count, times_s), "frames", total):
            yield view.picture(frame)

    try:
        frames = write_lossless(video, pictures(), opened.fps)
    except MemoryError:
        raise Refusal(f"{source} is too large to decode in memory; lower capture.width") from None
    changes = describe_changes(opened, lens, view, first)
    if wrong := uneven(times_s, first):
        warn(f"{source}: {wrong}")
        changes.append(wrong)
    write_footage(
        footage,
        Footage(
            camera=camera,
            held_out=bool(held_out),
            wh=view.wh,
            intrinsics=view.intrinsics.tolist(),
            fps=opened.fps,
            frames=frames,
            first_source_frame=first,
            source=f"{source.parent.name}/{source.name}",
            source_sha256=digest(opened),
            source_wh=opened.wh,
            rotation_deg=opened.rotation_deg,
            sync_offset_s=0.0,
            changes=changes,
        ),
    )
    say(f"{camera}: {frames} frames at {opened.fps:g} per second, {view.wh[0]}×{view.wh[1]}" + "".join(f"; {c}" for c in changes))
