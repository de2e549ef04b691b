# SPDX-License-Identifier: Apache-2.0
"""Detects two cameras with one film, whatever its name, cut or encoding, and a camera whose view changes."""

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
# Side of a block in pixels: an eighth of the picture's width.
_BLOCK = 12
# Agreement below which a view is another one. Real films of static cameras have 0.41 or more, with somebody in front of
# half the picture; a shift by 4 % of the width and other cameras' films 0.29 or less.
_OTHER_VIEW = 0.3


def compare_views(sources: Mapping[str, FootageSource]) -> tuple[str, list[str]]:
    """A sentence about two cameras with the same view, empty if all differ; and one on every camera whose view changes.

    Three pictures of each camera are compared.
    """
    still: dict[str, np.ndarray] = {}
    changed = []
    for camera, source in sources.items():
        try:
            at = [source.frames // 6, source.frames // 2, 5 * source.frames // 6]
            pictures = list(seek_frames(source, at))
        except UserError as refusal:  # the step that decodes it stops at that; the others are still compared
            warn(str(refusal))
            continue
        still[camera] = static_image(pictures)
        if view_agreement(static_image(pictures[:1]), static_image(pictures[-1:])) < _OTHER_VIEW:
            changed.append(
                f"camera {camera} shows another view in frame {at[-1]} of its film than in frame {at[0]}: it moved, "
                "or a part is of another film; use frames of one view (frames: in capture.yaml), or leave it out "
                "(train: [...])"
            )
    for one, two in combinations(still, 2):
        if same_view(still[one], still[two]):
            return (
                f"cameras {one} and {two} show the same picture: both have one film, perhaps encoded again or cut; "
                f"bring the footage of {two}, or leave it out (train: [...] in capture.yaml)"
            ), changed
    return "", changed


def view_agreement(one: Num[np.ndarray, "h 96"], two: Num[np.ndarray, "h 96"]) -> float:
    """The median correlation of two ``static_image`` pictures over blocks with detail; 1 where most blocks have none.

    People cover some blocks, but seldom half of them; before a plain wall they may be all the detail.
    """
    first, second = (_blocks(picture) for picture in (one, two))
    spread = first.std(axis=1) * second.std(axis=1)
    detailed = np.minimum(first.std(axis=1), second.std(axis=1)) > _MIN_DETAIL
    if 2 * detailed.sum() < len(detailed):
        return 1.0
    return float(np.median((first * second).mean(axis=1)[detailed] / spread[detailed]))


def _blocks(picture: Num[np.ndarray, "h 96"]) -> Num[np.ndarray, "B 144"]:
    """The whole blocks of a picture, each without its mean."""
    rows, columns = picture.shape[0] // _BLOCK, picture.shape[1] // _BLOCK
    cut = picture[: rows * _BLOCK, : columns * _BLOCK].reshape(rows, _BLOCK, columns, _BLOCK)
    blocks = cut.swapaxes(1, 2).reshape(rows * columns, -1)
    return blocks - blocks.mean(axis=1, keepdims=True)


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
