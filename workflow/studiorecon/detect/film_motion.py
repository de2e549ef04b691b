# SPDX-License-Identifier: Apache-2.0
"""A few dozen pictures of a film, for what moves in it."""

from __future__ import annotations

import numpy as np

from studiorecon.errors import UserError
from studiorecon.footage.frames import glimpses, stills
from studiorecon.footage.source import FootageSource
from studiorecon.keypoints.motion import Motion, motion_of, small
from studiorecon.progress import warn

# So many pictures are looked at. A film of up to this many frames is decoded from its beginning, which takes a second
# or two; a longer one is sought in.
_PICTURES, _FRAMES_READ = 64, 600


def motion_in(source: FootageSource, first: int, last: int) -> Motion | None:
    """What moves in some frames from ``first`` to ``last``; None, with a warning, where the film cannot be read."""
    first, last = min(max(first, 0), source.frames - 1), min(max(last, 0), source.frames - 1)
    wanted = np.unique(np.linspace(first, max(last, first), _PICTURES).round().astype(int)).tolist()
    look = stills if last <= _FRAMES_READ else glimpses
    try:
        pictures = [small(picture) for picture in look(source, wanted)]
    except UserError as refusal:
        warn(f"{refusal}; until then its keypoints are not compared with it")
        return None
    return motion_of(wanted[: len(pictures)], pictures, source.wh) if len(pictures) > 2 else None
