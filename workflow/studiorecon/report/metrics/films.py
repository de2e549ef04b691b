# SPDX-License-Identifier: Apache-2.0
"""Films beside the photos that they are compared with, and where in a film each camera's own view begins."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from studiorecon.camera_files.colmap import read_model
from studiorecon.errors import UserError
from studiorecon.scene.camera import Camera
from studiorecon.scene.capture import Manifest, read_manifest
from studiorecon.scene.path import read_path


@dataclass(frozen=True)
class ScoredFilms:
    """Films, and the photos that they are compared with.

    Attributes:
        capture: whose frames the films show.
        training, held_out: cameras. Films are those of the held-out ones or, without any, of the training ones.
        footage: camera → its photos.
        films, starts: version ("raw", "enhanced") → film; camera → index of its first picture in every film.
    """

    capture: Manifest
    training: Sequence[Camera]
    held_out: Sequence[Camera]
    footage: Mapping[str, Path]
    films: Mapping[str, Path]
    starts: Mapping[str, int]

    @property
    def cameras(self) -> Sequence[Camera]:
        """Those that are compared."""
        return self.held_out or self.training


@dataclass(frozen=True)
class ScoredFilmFiles:
    """``ScoredFilms`` as files: ``videos``, ``render`` and ``enhanced`` are of the cameras that are compared."""

    manifest: Path
    model: Path
    heldout_model: Path
    videos: list[Path] = field(default_factory=list)
    render: list[Path] = field(default_factory=list)
    render_path: list[Path] = field(default_factory=list)
    enhanced: list[Path] = field(default_factory=list)

    def read(self) -> ScoredFilms:
        """Raises UserError as ``first_frames`` does."""
        capture = read_manifest(self.manifest)
        training, held_out = read_model(self.model.parent), read_model(self.heldout_model.parent)
        versions = (("raw", self.render), ("enhanced", self.enhanced)) if self.render_path else ()
        films = {name: files[0] for name, files in versions if files}
        starts = first_frames(self.render_path[0], held_out or training, capture) if self.render_path else {}
        return ScoredFilms(capture, training, held_out, {video.stem: video for video in self.videos}, films, starts)


def first_frames(path: Path, cameras: Sequence[Camera], capture: Manifest) -> dict[str, int]:
    """camera → index of its first picture in a film; raises UserError unless it shows every frame of this capture.

    Otherwise pictures would silently be paired with the wrong photos.
    """
    steps, _ = read_path(path)
    starts: dict[str, int] = {}
    for index, step in enumerate(steps):
        starts.setdefault(step.segment, index)
    for camera in cameras:
        if camera.name not in starts:
            raise UserError(
                f"{path} has no pictures of camera {camera.name}: it belongs to another run; render it again"
            )
        shown = [step.frame for step in steps if step.segment == camera.name]
        if shown != list(range(capture.frames)):
            raise UserError(
                f"{path} shows {len(shown)} pictures of camera {camera.name} and the capture "
                f"has {capture.frames} frames, one each: "
                "it belongs to another run; render it again"
            )
    return starts
