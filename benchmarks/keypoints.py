# SPDX-License-Identifier: Apache-2.0
"""Share of recorded keypoints with planted mistakes that are read correctly: ``python -m benchmarks.keypoints``.

Made films of drawn people, each with its keypoints as they are and with one thing mixed up. Each row states the correct
outcome: used as they are, put right, or refused. ``false alarms`` counts refusals and changes of what was right.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from studiorecon.keypoints.coordinate_readings import affine
from studiorecon.keypoints.film_check import Film, Verdict, check_against_film
from studiorecon.keypoints.motion import measure_motion, shrink_picture
from studiorecon.keypoints.numbering import possible_numberings
from studiorecon.scene.recorded_keypoints import RecordedKeypoints

from tests.made.walkers import Take, take

Change = Callable[[Take, Take], RecordedKeypoints]


def moved(matrix: Callable[[int, int], list[list[float]]]) -> Change:
    """Keypoints (x, y, 1) mapped by a matrix of the film's width and height."""

    def change(own: Take, _: Take) -> RecordedKeypoints:
        points = own.recorded.keypoints
        there = points[..., 2:] > 0
        new = np.concatenate([points[..., :2], np.ones_like(points[..., :1])], -1) @ np.array(matrix(*own.wh)).T
        return replace(own.recorded, keypoints=np.where(there, np.concatenate([new, points[..., 2:]], -1), 0.0))

    return change


def numbered(number: Callable[[np.ndarray, float], np.ndarray], counted: bool = False) -> Change:
    """Pictures with other numbers."""

    def change(own: Take, _: Take) -> RecordedKeypoints:
        seen = own.recorded
        pictures, frame = (number(np.asarray(v), own.fps).astype(np.int64) for v in (seen.pictures, seen.frame))
        return replace(seen, pictures=pictures, frame=frame, counted=counted)

    return change


def late(by: int) -> Change:
    """Keypoints of ``by`` frames before, under a format that counts from 0; the last ones are missing."""

    def change(own: Take, _: Take) -> RecordedKeypoints:
        kept = own.recorded.frame + by < len(own.pictures)
        seen = own.recorded.only(kept)
        return replace(seen, frame=seen.frame + by, counted=True)

    return change


def from_one(own: Take, _: Take) -> RecordedKeypoints:
    """Files 1 … N - 3 for N frames: the film's length leaves open whether they count from 1."""
    seen = own.recorded.only(own.recorded.frame < len(own.pictures) - 3)
    return replace(seen, pictures=seen.pictures[: len(own.pictures) - 3] + 1, frame=seen.frame + 1)


def shuffled(own: Take, _: Take) -> RecordedKeypoints:
    order = np.random.default_rng(5).permutation(len(own.pictures))
    frame = order[own.recorded.frame]
    by_frame = np.argsort(frame, kind="stable")
    return replace(own.recorded, frame=frame[by_frame], keypoints=own.recorded.keypoints[by_frame])


def frozen(own: Take, _: Take) -> RecordedKeypoints:
    frames = own.recorded.pictures
    return replace(own.recorded, frame=frames, keypoints=np.repeat(own.recorded.keypoints[:1], len(frames), 0))


def as_is(own: Take, _: Take) -> RecordedKeypoints:
    return own.recorded


# What → (change, what is right: "kept", "mended" or "refused").
ROWS: dict[str, tuple[Change, str]] = {
    "as they are": (as_is, "kept"),
    "numbered from 1": (numbered(lambda n, _: n + 1), "mended"),
    "numbered from 1, last ones missing": (from_one, "mended"),
    "numbered from 700": (numbered(lambda n, _: n + 700), "mended"),
    "milliseconds": (numbered(lambda n, fps: np.round(n * 1000 / fps)), "mended"),
    "nanoseconds since 1970": (numbered(lambda n, fps: 1714557600 * 10**9 + np.round(n * 1e9 / fps)), "mended"),
    "12 frames late": (late(12), "mended"),
    "shares 0 to 1": (moved(lambda w, h: [[1 / w, 0, 0], [0, 1 / h, 0]]), "mended"),
    "shares -1 to 1": (moved(lambda w, h: [[2 / w, 0, -1], [0, 2 / h, -1]]), "mended"),
    "of twice the size": (moved(lambda w, h: [[2, 0, 0.5], [0, 2, 0.5]]), "mended"),
    "of half the size": (moved(lambda w, h: [[0.5, 0, -0.25], [0, 0.5, -0.25]]), "mended"),
    "mirrored": (moved(lambda w, h: [[-1, 0, w], [0, 1, 0]]), "refused"),
    "upside down": (moved(lambda w, h: [[1, 0, 0], [0, -1, h]]), "refused"),
    "turned by 180°": (moved(lambda w, h: [[-1, 0, w], [0, -1, h]]), "refused"),
    "turned by 90°": (moved(lambda w, h: [[0, -1, h], [1, 0, 0]]), "refused"),
    "y, x": (moved(lambda w, h: [[0, 1, 0], [1, 0, 0]]), "refused"),
    "of another film": (lambda _, other: other.recorded, "refused"),
    "shuffled": (shuffled, "refused"),
    "frozen": (frozen, "refused"),
}


def verdict(own: Take, given: RecordedKeypoints, other: Take, stored_wh: tuple[int, int] | None = None) -> Verdict:
    """What is decided about keypoints ``given`` for the film of ``own``, stored with so many pixels."""
    frames = len(own.pictures)
    wanted = np.unique(np.linspace(0, frames - 1, 64).round().astype(int)).tolist()
    motion = measure_motion(wanted, [shrink_picture(own.pictures[t]) for t in wanted], own.wh)
    film = Film("a", own.wh, frames, motion, affine(1, 1), 0.5, stored_wh)
    numbers = possible_numberings(given.pictures, frames, own.fps, None, given.counted)
    return check_against_film(given, numbers, film, lambda: {"b": other.recorded})


def outcome(own: Take, found: Verdict) -> str:
    """ "refused", "right", or "wrong": whether keypoints are where and when the film has them."""
    if found.refusal:
        return "refused"
    right, now = own.recorded, found.recorded
    by_frame = {int(t): right.keypoints[right.frame == t] for t in np.unique(right.frame)}
    off = [
        float(np.abs(points[..., :2] - theirs[..., :2])[points[..., 2] > 0].max(initial=0))
        for t in np.unique(now.frame)
        if (points := now.keypoints[now.frame == t]).shape == (theirs := by_frame.get(int(t), np.zeros(0))).shape
    ]
    same = len(off) > 0.8 * len(np.unique(now.frame)) and float(np.median(off)) < 1.0
    return "right" if same else "wrong"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--takes", type=int, default=24)
    count = parser.parse_args().takes
    takes = [take(s, 60 + 12 * (s % 8), 1 + s % 3, ((320, 180), (180, 320), (640, 360))[s % 3]) for s in range(count)]
    print(f"{'':36} right refused wrong (of {count}), wanted")
    for name, (change, wanted) in ROWS.items():
        seen = Counter()
        for k, own in enumerate(takes):
            other = takes[(k + 3) % count]
            seen[outcome(own, verdict(own, change(own, other), other))] += 1
        print(f"{name:36} {seen['right']:5} {seen['refused']:7} {seen['wrong']:5}  {wanted}", flush=True)
    still = [take(1000 + s, 80, 2, moving=0.1 * (s % 3)) for s in range(count)]
    alarms = [v for own in still if (v := verdict(own, own.recorded, takes[0])).refusal or v.notes]
    print(f"people who hardly move: {len(alarms)} false alarms of {count}")


if __name__ == "__main__":
    main()
