# SPDX-License-Identifier: Apache-2.0
"""Resamples keypoints of a camera's own frames to the scene's times, between its frames where its clock requires it."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np

from studiorecon.errors import UserError
from studiorecon.scene.capture import Footage
from studiorecon.scene.clocks import Clocks
from studiorecon.scene.people import Detections

# Neighbours further apart than this, seconds, are not interpolated unless they are adjacent frames, because the motion
# between them is unknown. A swinging hand leaves the straight line by a centimetre in that time.
_FARTHEST_S, _NEXT_FRAMES = 0.1, 1.25
_SAME = 1e-9
# A cubic needs two frames on either side.
_MARGIN = 2


def part_used(footage: Footage, clocks: Clocks | None) -> Footage:
    """The used frames of a camera's footage, and a margin if they must be resampled: consecutive source frames."""
    if clocks is None:
        return footage
    first, count = used_range(clocks, footage.camera)
    return replace(footage, first_source_frame=first, frames=count)


def used_range(clocks: Clocks, camera: str) -> tuple[int, int]:
    """First frame and number of frames of that part; UserError where the footage cannot be used."""
    if clocks.refusal:
        raise UserError(clocks.refusal)
    used, late = clocks.source_frames(camera), clocks.late_frames(camera)
    margin = _MARGIN if late.any() or clocks.of(camera).readout_s else 0
    first, last = max(int(used[0]) - margin, 0), min(int(used[-1]) + margin, clocks.of(camera).frames - 1)
    return first, last - first + 1


def at_working_frames(seen: Detections, footage: Footage, clocks: Clocks | None) -> Detections:
    """``seen``, numbered by the frames of ``part_used``, at the working frames of ``footage``."""
    if clocks is None:
        return seen
    first = part_used(footage, clocks).first_source_frame
    return resample_keypoints(replace(seen, frame=seen.frame + first), clocks, footage.wh[1])


def at_working_moments(seen: Detections, clocks: Clocks, height_px: float) -> Detections:
    """``seen`` at the times of the working frames, from pictures up to half a frame off.

    Each keypoint is moved along its track, as in ``resample_keypoints``.
    """
    late, readout = clocks.late_frames(seen.camera), clocks.of(seen.camera).readout_s * clocks.fps
    if not late.any() and not readout:
        return seen
    return _along_tracks(seen, late[seen.frame], readout, height_px, clocks.fps)


def _along_tracks(seen: Detections, late: np.ndarray, readout: float, height_px: float, fps: float) -> Detections:
    """``seen`` with keypoints and hands at its frames, from pictures taken ``late`` (D,) frames after them."""
    count = seen.keypoints.shape[1]
    hands = np.zeros((len(seen.frame), 0, 3)) if seen.hands is None else seen.hands.reshape(len(seen.frame), -1, 3)
    points = np.concatenate([seen.keypoints, hands], axis=1)
    moved = points.copy()
    for track in np.unique(seen.track):
        mine = np.flatnonzero(seen.track == track)
        mine = mine[np.argsort(seen.frame[mine], kind="stable")]
        frame, times = seen.frame[mine], seen.frame[mine] + late[mine]
        moved[mine] = _resampled(points[mine], times, points[mine], frame, readout, height_px, fps)
    own = None if seen.hands is None else moved[:, count:].reshape(seen.hands.shape).astype(np.float32)
    return replace(seen, keypoints=moved[:, :count], hands=own)


def correct_rolling_shutter(seen: Detections, readout_s: float, height_px: float, fps: float) -> Detections:
    """``seen`` at its own frames, corrected for a rolling shutter that reads ``height_px`` rows in ``readout_s``.

    Each keypoint is moved along its track to the frame's time, as in ``resample_keypoints``.
    """
    if not readout_s:
        return seen
    return _along_tracks(seen, np.zeros(len(seen.frame)), readout_s * fps, height_px, fps)


