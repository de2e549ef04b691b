# SPDX-License-Identifier: Apache-2.0
"""Converts one camera's footage to lossless, undistorted frames at working size, and lists the changes.

Reads ``width`` and ``picture_fps``. Resizing and undistortion are one sampling of the source frame, averaged over as
many samples as the frame shrinks by, so that nothing is filtered twice and nothing aliases.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.camera_files.calibration import find_lens
from studiorecon.configuration.setting import setting
from studiorecon.errors import UserError
from studiorecon.footage.container import read_film_list
from studiorecon.footage.frames import damage_note, decode
from studiorecon.footage.source import FootageSource, PictureRate, digest, open_source, timing_irregularities
from studiorecon.footage.video import camera_title, write_lossless
from studiorecon.geometry.lens import WorkingView, rayless_share, working_view, working_wh
from studiorecon.progress import progress, say
from studiorecon.scene.camera import Lens
from studiorecon.scene.capture import Footage, write_footage
from studiorecon.scene.clocks import read_clocks
from studiorecon.signature import Written

if TYPE_CHECKING:
    from jaxtyping import Float, Integer


@dataclass(frozen=True)
class Settings(PictureRate):
    """Size of the working frames: the longer side, so that portrait and landscape footage cost the same."""

    width: int = setting(
        480,
        "Longer side of the working frames, pixels, at most as filmed; 0 = as filmed.",
        minimum=0,
        maximum=16384,
        paper="1280×704",
        paper_value=1280,
    )


def working_size(source_wh: tuple[int, int], longer_side: int) -> tuple[int, int]:
    """(w, h) of the working frames: the longer side has ``longer_side`` pixels (0 = as filmed), never more than the
    source has."""
    shrink = min(1.0, longer_side / max(source_wh)) if longer_side else 1.0
    return working_wh(source_wh, max(2, round(source_wh[0] * shrink)))


def describe_changes(
    source: FootageSource,
    lens: Lens,
    view: WorkingView,
    used: Integer[np.ndarray, " N"],
    late_frames: Float[np.ndarray, " N"],
) -> list[str]:
    """Sentences: all differences between the working frames and the file."""
    changes = list(source.notes)
    if source.rotation_deg:
        changes.append(f"turned by {source.rotation_deg} degrees counter-clockwise (rotation tag)")
    if source.wh != view.wh:
        changes.append(f"resized from {source.wh[0]}×{source.wh[1]} to {view.wh[0]}×{view.wh[1]}")
    if np.any(lens.distortion != 0):
        changes.append(f"lens distortion removed ({lens.model} {', '.join(f'{c:.4g}' for c in lens.distortion)})")
    if share := rayless_share(lens, source.wh):
        changes.append(f"{share:.1%} of its picture is not used: the lens distortion cannot be inverted there")
    if not np.array_equal(lens.calibration_from_video, np.eye(2, 3)):
        how = lens.placed or "as pixel_maps in capture.yaml says"
        changes.append(f"pixels of the video were mapped to those of the calibration: {how}")
    if used[0]:
        changes.append(f"starts at frame {used[0]} of the source")
    if jumps := int((np.diff(used) != 1).sum()):
        changes.append(f"{jumps} of {len(used) - 1} frames are skipped or repeated to match its time stamps")
    if np.abs(late_frames).max() > 0:
        most = np.abs(late_frames).max()
        changes.append(f"its pictures are {late_frames.mean():+.2f} frames late on average ({most:.2f} at most)")
    return changes


def working_frames(
    source: FootageSource, view: WorkingView, used: Integer[np.ndarray, " N"], whole: bool, damaged: list[int]
) -> Iterator[Integer[np.ndarray, "H W 3"]]:
    """Pictures of the N ``used`` frames of the source, in order; some come more than once.

    ``whole`` decodes the source to its end. Numbers of damaged frames are added to ``damaged``.
    """
    wanted = np.bincount(used - used[0])
    decoded = decode(source, int(used[0]), 0 if whole else len(wanted), damaged)
    for number, frame in enumerate(progress(decoded, "frames", len(wanted))):
        if number < len(wanted) and wanted[number]:
            picture = view.picture(frame)
            for _ in range(wanted[number]):
                yield picture


def run(
    settings: Settings,
    source: Path,
    calibration: Path,
    clocks: Path,
    camera: str,
    held_out: int,
    frame_count: int,
    video: Written,
    footage: Written,
) -> None:
    """Decode, undistort and resize the frames of ``source`` that ``clocks`` selects; write ``video`` (lossless) and
    ``footage`` (JSON).

    ``frame_count`` is the user's number of frames; 0 means all, and then a missing end is refused.
    """
    opened = open_source(source, settings.picture_fps)
    lens = find_lens(calibration, camera)
    common = read_clocks(clocks)
    if common.refusal:
        raise UserError(common.refusal)
    clock, used = common.of(camera), common.source_frames(camera)
    view = working_view(lens, opened.wh, working_size(opened.wh, settings.width))
    sha256, damaged = digest(opened), list[int]()
    # Decode to the very end when all frames are used, so that a truncated recording is noticed.
    whole = not frame_count and used[-1] >= clock.frames - 1
    pictures = working_frames(opened, view, used, whole, damaged)
    frames = write_lossless(video, pictures, common.fps, camera_title(camera, sha256))
    changes = describe_changes(opened, lens, view, used, common.late_frames(camera))
    if damaged:
        changes.append(damage_note(damaged, opened.frames))
    if wrong := timing_irregularities(clock.times_s, 0):
        changes.append(wrong)
    write_footage(
        footage,
        Footage(
            camera=camera,
            held_out=bool(held_out),
            wh=view.wh,
            intrinsics=view.intrinsics.tolist(),
            fps=common.fps,
            frames=frames,
            first_source_frame=int(used[0]),
            source=", ".join(f"{film.parent.name}/{film.name}" for film in read_film_list(source)),
            source_sha256=sha256,
            source_wh=opened.wh,
            rotation_deg=opened.rotation_deg,
            sync_offset_s=clock.offset_s,
            changes=changes,
            source_frames=() if (np.diff(used) == 1).all() else tuple(used.tolist()),
        ),
    )
    say(
        f"{camera}: {frames} frames at {common.fps:g} per second, {view.wh[0]}×{view.wh[1]}"
        + "".join(f"; {c}" for c in changes)
    )
