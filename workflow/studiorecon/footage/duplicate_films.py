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
from studiorecon.machine.threads import in_threads
from studiorecon.progress import warn

if TYPE_CHECKING:
    from jaxtyping import Integer, Num

_WIDTH, _COARSE = 96, 4.0
# Correlation of the static content, without its coarse brightness. Cameras of one room, 45 to 120° apart: 0.14 at most;
# one film encoded again, or another part of it: 0.99.
_SAME = 0.95
# Pictures of every film, from its first twentieth to its last: a view that changes for a quarter of it is seen.
_PICTURES = 5
# With less detail, grey levels, there is nothing to compare.
_MIN_DETAIL = 1.0
# Where a camera's view is compared with itself: width of the pictures, side of a block and reach of the search, pixels.
_SHARP_WIDTH, _BLOCK, _REACH = 192, 24, 16
# Share of the blocks that are still in place below which a view is another one. Real films of static cameras have 0.44
# or more, with somebody in front of half the picture, half the exposure and noise; moved by 1 % of the width, turned
# by 3°, 5 % closer, mirrored or of another camera they have 0.09 or less.
_OTHER_VIEW = 0.2


def compare_views(sources: Mapping[str, FootageSource]) -> tuple[str, list[str]]:
    """A sentence about two cameras with the same view, empty if all differ; and one on every camera whose view changes.

    ``_PICTURES`` of each camera are compared.
    """
    still: dict[str, np.ndarray] = {}
    changed = []
    for camera, seen in zip(sources, in_threads(_compare_with_itself, sources.values())):
        if isinstance(seen, UserError):  # the step that decodes it stops at that; the others are still compared
            warn(str(seen))
            continue
        still[camera], frames = seen
        if len(frames) > 1:
            changed.append(
                f"camera {camera} shows another view in frame {frames[1]} of its film than in frame {frames[0]}: it "
                "moved, or a part is of another film; use frames of one view (frames: in capture.yaml), or leave it "
                "out (train: [...])"
            )
    for one, two in combinations(still, 2):
        if same_view(still[one], still[two]):
            return (
                f"cameras {one} and {two} show the same picture: both have one film, perhaps encoded again or cut; "
                f"bring the footage of {two}, or leave it out (train: [...] in capture.yaml)"
            ), changed
    return "", changed


def _compare_with_itself(source: FootageSource) -> tuple[np.ndarray, list[int]] | UserError:
    """The static content of a film, and its first compared frame with those of another view; or why it has none."""
    last = source.frames - 1 - source.frames // 20
    at = [int(frame) for frame in np.linspace(source.frames // 20, last, _PICTURES)]
    try:
        pictures = seek_frames(source, at)
    except UserError as refusal:
        return refusal
    other = [frame for frame, p in zip(at[1:], pictures[1:]) if share_in_place(pictures[0], p) < _OTHER_VIEW]
    return static_image(pictures), [at[0], *other]


def share_in_place(one: Integer[np.ndarray, "H W 3"], two: Integer[np.ndarray, "H W 3"]) -> float:
    """Share of the blocks with detail that match best where they were; 1 where most blocks have none.

    People cover some blocks, but seldom half of them; before a plain wall they may be all the detail.
    """
    before, after = (static_image([picture], _SHARP_WIDTH).astype(np.float32) for picture in (one, two))
    wide = cv2.copyMakeBorder(after, *(_REACH,) * 4, cv2.BORDER_CONSTANT)
    corners = [(r, c) for r in range(0, before.shape[0] - _BLOCK + 1, _BLOCK) for c in range(0, _SHARP_WIDTH, _BLOCK)]
    in_place = []
    for row, column in corners:
        block, there = (p[row : row + _BLOCK, column : column + _BLOCK] for p in (before, after))
        if min(block.std(), there.std()) > _MIN_DETAIL:
            around = wide[row : row + _BLOCK + 2 * _REACH, column : column + _BLOCK + 2 * _REACH]
            match = cv2.matchTemplate(around, block, cv2.TM_CCOEFF_NORMED)
            best = np.array(np.unravel_index(np.argmax(match), match.shape))
            in_place.append(bool((np.abs(best - _REACH) <= 1).all()))
    return float(np.mean(in_place)) if 2 * len(in_place) >= len(corners) else 1.0


def static_image(pictures: Sequence[Integer[np.ndarray, "H W 3"]], width: int = _WIDTH) -> Num[np.ndarray, "h w"]:
    """Grey static content of one camera's pictures (H, W, 3) uint8, ``width`` wide, without its coarse brightness."""
    rows, columns = pictures[0].shape[:2]
    size = (width, max(round(width * rows / columns), 1))
    grey = [cv2.resize(cv2.cvtColor(p, cv2.COLOR_RGB2GRAY), size, interpolation=cv2.INTER_AREA) for p in pictures]
    still = np.median(np.array(grey, dtype=np.float64), axis=0)
    return still - cv2.GaussianBlur(still, (0, 0), _COARSE)


def same_view(one: Num[np.ndarray, "h 96"], two: Num[np.ndarray, "h 96"]) -> bool:
    """Whether two ``static_image`` pictures are of one film."""
    if one.shape != two.shape or min(one.std(), two.std()) < _MIN_DETAIL:
        return False
    one, two = one - one.mean(), two - two.mean()
    return bool((one * two).mean() / (one.std() * two.std()) >= _SAME)
