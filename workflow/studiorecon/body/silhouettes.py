# SPDX-License-Identifier: Apache-2.0
"""Regions of an image that fitted bodies cover, with a margin for clothes, hair and the error of the fit."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import cv2
import numpy as np

from studiorecon.body.model import BodyModel
from studiorecon.images.silhouette import mesh_depth
from studiorecon.scene.camera import Camera
from studiorecon.scene.people import Person

if TYPE_CHECKING:
    from jaxtyping import Bool, Float


def person_depth_m(person: Person, body: BodyModel, camera: Camera, frame: int) -> Float[np.ndarray, "H W"]:
    """Z-depth of one person's body at one frame, metres; 0 where it is not."""
    pose, place = person.poses[frame : frame + 1], person.trans[frame : frame + 1]
    return mesh_depth(body.vertices(pose, person.betas, place, body.proxy_vertices)[0], body.proxy_faces, camera)


def dilated_silhouettes(
    people: Sequence[Person],
    body: BodyModel | None,
    camera: Camera,
    frame: int,
    margin_m: float,
    filled_margin: float = 1.0,
) -> Bool[np.ndarray, "H W"]:
    """Pixels of the bodies of ``people`` at one frame, grown by ``margin_m`` at their distance.

    Filled-in bodies are grown ``filled_margin`` times as much, because they may be further off. People who are away
    have no region. ``body`` may be None where there are no people.
    """
    covered = np.zeros(camera.hw, np.uint8)
    for person in people:
        assert body is not None
        if not person.present[frame]:
            continue
        depth_m = person_depth_m(person, body, camera, frame)
        if (depth_m > 0).any():
            margin = margin_m * (1.0 if person.valid[frame] else filled_margin)
            radius = max(1, round(margin * camera.focal_px[0] / float(np.median(depth_m[depth_m > 0]))))
            disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1))
            covered |= np.asarray(cv2.dilate((depth_m > 0).astype(np.uint8), disc), np.uint8)
    return covered > 0
