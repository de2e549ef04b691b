# SPDX-License-Identifier: Apache-2.0
"""Exact truth of a made studio, which no other stage may read: who is where in a held-out picture, and what was seen of the room.

The folder holds ``cameras.json`` (ideal pinholes), ``depth/<camera>.exr`` (the empty room), ``masks/<camera>.mkv`` (0 room, k + 1
person k, 255 props) and ``bodies/<person>.npz``.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from studiorecon.images.exr import read_depth
from studiorecon.images.video import read_frames
from studiorecon.images.warp import sample
from studiorecon.scene.camera import Camera
from studiorecon.scene.files import read_json
from studiorecon.scene.people import read_person

_PROPS = 255


@dataclass(frozen=True)
class View:
    """Truth of one camera: its ideal pinhole, the empty room's depth (H, W) in metres, and the video of its masks."""

    camera: Camera
    room_depth_m: np.ndarray
    masks: Path


def read_views(folder: Path) -> dict[str, View]:
    """camera → truth, of every camera of the studio."""
    cameras = [Camera.from_json(value) for value in read_json(folder / "cameras.json")]
    return {c.name: View(c, read_depth(folder / "depth" / f"{c.name}.exr")[0], folder / "masks" / f"{c.name}.mkv") for c in cameras}


def true_joints(folder: Path) -> dict[str, np.ndarray]:
    """person → (T, 24, 3) world joints of every source frame, metres."""
    return {path.stem: read_person(path).joints for path in sorted((folder / "bodies").glob("*.npz"))}


def true_pixels(working: Camera, true: Camera) -> np.ndarray:
    """(H, W, 2) pixels of the true pinhole that show what the working pixels show: both look the same way, only sizes differ."""
    rays = (working.pixel_centres() - np.array(working.principal_px)) / np.array(working.focal_px)
    return rays * np.array(true.focal_px) + np.array(true.principal_px)


def room_seen_by(points_m: np.ndarray, depth_known: np.ndarray, view: View, tolerance: float) -> tuple[np.ndarray, np.ndarray]:
    """(H, W) bool: room points (H, W, 3) that a training camera sees in the empty room, and the pixels (H, W, 2) it sees them at.

    Seen: in front, inside the picture, depth within ``tolerance`` of the camera's own (relative), away from its depth edges.
    """
    window = np.ones((3, 3), np.uint8)
    depth = view.room_depth_m
    edge = cv2.dilate(depth, window) - cv2.erode(depth, window) > tolerance * np.maximum(depth, 1e-6)
    pixels, distance = view.camera.project(points_m)
    found, inside = sample(np.where(edge, np.float32(0), depth), pixels, "nearest")
    return depth_known & inside & (distance > 0) & (found > 0) & (np.abs(found - distance) <= tolerance * found), pixels


def regions(
    views: dict[str, View], camera: Camera, training: Sequence[str], first_frame: int, frames: int, tolerance: float
) -> Iterator[dict[str, np.ndarray]]:
    """Masks (H, W) bool of one held-out camera's working frames, one dictionary per frame: people, background, seen, unseen.

    A background pixel is seen when at that time some training camera sees the same surface with nobody in front of it. People's
    pixels are neither: their depth over time is not part of the truth.
    """
    own = views[camera.name]
    pixels = true_pixels(camera, own.camera)
    depth_m, inside = sample(own.room_depth_m, pixels, "nearest")
    known = inside & (depth_m > 0)
    points = own.camera.unproject(pixels, depth_m.astype(np.float64))
    others = [room_seen_by(points, known, views[name], tolerance) for name in training]
    stop = first_frame + frames
    streams = [read_frames(views[name].masks, first_frame, stop) for name in training]
    for mask in read_frames(own.masks, first_frame, stop):
        labels = np.where(inside, sample(mask, pixels, "nearest")[0], _PROPS)
        background = labels == 0
        seen = np.zeros(labels.shape, bool)
        for (visible, where), stream in zip(others, streams):
            seen |= visible & (sample(next(stream), where, "nearest")[0] == 0)
        people = (labels > 0) & (labels < _PROPS)
        yield {"people": people, "background": background, "seen": background & seen, "unseen": background & ~seen}
