# SPDX-License-Identifier: Apache-2.0
"""People's keypoints, camera by camera and in the world, to evaluate clocks, hands, faces and feet."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.geometry.triangulation import Limits, triangulate
from studiorecon.keypoints.layouts import LAYOUTS
from studiorecon.scene.camera import Camera
from studiorecon.scene.people import Detections

if TYPE_CHECKING:
    from jaxtyping import Num


@dataclass(frozen=True)
class Tracks:
    """Every person's keypoints in every camera.

    Attributes:
        pixels: (V, P, T, J, 2), NaN where not seen.
        confidence: (V, P, T, J), 0 where not seen.
        names: J keypoint names.
    """

    pixels: Num[np.ndarray, "V P T J 2"]
    confidence: Num[np.ndarray, "V P T J"]
    names: tuple[str, ...]


def person_tracks(
    found: Sequence[Detections],
    identities: Mapping[tuple[str, int], str],
    people: Sequence[str],
    frames: int,
    least: float,
) -> Tracks:
    """Keypoints with more confidence than ``least``, of the detections that ``identities`` gives to ``people``.

    Their names are those that all layouts share.
    """
    layouts = [LAYOUTS[d.layout].keypoints for d in found]
    names = tuple(n for n in layouts[0] if all(n in other for other in layouts)) if layouts else ()
    shape = (len(found), len(people), frames, len(names))
    pixels, confidence = np.full((*shape, 2), np.nan), np.zeros(shape)
    for view, (own, layout) in enumerate(zip(found, layouts)):
        columns = [layout.index(n) for n in names]
        for index, person in enumerate(people):
            mine = np.array([identities.get((own.camera, int(t)), "") == person for t in own.track], bool)
            mine &= (own.frame >= 0) & (own.frame < frames)
            keypoints = own.keypoints[mine][:, columns]
            sure = (keypoints[..., 2] >= least) & np.isfinite(keypoints[..., :2]).all(-1)
            pixels[view, index, own.frame[mine]] = np.where(sure[..., None], keypoints[..., :2], np.nan)
            confidence[view, index, own.frame[mine]] = np.where(sure, keypoints[..., 2], 0.0)
    return Tracks(pixels, confidence, names)


def triangulate_tracks(
    found: Tracks, names: Sequence[str], cameras: Sequence[Camera], limits: Limits
) -> tuple[Num[np.ndarray, "P T K 3"], Num[np.ndarray, "V P T K"]]:
    """World points of those of ``names`` that the tracks have, NaN where undetermined, and their confidence."""
    columns = [found.names.index(n) for n in names if n in found.names]
    pixels, confidence = found.pixels[:, :, :, columns], found.confidence[:, :, :, columns]
    if not pixels.size:
        return np.full((*pixels.shape[1:4], 3), np.nan), confidence
    return triangulate(pixels, confidence, cameras, limits).points_m, confidence
