# SPDX-License-Identifier: Apache-2.0
"""Difference of the colours of what two groups of tracks wear, part by part, in the cameras that see both."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np

from studiorecon.keypoints.correspondence import STABLE_KEYPOINTS
from studiorecon.people.association.gaps import Clothes
from studiorecon.people.association.grouping import Group
from studiorecon.people.pictures.change import PICTURES, pictures_at, sample_frames
from studiorecon.scene.camera import Camera

if TYPE_CHECKING:
    from jaxtyping import Float

# Parts of the body whose clothes differ, each between two joints of either side.
_PARTS = (("shoulder", "hip"), ("shoulder", "elbow"), ("hip", "knee"), ("knee", "ankle"))
# Shares of the way between the joints where colours are taken.
_ALONG = np.array([0.3, 0.5, 0.7])


def compare_clothes(cameras: Sequence[Camera], videos: Sequence[Path]) -> Clothes:
    """A function of two groups: difference (P,) of the colours of their parts, CIELAB, median over cameras."""
    known: dict[tuple[tuple[int, int], ...], np.ndarray] = {}

    def colours(group: Group) -> np.ndarray:
        if group.members not in known:
            known[group.members] = np.array([_colours(group, v, c, videos[v]) for v, c in enumerate(cameras)])
        return known[group.members]

    def compare(first: Group, second: Group) -> Float[np.ndarray, " P"]:
        apart = np.linalg.norm(colours(first) - colours(second), axis=-1)
        both = np.isfinite(apart)
        return np.array([np.median(apart[both[:, k], k]) if both[:, k].any() else np.nan for k in range(len(_PARTS))])

    return compare


def _colours(group: Group, view: int, camera: Camera, video: Path) -> Float[np.ndarray, "P 3"]:
    """Median CIELAB of each part in one camera; NaN where it is not seen."""
    taken: list[list[np.ndarray]] = [[] for _ in _PARTS]
    for t, picture in pictures_at(video, sample_frames(np.flatnonzero(group.seen[view]), PICTURES)).items():
        pixels, depth = camera.project(group.points_m[t])
        pixels[depth <= 0] = np.nan
        for k, ends in enumerate(_PARTS):
            for side in ("left", "right"):
                first, last = (pixels[STABLE_KEYPOINTS.index(f"{side}_{end}")] for end in ends)
                at = first + _ALONG[:, None] * (last - first)
                inside = (at >= 0).all(1) & (at < camera.wh).all(1)
                columns, rows = np.floor(at[inside]).astype(int).T
                taken[k].extend(picture[rows, columns])
    out = np.full((len(_PARTS), 3), np.nan)
    for k, colours in enumerate(taken):
        if colours:
            lab = cv2.cvtColor(np.array(colours, np.float32)[None] / np.float32(255), cv2.COLOR_RGB2LAB)[0]
            out[k] = np.median(lab, axis=0)
    return out
