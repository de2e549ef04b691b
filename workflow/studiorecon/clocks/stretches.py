# SPDX-License-Identifier: Apache-2.0
"""Names films that lack frames in their middle, though their time stamps run evenly: by people, who then are in step
with those of the other cameras at one end of the film only."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.clocks.people import Lenses, people_lags
from studiorecon.clocks.posterior import choose_reference, estimate_offsets
from studiorecon.clocks.sound import MAX_DRIFT_PPM
from studiorecon.scene.clocks import Clock
from studiorecon.scene.people import Detections

if TYPE_CHECKING:
    from jaxtyping import Float

# A shorter stretch determines no lag by people, who are then seen for a second at most.
_MIN_STRETCH_S = 1.5
# Fewer frames are within the error of a lag; a film that stops so many frames earlier may lack some.
_MIN_FRAMES = 1.5
# Cameras that were stopped by hand end further apart, in seconds.
_MAX_APART_S = 0.5


def lost_frames_notes(
    seen: Sequence[Detections], clocks: Sequence[Clock], rate: float, lenses: Lenses, in_step: Sequence[str]
) -> list[str]:
    """A sentence on every camera whose offset differs between the first and the last third of the films.

    Where that is undetermined, one on every camera ``in_step`` whose film is a little shorter than another's.
    """
    notes = []
    seconds = min(float(clock.own_s[-1]) for clock in clocks)
    part_s = max(_MIN_STRETCH_S, seconds / 3)
    change, half = np.full((2, len(clocks)), np.nan)
    if 2 * part_s <= seconds:
        change, half = (x * rate for x in offset_changes_s(seen, clocks, rate, lenses, part_s))
    least = max(_MIN_FRAMES, 1e-6 * MAX_DRIFT_PPM * (seconds - part_s) * rate)
    longest = max(clocks, key=lambda clock: clock.frames)
    for clock, frames, uncertain in zip(clocks, change, half, strict=True):
        shorter = longest.frames - clock.frames
        if abs(frames) > max(least, uncertain):
            first, last = round(part_s * clock.fps), round((seconds - part_s) * clock.fps)
            many = "lacks" if frames > 0 else "repeats"
            notes.append(
                f"by its people, camera {clock.camera} {many} about {abs(frames):.0f} ± {uncertain:.1f} frames around "
                f"the middle of its film, against the other cameras: use the frames before (frames: {{first: 0, count: "
                f"{first}}} in capture.yaml) or after (first: {last}), or leave it out (train: [...])"
            )
        elif (
            not np.isfinite(uncertain)
            and clock.camera in in_step
            and longest.camera in in_step
            and clock.fps == longest.fps
            and _MIN_FRAMES < shorter < _MAX_APART_S * rate
        ):
            notes.append(
                f"camera {clock.camera} has {shorter} frames fewer than camera {longest.camera}, and people in "
                f"{seconds:.1f} s of film do not show whether frames are missing in its middle: if its recorder drops "
                "frames, copy the film again or leave the camera out (train: [...] in capture.yaml)"
            )
    return notes


def offset_changes_s(
    seen: Sequence[Detections], clocks: Sequence[Clock], rate: float, lenses: Lenses, part_s: float
) -> tuple[Float[np.ndarray, " C"], Float[np.ndarray, " C"]]:
    """(C,) seconds by which every camera's offset is later at the films' end than at their beginning, and half of the
    95 % interval; NaN and inf where people do not determine it."""
    end_s = {clock.camera: float(clock.own_s[-1]) for clock in clocks}
    own_s = {clock.camera: clock.own_s for clock in clocks}
    parts = []
    for first in (True, False):
        part = []
        for d in seen:
            at = own_s[d.camera][np.clip(d.frame, 0, len(own_s[d.camera]) - 1)]
            part.append(d.only(at <= part_s if first else at >= end_s[d.camera] - part_s))
        parts.append(people_lags(part, clocks, rate, lenses)[0])
    reference = choose_reference(parts[0], len(clocks))
    both = [estimate_offsets(lags, len(clocks), reference) for lags in parts]
    change = np.array([late.seconds - early.seconds for early, late in zip(*both, strict=True)])
    half = np.array([np.hypot(early.half_s, late.half_s) for early, late in zip(*both, strict=True)])
    half[reference] = np.min(np.delete(half, reference), initial=np.inf)
    known = np.isfinite(half)
    # Most cameras lack nothing; of two, one that lacks frames is likelier than one that repeats them.
    usual = np.median(change[known]) if known.sum() > 2 else np.min(change[known], initial=np.inf)
    return np.where(known, change - usual, np.nan), half
