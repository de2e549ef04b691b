# SPDX-License-Identifier: Apache-2.0
"""Detects two cameras with the same picture: one film given twice, whatever its name, cut or encoding."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import TYPE_CHECKING

import cv2
import numpy as np

from studiorecon.errors import UserError
from studiorecon.footage.frames import seek_frames
from studiorecon.footage.source import FootageSource
from studiorecon.progress import warn

if TYPE_CHECKING:
    from jaxtyping import Integer, Num

_WIDTH, _COARSE = 96, 4.0
# Correlation of the static content, without its coarse brightness. Cameras of one room, 45 to 120° apart: 0.14 at most;
# one film encoded again, or another part of it: 0.99.
_SAME = 0.95
# With less detail, grey levels, there is nothing to compare.
_MIN_DETAIL = 1.0


def duplicate_film_note(sources: Mapping[str, FootageSource]) -> str:
    """A sentence about two cameras with the same view, from three pictures each; empty if all differ."""
    still: dict[str, np.ndarray] = {}
    for camera, source in sources.items():
        try:
            frames = source.frames
            still[camera] = static_image(seek_frames(source, [frames // 6, frames // 2, 5 * frames // 6]))
        except UserError as refusal:  # the step that decodes it stops at that; the others are still compared
            warn(str(refusal))
    for one, two in combinations(still, 2):
        if same_view(still[one], still[two]):
            return (
                f"cameras {one} and {two} show the same picture: both have one film, perhaps encoded again or cut; "
                f"bring the footage of {two}, or leave it out (train: [...] in capture.yaml)"
            )
    return ""


def static_image(pictures: Sequence[Integer[np.ndarray, "H W 3"]]) -> Num[np.ndarray, "h 96"]:
    """Grey static content of one camera's pictures (H, W, 3) uint8, without its coarse brightness."""
    height, width = pictures[0].shape[:2]
    size = (_WIDTH, max(round(_WIDTH * height / width), 1))
    grey = [cv2.resize(cv2.cvtColor(p, cv2.COLOR_RGB2GRAY), size, interpolation=cv2.INTER_AREA) for p in pictures]
    still = np.median(np.array(grey, dtype=np.float64), axis=0)
    return still - cv2.GaussianBlur(still, (0, 0), _COARSE)


def same_view(one: Num[np.ndarray, "h 96"], two: Num[np.ndarray, "h 96"]) -> bool:
    """Whether two ``static_image`` pictures are of one film."""
    if one.shape != two.shape or min(one.std(), two.std()) < _MIN_DETAIL:
        return False
    one, two = one - one.mean(), two - two.mean()
    return bool((one * two).mean() / (one.std() * two.std()) >= _SAME)
