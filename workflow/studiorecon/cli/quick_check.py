# SPDX-License-Identifier: Apache-2.0
"""What a capture's folder holds, before any job: sentences for the terminal and the window."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from studiorecon.calibration.checks.advice import brightness_and_clipping, footage_notes
from studiorecon.errors import UserError
from studiorecon.footage.frames import seek_frames
from studiorecon.footage.source import open_source
from studiorecon.plan.discovery import open_dataset


def quick_check(folder: Path) -> Iterator[str]:
    """Sentences from files, headers and two pictures of every camera; raises UserError without a capture."""
    capture = open_dataset(folder, None)
    calibration = ", ".join(
        str(file.relative_to(folder)) if file.is_relative_to(folder) else str(file) for file in capture.calibration
    )
    yield f"calibration: {calibration or 'none, so the keypoints of people give the cameras'}"
    about = []
    for camera, source in capture.footage.items():
        start = capture.first_frame
        try:
            seen = open_source(source, 0.0)
            frames = seen.frames + sum(open_source(part, 0.0).frames for part in capture.chapters.get(camera, ())[1:])
            light = brightness_and_clipping(seek_frames(seen, [start, start + capture.frame_count // 2]))
        except UserError as refusal:
            yield f"camera {camera}: {refusal}"
            continue
        has = camera in capture.keypoints
        yield (
            f"camera {camera}: {seen.wh[0]}×{seen.wh[1]}, {seen.fps:g} fps, {frames} frames, mean grey "
            f"{light['brightness']:.2f}, {'keypoints' if has else 'no keypoints: the detector finds people'}"
        )
        yield from (f"camera {camera}: {note}" for note in seen.notes)
        about.append({"camera": camera, **light, "fps": seen.fps, "rotation_deg": seen.rotation_deg})
    yield from footage_notes(about) if about else ()
    yield from capture.notes
