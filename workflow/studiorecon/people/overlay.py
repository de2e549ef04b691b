# SPDX-License-Identifier: Apache-2.0
"""``people.overlay``: one camera's footage with keypoints and fitted skeletons, as a film that plays in any player.

Dots are detected keypoints, lines are the body: thick where the frame was measured, thin where it was filled in, absent
where the body is behind the camera. One colour per person; rejected detections are grey.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np

from studiorecon.body.person_files import read_person
from studiorecon.camera_files.colmap import camera_named, read_model
from studiorecon.footage.video import read_frames, write_watchable
from studiorecon.images.palette import NOBODY, person_colour
from studiorecon.keypoints.layouts import JOINT_NAMES, LAYOUTS
from studiorecon.progress import progress, say
from studiorecon.scene.camera import Camera
from studiorecon.scene.capture import read_manifest
from studiorecon.scene.people import Detections, Person, read_detections, read_identities, split_tracks
from studiorecon.signature import Written

if TYPE_CHECKING:
    from jaxtyping import Float, Integer, Num

# cv2 draws in sixteenths of a pixel, counted from pixel centres.
_SHIFT = 4
_NEAR_M = 0.05


def bones_px(
    camera: Camera, joints_m: Num[np.ndarray, "24 3"]
) -> list[tuple[Float[np.ndarray, " 2"], Float[np.ndarray, " 2"]]]:
    """Both ends in pixels of every bone of joints that is wholly in front of the camera."""
    pixels, depth = camera.project(joints_m)
    return [(pixels[a], pixels[b]) for a, b in LAYOUTS["smpl24"].edges if min(depth[a], depth[b]) > _NEAR_M]


def draw_frame(
    picture: Integer[np.ndarray, "H W 3"],
    frame: int,
    camera: Camera,
    people: Sequence[Person],
    seen: Detections | None,
    identities: Mapping[tuple[str, int], str],
) -> Integer[np.ndarray, "H W 3"]:
    """Picture with this frame's keypoints and skeletons drawn into a copy."""
    canvas = np.ascontiguousarray(picture).copy()
    # Thickness of lines per pixel of picture width.
    width = max(1, round((1 / 320) * canvas.shape[1]))
    names = [person.name for person in people]
    shown = [] if seen is None else [(seen.track[d], seen.keypoints[d]) for d in np.flatnonzero(seen.frame == frame)]
    for track, points in shown:
        owner = identities.get((camera.name, int(track)), "")
        colour = person_colour(names.index(owner)) if owner in names else NOBODY
        for x, y, confidence in points:
            if confidence > 0:
                cv2.circle(canvas, _fixed((x, y)), (width + 1) << _SHIFT, colour, cv2.FILLED, cv2.LINE_AA, _SHIFT)
    for index, person in enumerate(people):
        if not person.present[frame]:
            continue
        thickness = 2 * width if person.valid[frame] else width
        bones = bones_px(camera, person.joints[frame])
        for start, end in bones:
            cv2.line(canvas, _fixed(start), _fixed(end), (0, 0, 0), thickness + 2, cv2.LINE_AA, _SHIFT)
        for start, end in bones:
            cv2.line(canvas, _fixed(start), _fixed(end), person_colour(index), thickness, cv2.LINE_AA, _SHIFT)
        head, depth = camera.project(person.joints[frame][JOINT_NAMES.index("head")])
        if float(depth) > _NEAR_M and np.abs(head).max() < 4 * canvas.shape[1]:
            at = (int(head[0]) + 3 * width, int(head[1]) - 3 * width)
            for colour, thick in (((0, 0, 0), width + 2), (person_colour(index), width)):
                cv2.putText(canvas, person.name, at, cv2.FONT_HERSHEY_SIMPLEX, 0.4 * width, colour, thick, cv2.LINE_AA)
    return canvas


def run(
    camera: str,
    model: Path,
    manifest: Path,
    video: Path,
    detections: list[Path],
    identities: Path,
    fits: list[Path],
    film: Written,
) -> None:
    """Write one camera's overlay film; ``detections`` is its file, or nothing where only plates determine the people.

    Raises UserError when a fit has another length than the capture.
    """
    capture = read_manifest(manifest)
    own = camera_named(read_model(model.parent), camera, model)
    people = [read_person(fit, capture.frames) for fit in fits]
    known = read_identities(identities)
    seen = split_tracks(read_detections(detections[0]), known) if detections else None
    frames = progress(enumerate(read_frames(video)), f"skeletons in {camera}")
    written = write_watchable(
        film, (draw_frame(picture, frame, own, people, seen, known) for frame, picture in frames), capture.fps
    )
    say(f"{film} shows {len(people)} people in {written} frames of camera {camera}")


def _fixed(point: Sequence[float] | np.ndarray) -> tuple[int, int]:
    # Far outside the picture cv2's integers would overflow; a bone that leaves the picture may end anywhere beyond it.
    x, y = np.clip(np.asarray(point, np.float64) - 0.5, -1e5, 1e5)
    return round(x * (1 << _SHIFT)), round(y * (1 << _SHIFT))
