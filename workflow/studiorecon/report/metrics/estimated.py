# SPDX-License-Identifier: Apache-2.0
"""People, and seen and unseen surfaces, in held-out pictures of a real capture, where no exact truth exists.

As in the paper's Seen/Unseen Fidelity, depth is the run's own: a surface of the room is seen when a training camera's
depth agrees with the rendered depth of the held-out view, and nobody's mask is in front of it there. People are the
outlines of the fitted bodies: the run makes no masks of held-out cameras.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.body.model import BodyModel
from studiorecon.body.silhouettes import person_depth_m
from studiorecon.footage.exr import read_depth
from studiorecon.footage.video import read_frames, read_frames_from
from studiorecon.images.warp import nearest_pixels
from studiorecon.report.metrics.truth import is_visible
from studiorecon.scene.camera import Camera
from studiorecon.scene.people import Person

if TYPE_CHECKING:
    from jaxtyping import Bool

SOURCE = "fitted bodies, and the run's own depth"


@dataclass(frozen=True)
class EstimatedFiles:
    """Files of the run's own depth and people.

    ``film_depth`` (one or none): rendered depth of the film that is compared. ``room_depths``, ``room_masks``: of the
    training cameras, by their names; no masks without people.
    """

    film_depth: list[Path] = field(default_factory=list)
    room_depths: list[Path] = field(default_factory=list)
    room_masks: list[Path] = field(default_factory=list)
    body: list[Path] = field(default_factory=list)


def estimated_regions(
    files: EstimatedFiles,
    people: Sequence[Person],
    camera: Camera,
    training: Sequence[Camera],
    start: int,
    frames: int,
    tolerance: float,
) -> Iterator[dict[str, Bool[np.ndarray, "H W"]]]:
    """Masks of a held-out camera's frames: people, background, seen and unseen at ``tolerance``.

    ``start`` is the picture of the film at which the camera's own view begins.
    """
    body = BodyModel.load(files.body[0]) if people else None
    room_m = {path.stem: read_depth(path)[0] for path in files.room_depths}
    masks = {path.stem: read_frames(path, 0, frames) for path in files.room_masks}
    height, width = camera.hw
    for frame, units in enumerate(read_frames_from(files.film_depth[0], start, start + frames)):
        # Of the rendered depth film.
        depth_m = units[:height, :width].astype(np.float64) / 1000
        people_here = np.zeros(camera.hw, bool)
        for person in (one for one in people if one.present[frame]):
            assert body is not None
            people_here |= person_depth_m(person, body, camera, frame) > 0
        known = (depth_m > 0) & ~people_here
        points = camera.unproject(camera.pixel_centres(), np.where(known, depth_m, 1.0))
        seen = np.zeros(camera.hw, bool)
        for other in training:
            visible, pixels = is_visible(points, known, other, room_m[other.name], tolerance)
            rows, columns, _ = nearest_pixels(pixels, other.hw)
            clear = next(masks[other.name])[rows, columns] == 0 if other.name in masks else True
            seen |= visible & clear
        yield {
            "people": people_here,
            "background": ~people_here,
            "seen": known & seen,
            "unseen": known & ~seen,
        }