def resample_keypoints(seen: Detections, clocks: Clocks, height_px: float) -> Detections:
    """``seen`` (numbered by the frames of the footage) at the working frames, in the order of time.

    A working frame has the detections of the nearest picture. Each keypoint is moved along its track to the frame's
    time: by a cubic through two samples on either side, by a line where one of the outer two is missing, and not at all
    next to a gap. With a readout, every keypoint's time is that of its row of ``height_px``. Monocular bodies are not
    moved.
    """
    clock, position = clocks.of(seen.camera), clocks.positions(seen.camera)
    used = clocks.source_frames(seen.camera)
    rows_of = {int(k): np.flatnonzero(seen.frame == k) for k in np.unique(seen.frame)}
    picked = [rows_of.get(int(k), np.zeros(0, int)) for k in used]
    at = np.concatenate(picked) if picked else np.zeros(0, int)
    frame = np.repeat(np.arange(len(used)), [len(p) for p in picked])
    per_detection = [
        f.name for f in fields(seen) if f.name not in ("camera", "layout") and getattr(seen, f.name) is not None
    ]
    moved = replace(seen, **{name: getattr(seen, name)[at] for name in per_detection} | {"frame": frame})
    if clock.readout_s == 0 and np.array_equal(position[used], np.arange(len(used))):
        return moved
    for track in np.unique(moved.track):
        mine = np.flatnonzero(seen.track == track)
        mine = mine[np.argsort(seen.frame[mine], kind="stable")]
        own = np.flatnonzero(moved.track == track)
        moved.keypoints[own] = _resampled(
            seen.keypoints[mine],
            position[seen.frame[mine]],
            moved.keypoints[own],
            frame[own],
            clock.readout_s * clocks.fps,
            height_px,
            clocks.fps,
        )
    return moved


def _resampled(
    samples: np.ndarray,
    times: np.ndarray,
    nearest: np.ndarray,
    wanted: np.ndarray,
    readout: float,
    height_px: float,
    fps: float,
) -> np.ndarray:
    """Keypoints of one track at times ``wanted`` from ``samples`` at ``times``, all in working frames."""
    found, farthest = nearest.copy(), max(_FARTHEST_S * fps, _NEXT_FRAMES)
    for k in range(samples.shape[1]):
        there = np.flatnonzero((samples[:, k, 2] > 0) & np.isfinite(samples[:, k, :2]).all(-1))
        asked = np.flatnonzero((nearest[:, k, 2] > 0) & np.isfinite(nearest[:, k, :2]).all(-1))
        if not len(there) or not len(asked):
            continue
        points = samples[there, k, :2]
        when = times[there] + readout * (points[:, 1] / height_px - 0.5)
        when = np.maximum.accumulate(when + _SAME * np.arange(len(when)))
        found[asked, k, :2] = _interpolated(points, when, nearest[asked, k, :2], wanted[asked], farthest)
    return found


def _interpolated(
    points: np.ndarray, when: np.ndarray, nearest: np.ndarray, wanted: np.ndarray, farthest: float
) -> np.ndarray:
    """Points at times ``wanted``; the ``nearest`` where no two points at most ``farthest`` apart enclose the time."""
    last = len(when) - 1
    after = np.searchsorted(when, wanted)
    exact = np.isclose(when[np.minimum(after, last)], wanted, rtol=0, atol=1e-6)
    inside = (after > 0) & (after <= last)
    right, left = np.clip(after, 1, max(last, 1)), np.clip(after, 1, max(last, 1)) - 1
    if not last:
        return np.where(exact[:, None], points[np.minimum(after, last)], nearest)
    inside &= when[right] - when[left] <= farthest
    share = (wanted - when[left]) / np.maximum(when[right] - when[left], _SAME)
    line = points[left] + share[:, None] * (points[right] - points[left])
    outer = np.stack([np.clip(i, 0, last) for i in (left - 1, left, right, right + 1)])
    spans = np.diff(when[outer], axis=0)
    whole = inside & (left >= 1) & (right < last) & (spans.max(0) <= 1.5 * np.maximum(spans.min(0), _SAME))
    cubic = _lagrange(points[outer], when[outer], wanted)
    found = np.where(whole[:, None], cubic, np.where(inside[:, None], line, nearest))
    return np.where(exact[:, None], points[np.minimum(after, last)], found)


def _lagrange(points: np.ndarray, when: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """(W, 2) the cubic through four points (4, W, 2) at times (4, W), at ``wanted`` (W,)."""
    total = np.zeros(points.shape[1:])
    for i in range(4):
        weight = np.ones(len(wanted))
        for j in (j for j in range(4) if j != i):
            gap = when[i] - when[j]
            weight = weight * (wanted - when[j]) / np.where(np.abs(gap) < _SAME, 1.0, gap)
        total += weight[:, None] * points[i]
    return total
