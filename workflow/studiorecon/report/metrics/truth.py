# SPDX-License-Identifier: Apache-2.0
"""Exact truth of a synthetic studio, for reports only: people in a held-out picture, and seen parts of the room.

The folder holds ``cameras.json`` (ideal pinholes), ``depth/<camera>.exr`` (the empty room), ``masks/<camera>.mkv`` (0
room, k + 1 person k, 255 props), ``bodies/<person>.npz`` and, if the studio's settings keep it,
``depth_frames/<camera>.mkv``.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from studiorecon.body.person_files import read_person
from studiorecon.errors import UserError
from studiorecon.footage.exr import read_depth
from studiorecon.footage.video import read_frames
from studiorecon.images.warp import nearest_pixels, sample
from studiorecon.scene.camera import CAMERA, Camera
from studiorecon.scene.schema import ListOf, record
from studiorecon.scene.step_files import read

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

_PROPS = 255


@dataclass(frozen=True)
class TrueView:
    """Truth of one camera: its ideal pinhole, the empty room's depth in metres, and the video of its masks."""

    camera: Camera
    room_depth_m: Float[np.ndarray, "H W"]
    masks: Path


def read_views(folder: Path) -> dict[str, TrueView]:
    """camera → truth, of every camera of the studio."""
    values: list[dict[str, Any]] = read(folder / "cameras.json", ListOf(CAMERA))
    cameras = [record(Camera, value) for value in values]
    return {
        c.name: TrueView(c, read_depth(folder / "depth" / f"{c.name}.exr")[0], folder / "masks" / f"{c.name}.mkv")
        for c in cameras
    }


def true_joints(folder: Path) -> dict[str, Float[np.ndarray, "T 24 3"]]:
    """person → world joints of every source frame, metres."""
    return {path.stem: read_person(path).joints for path in sorted((folder / "bodies").glob("*.npz"))}


@dataclass(frozen=True)
class Truth:
    """Exact truth of a capture that begins at ``first_frame`` of the studio's films.

    Attributes:
        views: camera → what it sees.
        joints: person → world joints from the capture's first frame on, metres.
    """

    views: dict[str, TrueView]
    joints: Mapping[str, Float[np.ndarray, "T 24 3"]]
    first_frame: int


def read_truth(folder: Path, first_frame: int) -> Truth:
    """The truth of a capture that begins at ``first_frame``; raises UserError where the folder is missing."""
    if not folder.is_dir():
        raise UserError(f"{folder} is not a folder of exact truth; make the studio again, or leave --truth out")
    joints = {name: values[first_frame:] for name, values in true_joints(folder).items()}
    return Truth(read_views(folder), joints, first_frame)


def true_pixels(working: Camera, true: Camera) -> Float[np.ndarray, "H W 2"]:
    """Pixels of the true pinhole that correspond to the working pixels of the same pose."""
    rays = (working.pixel_centres() - np.array(working.principal_px)) / np.array(working.focal_px)
    return rays * np.array(true.focal_px) + np.array(true.principal_px)


def is_visible(
    points_m: Float[np.ndarray, "... 3"],
    known: Bool[np.ndarray, " ..."],
    camera: Camera,
    depth_m: Float[np.ndarray, "H W"],
    tolerance: float,
) -> tuple[Bool[np.ndarray, " ..."], Float[np.ndarray, "... 2"]]:
    """Which points a camera with z-depth ``depth_m`` sees; and their pixels.

    Seen: in front, inside the picture, and |z − z_n| ≤ tolerance · z_n with the camera's own depth z_n (relative to
    that one: 5 m read as 4.75 m is 5.3 % or 5.0 % by the choice, V02). z_n must be finite and positive (V01: inf passes
    ``<=``) and away from depth edges.
    """
    usable = np.where(np.isfinite(depth_m) & (depth_m > 0), depth_m, 0).astype(np.float32)
    window = np.ones((3, 3), np.uint8)
    edge = cv2.dilate(usable, window) - cv2.erode(usable, window) > tolerance * np.maximum(usable, 1e-6)
    pixels, distance = camera.project(points_m)
    found, inside = sample(np.where(edge, np.float32(0), usable), pixels, "nearest")
    possible = known & inside & (distance > 0) & (found > 0)
    gap = np.where(possible, np.abs(found - np.where(possible, distance, 0)), np.inf)
    return possible & (gap <= tolerance * found), pixels


