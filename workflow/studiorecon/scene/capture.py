# SPDX-License-Identifier: Apache-2.0
"""The facts about each camera's footage from `capture`: ``capture/<camera>.json`` and ``capture/manifest.json``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from studiorecon.scene.files import write_json
from studiorecon.scene.schema import ASCENDING, INTRINSIC, ListOf, flag, frame_rate, real, record, seconds, text, whole
from studiorecon.scene.step_files import expect, expect_named, read

_FPS = frame_rate()
_FRAMES = whole(low=1)
_FOOTAGE = {
    "camera": text(),
    "held_out": flag(),
    "wh": whole("2", low=1, unit="pixels"),
    "intrinsics": real("3 3", such=INTRINSIC),
    "fps": _FPS,
    "frames": _FRAMES,
    "first_source_frame": whole(low=0),
    "source": text(),
    "source_sha256": text(),
    "source_wh": whole("2", low=1, unit="pixels"),
    "rotation_deg": whole(low=-360, high=360, unit="degrees"),
    "sync_offset_s": seconds(),
    "changes": ListOf(text()),
    "source_frames": whole("F", low=0, such=ASCENDING),
}
_MANIFEST = {"scene": text(), "fps": _FPS, "frames": _FRAMES, "footage": ListOf(_FOOTAGE)}


@dataclass(frozen=True)
class Footage:
    """The working frames of one camera.

    Attributes:
        held_out: True when only ``report`` may read the pictures.
        wh: working size of the undistorted frames.
        intrinsics: 3×3 nested list, pixels of the undistorted working frames.
        first_source_frame: 0-based index in the source of working frame 0.
        source: file or folder the frames came from, relative to the dataset.
        source_sha256: digest of the file (of the sorted file digests for a folder).
        source_wh: size of the source frames, after their rotation tag.
        rotation_deg: rotation tag that was applied, 0 when none.
        sync_offset_s: common time of its first source frame (0 when synchronised).
        changes: sentences: every conversion of the footage.
        source_frames: the source frame of every working frame, where they are not consecutive; else empty.
    """

    camera: str
    held_out: bool
    wh: tuple[int, int]
    intrinsics: list[list[float]]
    fps: float
    frames: int
    first_source_frame: int
    source: str
    source_sha256: str
    source_wh: tuple[int, int]
    rotation_deg: int
    sync_offset_s: float
    changes: list[str]
    source_frames: tuple[int, ...] = ()

    @property
    def used(self) -> Sequence[int]:
        """The source frame of every working frame."""
        return self.source_frames or range(self.first_source_frame, self.first_source_frame + self.frames)

    @property
    def film_px(self) -> float:
        """Pixels of the film per working pixel."""
        return max(self.source_wh) / max(self.wh)


@dataclass(frozen=True)
class Manifest:
    """All cameras of a scene; ``footage`` is in the user's camera order, training and held-out cameras together."""

    scene: str
    fps: float
    frames: int
    footage: tuple[Footage, ...]

    @property
    def training(self) -> tuple[Footage, ...]:
        return tuple(f for f in self.footage if not f.held_out)

    @property
    def held_out(self) -> tuple[Footage, ...]:
        return tuple(f for f in self.footage if f.held_out)

    def of(self, camera: str) -> Footage:
        """The footage of one camera; raises KeyError when there is none of that name."""
        for footage in self.footage:
            if footage.camera == camera:
                return footage
        raise KeyError(camera)


def common_start(footage: Sequence[Footage]) -> int:
    """``frames.first`` of capture.yaml: the first used frame of the camera that started last."""
    return min(f.first_source_frame for f in footage)


def write_footage(path: Path, footage: Footage) -> None:
    write_json(path, asdict(footage))


def read_footage(path: Path) -> Footage:
    """The footage of the camera that names the file; raises UserError as ``step_files.read`` does."""

    def made(value: dict[str, Any]) -> Footage:
        expect_named(path, value["camera"])
        return _footage(value)

    return read(path, _FOOTAGE, made)


def write_manifest(path: Path, manifest: Manifest) -> None:
    write_json(path, asdict(manifest))


def read_manifest(path: Path) -> Manifest:
    """All cameras of a scene; raises UserError as ``step_files.read`` does."""
    return read(path, _MANIFEST, _manifest)


def _manifest(value: dict[str, Any]) -> Manifest:
    footage = tuple(_footage(f) for f in value["footage"])
    names = [f.camera for f in footage]
    expect(len(set(names)) == len(names), f"of {len(names)} cameras two share a name")
    made = record(Manifest, {**value, "footage": list(footage)})
    for f in footage:
        expect(
            (f.frames, f.fps) == (made.frames, made.fps),
            f"camera {f.camera} has {f.frames} frames at {f.fps:g} per second, the scene {made.frames} at {made.fps:g}",
        )
    return made


def _footage(value: dict[str, Any]) -> Footage:
    made = record(Footage, value)
    expect(
        len(made.source_frames) in (0, made.frames),
        f"source_frames has {len(made.source_frames)} numbers for {made.frames} frames",
    )
    return made
