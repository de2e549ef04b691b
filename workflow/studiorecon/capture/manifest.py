# SPDX-License-Identifier: Apache-2.0
"""All cameras' footage → one manifest: the same number of frames, the same rate, and whether the clocks seem to agree."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from studiorecon.capture.sync import Lag, lags, motion_energy
from studiorecon.errors import Refusal
from studiorecon.images.video import read_frames
from studiorecon.progress import progress, say, warn
from studiorecon.scene.capture import Footage, Manifest, common_start, read_footage, write_manifest


@dataclass(frozen=True)
class SyncSettings:
    """How far apart clocks are looked for, and when the answer counts.

    Attributes:
        search_s: largest lag that is tried, seconds.
        min_correlation: below this best correlation of motion over time the lag is undetermined.
        min_z: the best lag must beat no lag by this many standard errors before it is reported.
    """

    search_s: float
    min_correlation: float
    min_z: float


@dataclass(frozen=True)
class Settings:
    """See ``SyncSettings``."""

    sync: SyncSettings


def check_alike(footage: Sequence[Footage]) -> None:
    """Raise Refusal, naming two files, their numbers and the remedy, when cameras differ in length or frame rate."""
    shortest, longest = min(footage, key=lambda f: f.frames), max(footage, key=lambda f: f.frames)
    if shortest.frames != longest.frames:
        raise Refusal(
            f"{shortest.source} has {shortest.frames} frames and {longest.source} has {longest.frames}; write frames: "
            f"{{first: {common_start(footage)}, count: {shortest.frames}}} into capture.yaml, and starts: {{CAMERA: frames}} for a camera "
            "that was started before the others"
        )
    slowest, fastest = min(footage, key=lambda f: f.fps), max(footage, key=lambda f: f.fps)
    # 29.97 against 30 is the same clip until the clocks have drifted apart by half a frame.
    if (fastest.fps / slowest.fps - 1) * shortest.frames > 0.5:
        raise Refusal(
            f"{slowest.source} runs at {slowest.fps:g} frames per second and {fastest.source} at {fastest.fps:g}; "
            "convert all videos to one rate, so that frame k is the same moment in each"
        )


def describe(lag: Lag, fps: float, start: int) -> str:
    """One sentence about one camera's clock; ``start`` is how many frames of its video the others do not have so far."""
    if not lag.valid:
        return f"{lag.camera}: whether its clock agrees is undetermined ({lag.reason})"
    if lag.frames == 0:
        return f"{lag.camera}: in step with the others (motion correlates at {lag.correlation:.2f})"
    way = "later" if lag.frames > 0 else "earlier"
    return (
        f"{lag.camera}: seems {abs(lag.frames)} frame(s), {abs(lag.frames) / fps:.3f} s, {way} than the others (motion correlates at "
        f"{lag.correlation:.2f}, {lag.correlation_at_zero:.2f} as it is); if it is, write "
        f'starts: {{"{lag.camera}": {start + lag.frames}}} into capture.yaml'
    )


def run(settings: Settings, scene: str, footage: list[Path], videos: list[Path], manifest: Path) -> None:
    """Check that ``footage`` (JSON of every camera) fits together; write ``manifest``.

    ``videos``, in the same order, are for the sync check; without them there is none.
    """
    cameras = [read_footage(path) for path in footage]
    if not cameras:
        raise Refusal(f"scene {scene} has no cameras; put one video per camera into videos/")
    check_alike(cameras)
    fps = float(np.median([c.fps for c in cameras]))
    energies = [motion_energy(read_frames(video)) for video in progress(videos, "motion")]
    sync = settings.sync
    found = lags([c.camera for c in cameras], energies, round(sync.search_s * fps), sync.min_correlation, sync.min_z)
    for lag, camera in zip(found, cameras):
        (warn if lag.valid and lag.frames else say)(describe(lag, fps, camera.first_source_frame - common_start(cameras)))
    write_manifest(manifest, Manifest(scene, fps, cameras[0].frames, tuple(cameras)))
    held_out = [c.camera for c in cameras if c.held_out]
    say(f"{len(cameras)} cameras, {cameras[0].frames} frames at {fps:g} per second; held out: {', '.join(held_out) or 'none'}")