def truth_regions(
    views: dict[str, TrueView],
    camera: Camera,
    training: Sequence[str],
    first_frame: int,
    frames: int,
    tolerance: float,
) -> Iterator[dict[str, Bool[np.ndarray, "H W"]]]:
    """Masks of one held-out camera's working frames, a dictionary per frame: people, background, seen, unseen, ….

    A background pixel is seen when at that time some training camera sees the same surface without a person in front.
    A person's pixel needs that frame's depth,
    which the studio stores with ``truth: depth_frames``; without it ``people_seen`` and ``people_unseen`` are absent.
    """
    own = views[camera.name]
    pixels = true_pixels(camera, own.camera)
    depth_m, inside = sample(own.room_depth_m, pixels, "nearest")
    known = inside & np.isfinite(depth_m) & (depth_m > 0)
    points = own.camera.unproject(pixels, np.where(known, depth_m, 1.0).astype(np.float64))
    others = [is_visible(points, known, views[name].camera, views[name].room_depth_m, tolerance) for name in training]
    stop = first_frame + frames
    streams = [read_frames(views[name].masks, first_frame, stop) for name in training]
    rows, columns, inside = nearest_pixels(pixels, own.room_depth_m.shape)
    places = [nearest_pixels(where, views[name].room_depth_m.shape)[:2] for name, (_, where) in zip(training, others)]
    moving = _depth_frames(views, [camera.name, *training], first_frame, stop)
    for mask in read_frames(own.masks, first_frame, stop):
        labels = np.where(inside, mask[rows, columns], _PROPS)
        background = labels == 0
        seen = np.zeros(labels.shape, bool)
        for (visible, _), place, stream in zip(others, places, streams):
            clear = next(stream)[place] == 0
            seen |= visible & clear
        people = (labels > 0) & (labels < _PROPS)
        found = {"people": people, "background": background, "seen": background & seen, "unseen": background & ~seen}
        if moving is not None:
            found |= _visible_people(
                people, pixels, own.camera, [views[n].camera for n in training], next(moving), tolerance
            )
        yield found


def _visible_people(
    people: np.ndarray,
    pixels: np.ndarray,
    own: Camera,
    training: Sequence[Camera],
    depths_m: Sequence[np.ndarray],
    tolerance: float,
) -> dict[str, np.ndarray]:
    """People's pixels (H, W) that some training camera sees in the same frame, and those that none sees."""
    where = pixels[people][None]
    depth_m = sample(depths_m[0], where, "nearest")[0].astype(np.float64)
    known = np.isfinite(depth_m) & (depth_m > 0)
    points = own.unproject(where, np.where(known, depth_m, 1.0))
    covered = np.zeros(known.shape, bool)
    for camera, depth in zip(training, depths_m[1:]):
        covered |= is_visible(points, known, camera, depth, tolerance)[0]
    seen, unseen = np.zeros(people.shape, bool), np.zeros(people.shape, bool)
    seen[people], unseen[people] = covered[0], (known & ~covered)[0]
    return {"people_seen": seen, "people_unseen": unseen}


def _depth_frames(
    views: dict[str, TrueView], names: Sequence[str], start: int, stop: int
) -> Iterator[list[np.ndarray]] | None:
    """Depth in metres of the named cameras, frame by frame; None when the studio did not store it."""
    paths = [views[name].masks.parent.parent / "depth_frames" / f"{name}.mkv" for name in names]
    if not all(path.is_file() for path in paths):
        return None
    streams = zip(*(read_frames(path, start, stop) for path in paths))
    # The studio stores depth with people in whole millimetres.
    return ([depth.astype(np.float32) / 1000 for depth in depths] for depths in streams)
